"""Sensor-fault detection, isolation and accommodation: three schools on one state-space interface.

The public names are listed in __init__.pyi; more stand in `plants`, `detectors`, `filters`, `logs`, `faults`, `events`,
`learning` and `metrics`. Each is imported at its first use, so that importing the package is fast.
"""

from importlib import import_module
from typing import Any

from fusion_sfdia.common.errors import warn_renamed
from fusion_sfdia.common.public_names import now_called, public_names

__version__ = "0.1.0"

_GROUPS = ("plants", "detectors", "filters", "logs", "faults", "events", "learning", "metrics")
_RENAMED = {  # former names, until the next release
    "inspect_plant": "inspect",
    "registry": "detectors.registry",
    "Roc": "metrics.RocCurve",
    "Audit": "metrics.AuditResult",
    "Whiteness": "learning.WhitenessTest",
    "Identifiability": "plants.IdentifiabilityResult",
    "commission": "learning.Commissioning.of(...).plant",
    "commissioned": "learning.Commissioning.of",
    "choose_model": "learning.ModelChoice.of",
    "calibrate": "learning.Calibration.of",
}

_names, _public, _ = public_names(__name__, __file__)
__all__ = ["__version__", *_names]


def __getattr__(name: str) -> Any:
    if name in _GROUPS:
        return import_module(f"{__name__}.{name}")
    if name in _names or name.startswith("_"):
        return _public(name)
    homes = (f"{group}.{name}" for group in _GROUPS if name in import_module(f"{__name__}.{group}").__all__)
    if (now := _RENAMED.get(name) or next(homes, "")) == "":
        return _public(name)  # which states the public names
    warn_renamed(f"fusion_sfdia.{name}", f"fusion_sfdia.{now}")
    group, _, new = now.partition(".")
    if not new:
        return _public(group)
    home = import_module(f"{__name__}.{group}")
    known = new.partition(".")[0] in home.__all__
    return now_called(home, new) if known else import_module(f"{__name__}.{now}")


def __dir__() -> list[str]:
    return sorted(__all__)
