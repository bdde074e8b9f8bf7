"""Derivatives and enclosures of equations: complex step, dual numbers, recorded straight-line code, intervals."""
