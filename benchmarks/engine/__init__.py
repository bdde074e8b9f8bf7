"""The scenarios on the marine engine, a file each."""
