"""The scenarios on recordings of a chemical plant, one file each."""
