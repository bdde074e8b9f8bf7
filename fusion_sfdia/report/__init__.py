"""What a person reads of a run: figures, the page, the sentences at its top, and the report of a log."""
