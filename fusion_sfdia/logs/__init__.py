"""Logs of readings as historians export them: a map states how columns become readings and inputs of a plant."""

from fusion_sfdia.common.public_names import public_names

__all__, __getattr__, __dir__ = public_names(__name__, __file__)
