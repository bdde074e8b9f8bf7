"""Plants that come with the package or from elsewhere, and what describes them beyond `Plant`."""

from fusion_sfdia.common.public_names import public_names

__all__, __getattr__, __dir__ = public_names(__name__, __file__)
