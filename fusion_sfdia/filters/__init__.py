"""Kalman, ensemble and particle filters as pure functions on batches."""

from fusion_sfdia.common.public_names import public_names

__all__, __getattr__, __dir__ = public_names(__name__, __file__)
