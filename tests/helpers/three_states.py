"""A linear model of three states and two sensors, and nonlinear ones of the same size."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


F = np.array([[1.0, 0.1, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.1, 0.8]])


H = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])


Q, R = np.array([0.01, 0.0, 0.04]), np.array([0.1, 0.3])


def f(x: Array) -> Array:
    return np.asarray(x @ F.T)


def h(x: Array) -> Array:
    return np.asarray(x @ H.T)


def bend(x: Array) -> Array:
    """A nonlinear step, analytic."""
    return np.stack(
        [x[..., 0] + 0.1 * x[..., 1], x[..., 1] - 0.5 * np.sin(x[..., 0]), x[..., 2] * np.exp(-0.1 * x[..., 1])], -1
    )


def look(x: Array) -> Array:
    """Nonlinear readings of two sensors."""
    return np.stack([np.sin(x[..., 0]) + x[..., 2], x[..., 1] * x[..., 2]], -1)
