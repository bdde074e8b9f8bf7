"""Detectors by structural analysis: residual generators of minimal sets of equations, and consistency-based diagnosis."""
