"""Detectors that learn from healthy readings only."""
