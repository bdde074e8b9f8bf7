"""Logs of readings as historians export them: a map states how columns become readings and inputs of a plant."""
