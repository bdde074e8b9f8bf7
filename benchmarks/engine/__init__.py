"""The scenarios on the marine engine, one file each."""
