"""The scenarios on the gas pipeline, one file each."""
