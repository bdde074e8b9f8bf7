"""Healthy logs whose model is known: four sensors and a load."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

SENSORS = tuple(Signal(name, unit) for name, unit in (("a", "K"), ("b", "bar"), ("c", "K"), ("d", "m3/h")))
LOAD = Signal("load", "kW")
STEPS = 160
DT = 2.0


def load(rng: np.random.Generator, steps: int) -> Array:
    return 50 + 20 * rng.uniform(-1, 1) + 5 * np.repeat(rng.standard_normal(steps // 20 + 1), 20)[:steps, None]


def of_autoregression(seed: int, steps: int = STEPS) -> Log:
    """Four sensors that depend on each other's reading before and on the load, with correlated errors."""
    rng = np.random.default_rng(seed)
    A = np.array([[0.7, 0.2, 0.0, 0.0], [0.0, 0.6, 0.0, 0.3], [0.2, 0.0, 0.7, 0.0], [0.0, -0.3, 0.0, 0.6]])
    half = np.linalg.cholesky(0.5 * np.eye(4) + 0.5)
    u, y = load(rng, steps), np.zeros((steps, 4))
    for k in range(steps):
        y[k] = A @ y[k - 1] + 0.02 * u[k] + half @ rng.standard_normal(4) if k else 4.0
    return Log(DT * np.arange(steps), y + 300, u)


def of_factor(seed: int, steps: int = STEPS, bend: float = 0.0) -> Log:
    """Four readings of one thing that moves with the load, each with white noise and an offset that drifts slowly."""
    rng = np.random.default_rng(seed)
    u = load(rng, steps)
    drift = np.cumsum(0.03 * rng.standard_normal((steps, 4)), axis=0) + 0.5 * rng.standard_normal(4)
    thing = np.cumsum(0.2 * rng.standard_normal((steps, 1)), axis=0) + 0.3 * rng.standard_normal((steps, 1))
    y = thing * [1.0, -2.0, 0.5, 1.5] + (0.1 * u + bend * (u - 50) ** 2) * [1.0, 0.5, -1.0, 2.0] + drift
    return Log(DT * np.arange(steps), y + 0.3 * rng.standard_normal(y.shape), u)
