"""Detectors on predicted readings: thresholds in standard deviations, local diagnosers with consensus, plug and play."""
