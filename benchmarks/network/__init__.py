"""The scenarios on the power network, one file each."""
