"""What is learnt from healthy logs: tuned models, monitors, checks of plants and models."""

from typing import Any

from fusion_sfdia.common.public_names import public_names

_FORMER = {  # former names, until the next release
    "commissioned": "Commissioning.of",
    "choose_model": "ModelChoice.of",
    "calibrate": "Calibration.of",
}

__all__, _public, __dir__ = public_names(__name__, __file__, _FORMER)


def __getattr__(name: str) -> Any:
    if name == "commission":  # warns where it is called
        from fusion_sfdia.learning.commissioning.commission import commission

        return commission
    return _public(name)
