"""Detectors: their contract, their names, and a folder for each family."""
