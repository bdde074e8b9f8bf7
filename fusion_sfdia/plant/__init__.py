"""Plants: signals, physics, what is uncertain, discretisation, recorded readings."""
