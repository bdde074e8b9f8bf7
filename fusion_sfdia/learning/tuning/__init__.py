"""A plant and a detector tuned on healthy readings, with thresholds for a stated rate of false alarms, in a readable file."""
