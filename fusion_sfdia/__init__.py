"""Sensor-fault detection, isolation and accommodation: three schools on one state-space interface."""

__version__ = "0.1.0"
