"""Faults of sensors and plants: their ranges, files and cases of a comparison."""

from fusion_sfdia.common.public_names import public_names

__all__, __getattr__, __dir__ = public_names(__name__, __file__)
