"""Equations to invert, their solutions by evaluation, and whether boxes cover points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fusion_sfdia.derivatives.equation import equation
from fusion_sfdia.derivatives.intervals.interval import Interval


@equation
def ring(x: Any, y: Any) -> Any:
    return x**2 + y**2


def samples(box: Interval, n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(box.lo, box.hi, (n, *box.shape))


def covered(points: np.ndarray, boxes: Interval) -> np.ndarray:
    """Whether each point (n, d) is in one of the boxes (m, d)."""
    return np.all((boxes.lo <= points[:, None]) & (points[:, None] <= boxes.hi), axis=-1).any(axis=-1)


EQUATIONS: dict[str, Callable[..., Any]] = {
    "ring": ring,
    "product": lambda x, y: x * y,
    "quotient": lambda x, y: x / y,
    "root": lambda x, y: np.sqrt(x) - y,
    "powers": lambda x, y: x**3 - 2.0 * y**-1 + abs(y) ** 1.4,
    "exponential": lambda x, y: np.exp(x * y) - np.log(x + 4.0) + np.tanh(y),
    "logs": lambda x, y: np.log10(np.square(x) + 1) * np.log1p(abs(y)) - np.expm1(x / 3),
    "kinks": lambda x, y: np.minimum(x, y) + np.maximum(2 * x, -y) - abs(x),
    "waves": lambda x, y: np.sin(x) * np.cos(y) + np.arctanh(x / 4),
    "two": lambda x, y: (x + y, x * y),
    "exponent": lambda x, y: (x + 4.0) ** y,
    "reciprocal": lambda x, y: np.reciprocal(x) + np.positive(-y),
}


def target_of(name: str) -> Any:
    return (Interval(-1.0, 1.0), Interval(0.2, 0.7)) if name == "two" else Interval(0.2, 0.7)


def meets(name: str, points: np.ndarray) -> np.ndarray:
    with np.errstate(all="ignore"):
        results = EQUATIONS[name](*points.T)
    targets = target_of(name)
    pairs = zip(results, targets, strict=True) if name == "two" else [(results, targets)]
    return np.all([(t.lo <= r) & (r <= t.hi) for r, t in pairs], axis=0)
