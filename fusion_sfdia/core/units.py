"""The same plant with its sensors read in other units."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import number, shown
from fusion_sfdia.core.plant_groups import Finer, fed_back, scaled
from fusion_sfdia.core.uncertainty import Uncertainty

if TYPE_CHECKING:
    from fusion_sfdia.core.plant import Plant

Array = NDArray[Any]


def in_units(plant: Plant, units: Mapping[str, tuple[str, float]]) -> Plant:
    """Return the plant with {sensor: (unit, readings per present unit)}; ValueError for an unknown sensor or other forms."""
    if not isinstance(units, Mapping):
        raise ValueError(
            f'units are {shown(units)}; expected those of sensors by name, as in {{"p1": ("bar", 1e-5)}} for one in Pa'
        )
    factor = np.ones(len(plant.sensors))
    sensors = list(plant.sensors)
    for name, given in units.items():
        i = plant.sensor_index(name)
        s = sensors[i]
        if not isinstance(given, tuple | list) or len(given) != 2 or not isinstance(given[0], str):
            raise ValueError(
                f"unit of sensor {name!r} is {shown(given)}; expected the unit and readings in it per {s.unit}, as in "
                '("mm", 1000.0) for a sensor in m'
            )
        unit, scale = given
        factor[i] = scale = number(f"scale of sensor {name!r}", scale)
        sigma, bound = s.sigma and s.sigma * abs(scale), s.bound and s.bound * abs(scale)
        period, step = s.period and s.period * abs(scale), s.resolution * abs(scale)
        sensors[i] = replace(s, unit=unit, sigma=sigma, bound=bound, scale=s.scale * scale, period=period, resolution=step)
    jacobian, finer, feedback = plant.jacobians[1], plant.truth.finer, plant.truth.feedback
    return replace(
        plant,
        sensors=tuple(sensors),
        output=partial(scaled, plant.output, factor),
        numerics=replace(
            plant.numerics, output_jacobian=None if jacobian is None else partial(scaled, jacobian, factor[:, None])
        ),
        truth=replace(
            plant.truth,
            finer=None if finer is None else partial(_finer_in_units, finer, dict(units)),
            feedback=None if feedback is None else partial(fed_back, feedback, factor),
        ),
        uncertainty=_uncertainty_in_units(plant.uncertainty, factor, units),
    )


def _uncertainty_in_units(known: Uncertainty, factor: Array, units: Mapping[str, tuple[str, float]]) -> Uncertainty:
    output, jacobian, rebuild = known.output, known.output_jacobian, known.rebuild
    return replace(
        known,
        output=None if output is None else partial(scaled, output, factor),
        output_jacobian=None if jacobian is None else partial(scaled, jacobian, factor[:, None]),
        disturbances=tuple(replace(d, reading=d.reading * factor) for d in known.disturbances),
        rebuild=None if rebuild is None else partial(_rebuilt_in_units, rebuild, dict(units)),
    )


def _rebuilt_in_units(rebuild: Callable[..., Plant], units: Mapping[str, tuple[str, float]], **values: float) -> Plant:
    return rebuild(**values).in_units(units)


def _finer_in_units(finer: Finer, units: Mapping[str, tuple[str, float]]) -> tuple[Plant, Callable[[Array], Array]]:
    model, to_states = finer()
    return model.in_units(units), to_states
