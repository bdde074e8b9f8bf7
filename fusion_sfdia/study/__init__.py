"""Studies of detectors: cases, trials and metrics, the comparison, audits, and scenarios run in processes."""
