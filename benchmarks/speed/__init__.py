"""Measurements of speed, which the command bench prints."""
