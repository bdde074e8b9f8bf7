"""What the scenarios on the marine engine share, and the figures of some."""
