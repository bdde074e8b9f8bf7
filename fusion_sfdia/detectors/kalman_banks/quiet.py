"""A test for readings that are too quiet: frozen, or with less noise than the sensor has.

Half the squared difference of two successive readings over the variance of the noise is at least chi-square distributed with 1
degree of freedom, more where the measured variable changes, if the noise is independent and of the stated size. Correlated
noise, Var(y_k - y_k-1) = 2 sigma^2 (1 - rho), and smaller noise have smaller differences, coarse readings many that are 0. So
readings are compared with what the sensor itself has shown: the sum over pairs that share no reading is too small where it is
below the lower quantile of chi-square, times the level that these squares have had on average, and where so many zeros in a
row have at most that probability, too. A constant reading has the sum 0. What a sensor with a stated resolution reads may
have changed by that more than its readings have.
"""

from __future__ import annotations

from functools import lru_cache
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from fusion_sfdia.derivatives.equation import plain, python_first

Array = NDArray[Any]

PAIRS = 8  # with which a sum has a lower quantile well above that of a frozen, rounded reading
SHOWN = 16  # pairs that a sensor has to have shown before
MEMORY = 64.0  # pairs in the level and in the share of zeros
CUT = 4.0  # times the level that a square counts at most
SLOWER = 0.1  # share with which squares are learnt that are too small: a frozen reading does not become usual
UNSURE = 0.7  # of the limit: the level is an estimate


class Pairs(NamedTuple):
    """The first reading of a pair (..., N), NaN for none, and the squares of the last pairs (..., PAIRS, N), inf for none.

    level, zeros, shown (..., N): mean of the squares before those, at most 1, share of 0 among them, and their number.
    """

    first: Array
    squares: Array
    level: Array
    zeros: Array
    shown: Array


def no_pairs(batch: tuple[int, ...], sensors: int) -> Pairs:
    """Return the memory before the first readings."""
    shape = (*batch, sensors)
    return Pairs(
        np.full(shape, np.nan), np.full((*batch, PAIRS, sensors), np.inf), np.ones(shape), np.zeros(shape), np.zeros(shape)
    )


def paired(now: Pairs, y: Array, sigma: Array, resolution: Array, false_alarm: float) -> Pairs:
    """Add the readings y (..., N), NaN where missing; sigma (N,) of their noise, resolution (N,), 0 for none.

    What is too quiet is learnt slowly.
    """
    N = y.shape[-1]
    level, zeros, shown, readings = (plain(v.reshape(-1, N)) for v in (now.level, now.zeros, now.shown, y))
    first, squares = plain(now.first.reshape(-1, N)), plain(now.squares.reshape(-1, PAIRS, N))
    found = _paired(first, squares, level, zeros, shown, readings, sigma, resolution, UNSURE * _limit(false_alarm))
    return Pairs(*(v.reshape(known.shape) for v, known in zip(found, now, strict=True)))


@python_first
def _paired(
    first: Array,
    squares: Array,
    level: Array,
    zeros: Array,
    count: Array,
    y: Array,
    sigma: Array,
    resolution: Array,
    limit: float,
) -> tuple[Array, Array, Array, Array, Array]:
    """The same of B runs. The square that leaves is learnt, so that what is too quiet is seen before it becomes usual."""
    after, shifted = np.empty(y.shape), squares.copy()
    mean, share, number = level.copy(), zeros.copy(), count.copy()
    for r in range(y.shape[0]):
        for i in range(y.shape[1]):
            after[r, i] = y[r, i]
            change = abs(y[r, i] - first[r, i]) + resolution[i]
            square = change * change / (2 * (sigma[i] * sigma[i]))
            if isfinite(square):
                after[r, i] = np.nan
                last = squares.shape[1] - 1
                total = 0.0
                for k in range(last + 1):
                    total += squares[r, k, i]
                number[r, i] += isfinite(squares[r, last, i])
                if isfinite(total):
                    part = 1.0 / min(number[r, i] + 1.0, MEMORY)
                    if number[r, i] >= SHOWN and total < limit * mean[r, i]:
                        part *= SLOWER
                    mean[r, i] += (min(squares[r, last, i], CUT * mean[r, i]) - mean[r, i]) * part
                    mean[r, i] = min(mean[r, i], 1.0)
                    share[r, i] += ((1.0 if squares[r, last, i] == 0 else 0.0) - share[r, i]) * part
                for k in range(last, 0, -1):
                    shifted[r, k, i] = squares[r, k - 1, i]
                shifted[r, 0, i] = square
    return after, shifted, mean, share, number


def too_quiet(now: Pairs, false_alarm: float) -> Array:
    """Whether the pairs of each sensor are too quiet (..., N), with about that probability for one as it has been."""
    small = now.squares.sum(axis=-2) < UNSURE * _limit(false_alarm) * now.level
    if not small.any():
        return np.asarray(small)
    usual = now.zeros ** np.sum(now.squares == 0, axis=-2) > false_alarm
    return np.asarray(small & (now.shown >= SHOWN) & ~(usual & np.any(now.squares == 0, axis=-2)))


def quietest(now: Pairs, quiet: Array, room: Array) -> Array:
    """Of the sensors that are too quiet (..., N) as many as there is room for (...), the quietest for their level first."""
    ratio = np.where(quiet, now.squares.sum(axis=-2) / np.maximum(now.level, np.finfo(float).tiny), np.inf)
    place = np.argsort(np.argsort(ratio, axis=-1, kind="stable"), axis=-1)
    return np.asarray(quiet & (place < room[..., None]))


@lru_cache
def _limit(false_alarm: float) -> float:
    return 2 * float(gammaincinv(PAIRS / 2, false_alarm))  # the quantile of chi-square with PAIRS degrees of freedom
