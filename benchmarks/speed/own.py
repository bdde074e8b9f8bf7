"""bench own: a first own plant, written in NumPy as in the tutorial, without anything compiled for it.

step_time of a row of a diagnosed log of 300 rows (`a row of diagnose`), and of a step of one stream, against the plant's model
step (`step`: step and Jacobian of one state).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.speed.support.calls import Call, repeated_step, time_row, timed, timed_rows
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.report.results import Row

Array = NDArray[Any]

DETECTORS = ("loo-glr", "robust-glr")
ROWS = 300
MODEL = "model step"


def step(t_start: float, x: Array, u: Array, dt: float) -> Array:
    """The heated tank of docs/guide/your-plant.md: level (m) and temperature (K) dt seconds later."""
    level, temperature = x[..., 0], x[..., 1]
    inflow, power = u[..., 0], u[..., 1]
    level_rate = inflow - 1e-3 * np.sqrt(level)
    temperature_rate = (inflow * (290.0 - temperature) + power / 4.18e6) / level
    return np.stack([level + dt * level_rate, temperature + dt * temperature_rate], axis=-1)


def output(t: float, x: Array, u: Array) -> Array:
    """Level twice, temperature twice."""
    found: Array = x[..., [0, 0, 1, 1]]
    return found


def tank() -> Plant:
    """The plant, with readings once a minute."""
    level = Signal("level", "m", nominal=1.0, low=0.1, high=3.0, initial_sigma=0.02, process_sigma=1e-3)
    temperature = Signal("temperature", "K", nominal=300.0, low=273.0, high=373.0, initial_sigma=0.5, process_sigma=0.02)
    return Plant(
        "heated-tank",
        states=(level, temperature),
        sensors=(
            *(Sensor(f"level_{i}", "level", "m", sigma=0.01, quantity="level") for i in (1, 2)),
            *(Sensor(f"temperature_{i}", "temperature", "K", sigma=0.2, quantity="temperature") for i in (1, 2)),
        ),
        step=step,
        output=output,
        dt=60.0,
        inputs=(Signal("inflow", "m^3/s", nominal=1e-3), Signal("power", "W", nominal=41.8e3)),
    )


def measure(seconds: float) -> list[Row]:
    """Both detectors on healthy readings."""
    plant = tank()
    recording = simulate(plant, ROWS, seeds=[1])
    x, u = plant.x0[None], plant.input_at(0.0)[None]

    def model() -> None:
        plant.step(0.0, x, u, plant.dt)
        plant.step_jacobian_at(0.0, x, u, plant.dt)

    rows: list[Row] = []
    for name in DETECTORS:
        detector = registry.detector(name, plant)
        calls: dict[str, Call] = {
            "one stream": repeated_step(detector),
            "a row of diagnose": partial(diagnose, detector, recording),
        }
        times = timed(calls, seconds, MODEL, model)
        rows += timed_rows("own", plant.name, name, "one stream", times["one stream"])
        rows += timed_rows("own", plant.name, name, "a row of diagnose", times["a row of diagnose"], 1 / ROWS)
    base = times["one stream"]
    return [*rows, time_row("own", plant.name, "none", "step", "step_time", base.base, base.calls)]
