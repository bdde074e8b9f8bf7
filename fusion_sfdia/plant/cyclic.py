"""Cyclic values, such as a compass heading: two that differ by a whole number of periods are the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class Cyclic(NamedTuple):
    """The positions (k,) of the cyclic ones among several values, and their periods (k,)."""

    at: Array
    period: Array


def cyclic(periods: Sequence[float | None]) -> Cyclic | None:
    """The cyclic ones of values with these periods, None for one that is not cyclic; None where none is."""
    found = [(i, abs(p)) for i, p in enumerate(periods) if p is not None]
    return Cyclic(np.array([i for i, _ in found]), np.array([p for _, p in found])) if found else None


def near(values: Array, expected: Array, of: Cyclic | None) -> Array:
    """Return the values (..., N) with cyclic ones moved by whole periods into [expected - period / 2, expected + period / 2).

    The difference of the two is then the wrapped one. The same array where none is cyclic; values stay as they are where
    either number is not finite.
    """
    if of is None:
        return values
    moved = np.array(np.broadcast_to(values, np.broadcast_shapes(np.shape(values), np.shape(expected))))
    with np.errstate(invalid="ignore"):
        turns = np.floor((moved[..., of.at] - np.asarray(expected)[..., of.at]) / of.period + 0.5)
    moved[..., of.at] -= np.where(np.isfinite(turns), turns, 0.0) * of.period
    return moved
