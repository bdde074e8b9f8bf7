"""Limits from healthy values: the order statistic that a fresh value exceeds at a stated rate."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def exceedance_rank(count: int, rate: float) -> int:
    """Return k: a fresh value exceeds the k-th smallest of `count` exchangeable ones with a probability of at most `rate`.

    k = ceil((count + 1) (1 - rate)); larger than `count` where there are too few values for so low a rate.
    """
    return int(np.ceil((count + 1) * (1 - rate) - 1e-9))  # rounding must not pass a whole number


def order_statistic(values: Array, rate: float) -> Array:
    """Return the value of that rank among values (M, ...), the largest where none has it."""
    rank = min(exceedance_rank(len(values), rate), len(values))
    return np.asarray(np.partition(values, rank - 1, axis=0)[rank - 1])
