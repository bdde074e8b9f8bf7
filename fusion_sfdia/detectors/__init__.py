"""Detectors: their contract, their names, and a folder for each family."""

from fusion_sfdia.common.public_names import public_names

__all__, __getattr__, __dir__ = public_names(__name__, __file__)
