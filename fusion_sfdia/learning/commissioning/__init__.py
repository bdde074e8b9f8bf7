"""A plant adapted to healthy readings of the real one: parameters, disturbances, noise."""
