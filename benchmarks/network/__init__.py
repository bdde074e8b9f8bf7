"""The scenarios on the power network, a file each."""
