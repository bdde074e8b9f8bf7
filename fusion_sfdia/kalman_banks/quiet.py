"""A test for readings that are too quiet: frozen, or with less noise than the sensor has.

Half the squared difference of two successive readings over the variance of the noise is at least chi-square distributed with 1
degree of freedom, more where the measured variable changes. The sum over pairs that share no reading is therefore below the
lower quantile of the chi-square distribution with at most its probability. A constant reading has the sum 0. What a sensor
with a resolution reads may have changed by that more than its readings have.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from fusion_sfdia.core.equation import compiled, plain

Array = NDArray[Any]

PAIRS = 8  # with which a sum has a lower quantile well above that of a frozen, rounded reading


class Pairs(NamedTuple):
    """The first reading of a pair (..., N), NaN for none, and the squares of the last pairs (..., PAIRS, N), inf for none."""

    first: Array
    squares: Array


def no_pairs(batch: tuple[int, ...], sensors: int) -> Pairs:
    """Return the memory before the first readings."""
    return Pairs(np.full((*batch, sensors), np.nan), np.full((*batch, PAIRS, sensors), np.inf))


def paired(now: Pairs, y: Array, sigma: Array, resolution: Array) -> Pairs:
    """Add the readings y (..., N), NaN where missing; sigma (N,) of their noise, resolution (N,) 0 for none."""
    N = y.shape[-1]
    first, squares = _paired(
        plain(now.first.reshape(-1, N)), plain(now.squares.reshape(-1, PAIRS, N)), plain(y.reshape(-1, N)), sigma, resolution
    )
    return Pairs(first.reshape(y.shape), squares.reshape(now.squares.shape))


@compiled
def _paired(first: Array, squares: Array, y: Array, sigma: Array, resolution: Array) -> tuple[Array, Array]:
    """The same of B runs."""
    after, shifted = np.empty(y.shape), squares.copy()
    for r in range(y.shape[0]):
        for i in range(y.shape[1]):
            after[r, i] = y[r, i]
            change = abs(y[r, i] - first[r, i]) + resolution[i]
            square = change * change / (2 * (sigma[i] * sigma[i]))
            if np.isfinite(square):
                after[r, i] = np.nan
                for k in range(squares.shape[1] - 1, 0, -1):
                    shifted[r, k, i] = squares[r, k - 1, i]
                shifted[r, 0, i] = square
    return after, shifted


def too_quiet(now: Pairs, false_alarm: float) -> Array:
    """Whether the pairs of each sensor are too quiet (..., N), with at most that probability for one with its noise."""
    return np.asarray(now.squares.sum(axis=-2) < _limit(false_alarm))


@lru_cache
def _limit(false_alarm: float) -> float:
    return 2 * float(gammaincinv(PAIRS / 2, false_alarm))  # the quantile of chi-square with PAIRS degrees of freedom
