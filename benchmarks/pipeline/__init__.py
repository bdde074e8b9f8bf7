"""The scenarios on the gas pipeline, a file each."""
