"""The monitor without a model: scales of time, limits from readings that were not learnt, and a monitor that can be kept."""
