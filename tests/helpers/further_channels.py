"""A plant of `wrong_laws` whose logs have further channels, of which its model knows nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from wrong_laws import WrongLaw, columns

from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]
Reading = Callable[[dict[str, Array]], Array]


def wider(law: WrongLaw, further: Sequence[tuple[str, float, Reading]]) -> WrongLaw:
    """The same plant with further sensors: name, noise, and what they read of the true readings and inputs, by name."""
    names = [s.name for s in (*law.sensors, *law.inputs)]

    def true_readings(x: Array, u: Array, theta: Array) -> Array:
        own = law.true_readings(x, u, theta)
        inputs = np.broadcast_to(u, (*own.shape[:-1], u.shape[-1]))
        known = dict(zip(names, np.moveaxis(np.concatenate([own, inputs], axis=-1), -1, 0), strict=True))
        return np.concatenate([own, columns(*(reads(known) for _, _, reads in further))], axis=-1)

    sensors = (*law.sensors, *(Sensor(name, "", "1", sigma) for name, sigma, _ in further))
    return replace(law, sensors=sensors, true_readings=true_readings)


def signals(law: WrongLaw) -> list[Signal]:
    """The further channels of such a plant."""
    return [Signal(s.name, s.unit) for s in law.sensors if not s.measures]


TANKS: list[tuple[str, float, Reading]] = [
    ("pressure_1", 0.01, lambda v: 0.98 * v["level_1"]),
    ("weight_2", 0.02, lambda v: 2.5 * v["level_2"] ** 0.95),
    ("pump_power", 0.02, lambda v: 0.3 + 0.7 * v["feed"] * (1.2 + 0.3 * v["level_1"])),
    ("drain", 0.01, lambda v: v["outflow"] * 0.9 + 0.1 * v["flow_23"]),
    ("turbidity", 0.02, lambda v: 0.5 * v["flow_12"] / (0.3 + v["level_2"])),
]
