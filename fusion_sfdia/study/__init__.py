"""Which errors of real plants a detector survives: noise, starts, model errors and causes that no protocol was tuned to."""
