"""What the scenarios on the power network share, and the figures of some."""
