"""The comparison: every detector on every plant, on the same readings, at one rate of false alarms."""
