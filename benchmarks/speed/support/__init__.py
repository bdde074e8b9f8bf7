"""What the measurements of speed share: the workloads, filterpy, and calls that are timed."""
