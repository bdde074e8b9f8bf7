"""Diagnosis of readings as they arrive: rows in, events out, with a state that survives the process."""
