"""What is learnt from healthy logs: tuned models, monitors, checks of plants and models."""

from fusion_sfdia.common.public_names import public_names

__all__, __getattr__, __dir__ = public_names(__name__, __file__)
