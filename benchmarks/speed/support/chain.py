"""A linear plant of any size: a chain of coupled states, one sensor each."""

from __future__ import annotations

import numpy as np

from fusion_sfdia.core.linear import linear_plant
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.signals import Sensor


def chain(sensors: int) -> Plant:
    """x_i+ = 0.95 x_i + 0.03 x_{i+1} + w_i, y_i = x_i + v_i for i = 1 .. sensors, with sd 0.1 of w and 1 of v."""
    return linear_plant(
        "chain",
        0.95 * np.eye(sensors) + 0.03 * np.eye(sensors, k=1),
        np.eye(sensors),
        [Sensor(f"y{i}", f"x{i}", sigma=1.0) for i in range(sensors)],
        dt=1.0,
        x0=np.zeros(sensors),
        initial_cov=np.ones(sensors),
        process_cov=np.full(sensors, 0.01),
    )
