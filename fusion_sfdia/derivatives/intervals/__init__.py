"""Interval arithmetic with outward rounding, contractors, set inversion, bounds of monotone functions."""
