"""Detectors on identified models with scikit-learn's interface, and thresholds calibrated on healthy logs."""
