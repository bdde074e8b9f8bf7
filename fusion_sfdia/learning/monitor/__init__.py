"""What healthy readings teach: scales of time, limits from readings that were not learnt, and a monitor that can be kept."""
