"""Detectors on observers and equations: thresholds that bounded noise does not exceed, diagnosis sets, virtual sensors."""
