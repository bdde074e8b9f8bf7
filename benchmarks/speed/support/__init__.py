"""Shared by the measurements of speed: workloads, filterpy, and timed calls."""
