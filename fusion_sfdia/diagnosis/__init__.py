"""From readings to events, verdicts and health: whole logs, and row by row."""
