"""What a diagnosis finds: events, verdicts, the health of the model, and changes row by row."""

from fusion_sfdia.common.public_names import public_names

__all__, __getattr__, __dir__ = public_names(__name__, __file__)
