"""Healthy logs of sensors that measure a few slow factors, for a monitor without a model; every value is missing nowhere."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]


def factors(seed: int, rows: int = 1500, sensors: int = 8, process: slice = slice(0)) -> Array:
    """Readings (K, N) of three slow factors, each with autocorrelated noise of its own; a plant for each ten seeds.

    process: rows in which the factors act on the sensors in exchanged roles.
    """
    C = np.random.default_rng(seed // 10).standard_normal((sensors, 3))
    size = 0.3 + 0.7 * np.random.default_rng(seed // 10 + 1).random(sensors)
    rng = np.random.default_rng(seed)
    kept = np.array([0.98, 0.9, 0.5])
    f, e, n, m = (
        np.zeros((rows, 3)),
        np.zeros((rows, sensors)),
        rng.standard_normal((rows, 3)),
        rng.standard_normal((rows, sensors)),
    )
    for k in range(1, rows):
        f[k] = kept * f[k - 1] + np.sqrt(1 - kept**2) * n[k]
        e[k] = 0.6 * e[k - 1] + 0.8 * m[k]
    f[process] = f[process, ::-1]
    return f @ C.T + e * size


def runs_with_offsets(seed: int, count: int, offset: float) -> list[Array]:
    """Runs (800, 10), each at an operating point of its own on a curve and with offsets of so many standard deviations."""
    rng = np.random.default_rng(seed)
    C, bend, size = rng.standard_normal((10, 2)), 0.3 * rng.standard_normal(10), 0.3 + 0.5 * rng.random(10)
    runs = []
    for _ in range(count):
        f, n = np.zeros((800, 2)), rng.standard_normal((800, 2))
        for k in range(1, 800):
            f[k] = [0.95, 0.8] * f[k - 1] + np.sqrt([1 - 0.95**2, 0.36]) * n[k]
        x = f * [0.5, 1.0] + [rng.uniform(-1, 1), 0.0]
        noise = size * rng.standard_normal((800, 10)) + offset * rng.standard_normal(10)
        runs.append(x @ C.T + np.outer(x[:, 0] ** 2, bend) + noise)
    return runs


def log_of(y: Array, dt: float = 60.0) -> Log:
    return Log(dt * np.arange(len(y)), y, np.zeros((len(y), 0)))


def signals(count: int) -> list[Signal]:
    return [Signal(f"s{i}") for i in range(count)]
