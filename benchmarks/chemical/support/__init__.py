"""Shared by the scenarios on the chemical plant."""
