"""Detectors on observers and equations: thresholds above the effect of bounded noise, diagnosis sets, virtual sensors."""
