"""Detectors on observers and equations: thresholds that bounded noise cannot cross, diagnosis sets, virtual sensors."""
