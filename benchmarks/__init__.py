"""Scenarios of the papers as data, their experiments, and the work of the command line."""
