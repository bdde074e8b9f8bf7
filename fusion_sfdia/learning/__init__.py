"""What is learnt from healthy logs: tuned models, monitors, checks of plants and models."""

from fusion_sfdia.common.public_names import public_names

_FORMER = {  # former names, until the next release
    "commission": "Commissioning.of(...).plant",
    "commissioned": "Commissioning.of",
    "choose_model": "ModelChoice.of",
    "calibrate": "Calibration.of",
}

__all__, __getattr__, __dir__ = public_names(__name__, __file__, _FORMER)
