"""What the scenarios on the gas pipeline share."""
