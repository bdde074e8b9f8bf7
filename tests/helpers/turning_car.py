"""A car that turns: three compasses from 0 to 360 degrees and a rate gyro, with models that count turns, or do not."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia import Plant, Sensor, Signal
from fusion_sfdia.plant.log import Log

Array = NDArray[Any]

TURN = 360.0
GYRO = 3  # its position among the sensors


def _step(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.stack([x[..., 0] + dt * x[..., 1], x[..., 1]], axis=-1)


def _step_within_a_turn(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.stack([np.mod(x[..., 0] + dt * x[..., 1], TURN), x[..., 1]], axis=-1)


def _output(t: float, x: Array, u: Array) -> Array:
    return x[..., [0, 0, 0, 1]]


def _output_within_a_turn(t: float, x: Array, u: Array) -> Array:
    return np.concatenate([np.mod(x[..., [0, 0, 0]], TURN), x[..., 1:]], axis=-1)


def car(model: str = "turns counted", period: float | None = TURN, start: float = 300.0) -> Plant:
    """model: "turns counted", "modulo in the output", or "modulo in the step", whose heading has limits of a turn, too."""
    step = _step_within_a_turn if model == "modulo in the step" else _step
    output = _output if model == "turns counted" else _output_within_a_turn
    limits = {"low": 0.0, "high": TURN} if model == "modulo in the step" else {}
    return Plant(
        "car",
        (
            Signal("heading", "deg", nominal=start, initial_sigma=2.0, process_sigma=0.2, period=period, **limits),
            Signal("rate", "deg/s", nominal=1.0, initial_sigma=0.2, process_sigma=0.02),
        ),
        (
            *(Sensor(f"compass_{i}", "heading", "deg", sigma=1.0) for i in (1, 2, 3)),
            Sensor("gyro", "rate", "deg/s", sigma=0.1),
        ),
        step,
        output,
        dt=1.0,
    )


def turning(seed: int, samples: int = 150, rate: float = 1.0, start: float = 300.0) -> Log:
    """Healthy readings of the car, with the turns counted; `within_a_turn` gives what a compass shows."""
    rng = np.random.default_rng(seed)
    t = np.arange(1.0, samples + 1)
    heading = start + rate * t
    y = np.column_stack([*(heading + rng.standard_normal(samples) for _ in range(3)), np.full(samples, rate)])
    y[:, GYRO] += 0.1 * rng.standard_normal(samples)
    return Log(t, y, np.zeros((samples, 0)))


def within_a_turn(log: Log) -> Log:
    """What the compasses show."""
    y = log.y.copy()
    y[:, :GYRO] = np.mod(y[:, :GYRO], TURN)
    return log._replace(y=y)
