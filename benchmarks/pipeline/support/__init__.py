"""Shared by the scenarios on the gas pipeline."""
