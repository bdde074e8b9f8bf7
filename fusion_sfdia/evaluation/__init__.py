"""Simulated recordings, faults, logs, and the metrics of detection, isolation and accommodation."""
