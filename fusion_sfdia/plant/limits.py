"""States within their limits, and steps that end in numbers: a compiled loop over the states of each run."""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import compiled, plain, python_first

Array = NDArray[Any]


def within(x: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return x (..., n) moved to between low and high (n,), and whether anything was moved, or is NaN (...)."""
    inside, moved = _within(plain(x.reshape(-1, x.shape[-1])), low, high)
    return inside.reshape(x.shape), moved.reshape(x.shape[:-1])


def finite(x: Array) -> Array:
    """Whether all numbers of x (..., n) are finite (...)."""
    found: Array = _finite(plain(x.reshape(-1, x.shape[-1])))
    return found.reshape(x.shape[:-1])


@python_first
def _within(x: Array, low: Array, high: Array) -> tuple[Array, Array]:
    inside, moved = np.empty(x.shape), np.empty(x.shape[0], np.bool_)
    for r in range(x.shape[0]):
        moved[r] = False
        for i in range(x.shape[1]):
            value = x[r, i]
            if value < low[i]:
                value = low[i]
            if value > high[i]:
                value = high[i]
            inside[r, i] = value
            moved[r] |= value != x[r, i]
    return inside, moved


@compiled
def _finite(x: Array) -> Array:
    found = np.empty(x.shape[0], np.bool_)
    for r in range(x.shape[0]):
        found[r] = True
        for i in range(x.shape[1]):
            found[r] &= isfinite(x[r, i])
    return found
