"""Linear plants of any size, one sensor for each state: all states coupled, or a chain."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor


def coupled(sensors: int) -> Plant:
    """x_i+ = 0.9 x_i + 0.05 mean(x) + w_i, y_i = x_i + v_i for i = 1 .. sensors, with sd 0.1 of w and 1 of v.

    Each state moves each, so that no zero of a matrix saves work.
    """
    return _plant("coupled", 0.9 * np.eye(sensors) + 0.05 / sensors)


def chained(states: int) -> Plant:
    """x_i+ = 0.95 x_i + 0.03 x_(i + 1) + w_i, y_i = x_i + v_i, with sd 0.1 of w and 1 of v."""
    return _plant("chain", 0.95 * np.eye(states) + 0.03 * np.eye(states, k=1))


def _plant(name: str, F: NDArray[Any]) -> Plant:
    n = len(F)
    return linear_plant(
        name,
        F,
        np.eye(n),
        [Sensor(f"y{i}", f"x{i}", sigma=1.0) for i in range(n)],
        dt=1.0,
        x0=np.zeros(n),
        initial_cov=np.ones(n),
        process_cov=np.full(n, 0.01),
    )
