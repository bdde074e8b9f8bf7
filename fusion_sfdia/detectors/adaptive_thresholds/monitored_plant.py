"""What monitoring modules need of a plant: its equations, a bounded sensor for each, and the envelope of healthy readings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number
from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.detectors.detector import require_no_cycles
from fusion_sfdia.plant.modules import Modules
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

ENVELOPE = 0.05  # of the nominal values, beyond twice the noise, which is assumed to contain healthy readings


def modules_of(plant: Plant) -> Modules:
    """Return the plant's modules; NotApplicableError where it states none."""
    if plant.structure.modules is None:
        raise NotApplicableError(
            f"plant {plant.name!r} does not state its scalar equations; give Plant(structure=Structure(modules=Modules(...))), "
            "both of fusion_sfdia.plants, or take another detector"
        )
    require_no_cycles(plant, "monitoring modules")
    return plant.structure.modules


def require_one_bounded_sensor_each(plant: Plant, modules: Modules) -> None:
    """Raise NotApplicableError unless each equation has one sensor, whose noise has a bound."""
    measured = [s.measures for s in plant.sensors]
    for variable in modules.equations:
        if len(several := [s.name for s in plant.sensors if s.measures == variable]) > 1:
            raise NotApplicableError(
                f"sensors {', '.join(several)} all read {variable}; a module compares one: build the plant with one of them"
            )
    if sorted(measured) != sorted(modules.equations):
        raise NotApplicableError(
            f"plant {plant.name!r} has sensors of {', '.join(measured)}, equations of {', '.join(modules.equations)}; "
            "expected one sensor for each equation"
        )
    if unbounded := [s.name for s in plant.sensors if not np.isfinite(s.noise_bound)]:
        raise NotApplicableError(
            f"sensors {', '.join(unbounded)} have no noise bound; an adaptive threshold needs one: give bound"
        )


def envelope_ends(
    modules: Modules, nominal: Array, bound: Array, envelope: float | Mapping[str, tuple[float, float]] | None
) -> tuple[Array, Array]:
    """Return the least and largest healthy readings by variable (E,), SI; nominal values and noise bounds (E,), SI.

    envelope: as of AdaptiveThreshold. ValueError where it gives no range for a variable whose nominal value is 0.
    """
    given = envelope if isinstance(envelope, Mapping) else {}
    if isinstance(envelope, Mapping) or envelope is None:
        if zero := [v for v, n in zip(modules.equations, nominal, strict=True) if n == 0 and v not in given]:
            raise ValueError(f"the nominal value of {', '.join(zero)} is 0, which gives no range; give envelope")
        measured = nominal != 0
        share = 2 * float(np.max((bound[measured] / np.abs(nominal[measured])), initial=0.0)) + ENVELOPE
    else:
        share = number("envelope", envelope)
    usual = zip(nominal - share * np.abs(nominal), nominal + share * np.abs(nominal), strict=True)
    ends = np.array([given.get(v, pair) for v, pair in zip(modules.equations, usual, strict=True)])
    return ends[:, 0], ends[:, 1]
