"""Two water tanks in series, checkable by hand."""
