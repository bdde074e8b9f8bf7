"""A linear plant of any size: coupled states, one sensor each."""

from __future__ import annotations

import numpy as np

from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor


def coupled(sensors: int) -> Plant:
    """x_i+ = 0.9 x_i + 0.05 mean(x) + w_i, y_i = x_i + v_i for i = 1 .. sensors, with sd 0.1 of w and 1 of v.

    Each state moves each, so that no zero of a matrix saves work.
    """
    return linear_plant(
        "coupled",
        0.9 * np.eye(sensors) + 0.05 / sensors,
        np.eye(sensors),
        [Sensor(f"y{i}", f"x{i}", sigma=1.0) for i in range(sensors)],
        dt=1.0,
        x0=np.zeros(sensors),
        initial_cov=np.ones(sensors),
        process_cov=np.full(sensors, 0.01),
    )
