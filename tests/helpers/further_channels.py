"""Plants of `wrong_laws` and `unseen_laws` whose logs have further channels, of which their models know nothing."""

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


ROOM: list[tuple[str, float, Reading]] = [
    ("duct_t", 0.15, lambda v: v["supply_t"] - 0.05 * (v["supply_t"] - v["room_t"])),
    ("wall_t", 0.1, lambda v: 0.85 * v["room_t"] + 0.15 * v["outdoor"]),
    ("fan_power", 0.01, lambda v: 0.1 + v["fan"] ** 2.7),
    ("boiler_power", 0.15, lambda v: v["water"] * (v["boiler"] - v["return_t"]) * 1.05),
    ("pump_power", 0.005, lambda v: 0.2 + 0.5 * v["water"] ** 1.3),
]
TANKS: list[tuple[str, float, Reading]] = [
    ("pressure_1", 0.01, lambda v: 0.98 * v["level_1"]),
    ("weight_2", 0.02, lambda v: 2.5 * v["level_2"] ** 0.95),
    ("pump_power", 0.02, lambda v: 0.3 + 0.7 * v["feed"] * (1.2 + 0.3 * v["level_1"])),
    ("drain", 0.01, lambda v: v["outflow"] * 0.9 + 0.1 * v["flow_23"]),
    ("turbidity", 0.02, lambda v: 0.5 * v["flow_12"] / (0.3 + v["level_2"])),
]
MAIN: list[tuple[str, float, Reading]] = [
    ("well_pressure", 0.03, lambda v: 1.02 * v["well_level"] + 0.1),
    ("suction", 0.02, lambda v: v["well_level"] - 0.3 * v["pump_flow"] ** 2),
    ("pump_power", 0.02, lambda v: v["speed"] ** 2.4 + 0.2 * v["pump_flow"]),
    ("street_head", 0.15, lambda v: 0.6 * v["near_head"] + 0.4 * v["far_head"]),
    ("meters", 0.03, lambda v: 0.95 * v["demand_flow"]),
    ("vibration", 0.02, lambda v: 0.3 * v["speed"] ** 1.5 * (1 + 0.1 * v["pump_flow"])),
]
PUMP: list[tuple[str, float, Reading]] = [
    ("flow_t", 0.2, lambda v: v["top_t"] - 0.2),
    ("store_t", 0.15, lambda v: 0.6 * v["top_t"] + 0.4 * v["bottom_t"]),
    ("current", 0.05, lambda v: 2.2 * v["power"] + 0.3),
    ("brine_out", 0.2, lambda v: v["brine_t"] - 0.4 * v["source"]),
    ("room_t", 0.1, lambda v: 0.5 * v["back_t"] + 0.1 * v["top_t"]),
    ("circulation", 0.02, lambda v: 0.9 * v["draw"] ** 1.1),
]
REACTOR: list[tuple[str, float, Reading]] = [
    ("wall_t", 0.2, lambda v: 0.7 * v["reactor_low"] + 0.3 * v["jacket_t"]),
    ("density", 0.01, lambda v: 1.1 - 0.08 * v["analyser"] + 0.001 * v["reactor_low"]),
    ("return_t", 0.2, lambda v: v["jacket_t"] - 1.0),
    ("stirrer", 0.03, lambda v: 1.0 + 0.4 * v["analyser"] * v["feed"]),
    ("valve_head", 0.01, lambda v: 0.8 * v["coolant"] ** 1.5),
]
