"""Detectors that learn from healthy readings alone."""
