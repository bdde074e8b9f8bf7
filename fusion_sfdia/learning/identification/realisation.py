"""A scaled linear model as a plant, with states that have names and units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve

from fusion_sfdia.learning.identification.linear_gaussian import LinearGaussian
from fusion_sfdia.learning.identification.recording import Scaled
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]

LATER = 0.5  # weight of a reading one step later as a state: present readings are preferred


def plant_of(name: str, model: LinearGaussian, scale: Scaled, sensors: Sequence[Signal], inputs: Sequence[Signal]) -> Plant:
    """The plant of a model of scaled readings, in the readings' units.

    With T the n rows of (C; C A; C A^2; ...) that a QR decomposition with pivots chooses, of rows over the reading's noise, the
    states T x are values without noise of readings, now or some steps later without further input and noise: "true level",
    "true level 2 later".
    """
    A, B, C, Q, r, _, P0 = model
    n, count = len(A), len(C)
    powers = [np.eye(n)]
    while len(powers) < n:
        powers.append(powers[-1] @ A)
    rows = np.concatenate([C @ power for power in powers])
    weight = np.concatenate([LATER**k / np.sqrt(r) for k in range(n)])
    chosen = np.sort(qr((weight[:, None] * rows).T, mode="r", pivoting=True)[1][:n])
    which, later = chosen % count, chosen // count
    unit = scale.y_sd[which]
    T = unit[:, None] * rows[chosen]

    def of_states(matrix: Array) -> Array:
        return np.asarray(solve(T.T, matrix.T).T)  # matrix T^-1

    F, G = of_states(T @ A), T @ B / scale.u_sd
    H = of_states(scale.y_sd[:, None] * C)
    centre = scale.y_mean[which]  # x in own units is T x + centre
    names = [sensors[i].name + (f" {k} later" if k else "") for i, k in zip(which, later, strict=True)]
    return linear_plant(
        name, F, H, [
            Sensor(s.name, s.name, s.unit, sigma=float(sigma))
            for s, sigma in zip(sensors, scale.y_sd * np.sqrt(r), strict=True)
        ],
        dt=scale.dt, x0=centre, initial_cov=_symmetric(T @ P0 @ T.T), process_cov=_symmetric(T @ Q @ T.T),
        input_matrix=G, offset=centre - F @ centre - G @ scale.u_mean, output_offset=scale.y_mean - H @ centre,
        states=[Signal(f"true {s}", sensors[i].unit, float(x)) for s, i, x in zip(names, which, centre, strict=True)],
        inputs=[replace(s, nominal=float(mean)) for s, mean in zip(inputs, scale.u_mean, strict=True)],
    )  # fmt: skip


def _symmetric(P: Array) -> Array:
    return np.asarray((P + P.T) / 2)
