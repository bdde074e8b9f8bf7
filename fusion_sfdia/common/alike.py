"""Arrays that are the same for all runs of a batch: computed once, and repeated along the first axis without a copy.

A filter on a plant with constant Jacobians has the same covariances and gains in all runs whose readings in use are the same.
Such an array (B, ..) is in memory once, which NumPy shows as a stride of 0 on its first axis. Functions take it by `single` as
(1, ..), whose products have the same bits as those of each run, and hand it on by `repeated`. Whatever makes runs differ (a
missing reading, an isolated sensor) makes an ordinary array of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def single(a: Array) -> Array:
    """The array (1, ..) that all runs of a (B, ..) share; a itself where they differ or are one."""
    return a[:1] if a.ndim > 1 and a.shape[0] > 1 and a.strides[0] == 0 else a


def repeated(a: Array, runs: Array) -> Array:
    """What is (1, ..) for each of the runs (B, ..), without a copy; a itself where it is (B, ..) already."""
    return np.broadcast_to(a, (len(runs), *a.shape[1:])) if a.shape[0] == 1 < len(runs) else a


def for_all(a: Array, batch: tuple[int, ...]) -> Array:
    """The array (*batch, ..) in which all runs have a copy of a (..), the same one for a batch of one axis."""
    found: Array = np.array(np.broadcast_to(a, (1, *a.shape) if len(batch) == 1 else (*batch, *a.shape)))
    return np.broadcast_to(found, (*batch, *a.shape)) if len(batch) == 1 and batch[0] > 1 else found


def chosen(a: Array, runs: Array) -> Array:
    """Some runs of a (B, ..), by their indices."""
    shared = single(a)
    return a[runs] if shared is a or not runs.size else np.broadcast_to(shared, (runs.size, *a.shape[1:]))


def joined(a: Array, b: Array) -> Array:
    """The runs of a (B, ..) and those of b (C, ..); what is the same for all of both stays so."""
    one, other = single(a), single(b)
    if one.ndim > 1 and one.shape[0] == other.shape[0] == 1 and np.array_equal(one, other):
        return np.broadcast_to(one, (len(a) + len(b), *a.shape[1:]))
    return np.concatenate([a, b])


def shared_again(a: Array, before: Array) -> Array:
    """The array a (B, ..) as one that all runs share, where they shared `before` and are the same still."""
    if single(a) is not a or single(before) is before or not np.array_equal(a, np.broadcast_to(a[:1], a.shape)):
        return a
    return np.broadcast_to(a[:1].copy(), a.shape)
