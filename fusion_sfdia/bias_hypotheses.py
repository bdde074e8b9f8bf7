"""Which sensor explains the residuals: for each, the sizes of a constant fault that leave every residual within its threshold.

A fault b of sensor i that began at some time changes the residuals of this step and of the last one by known shares of b:

    it began now           not at all, then e_i
    it began a step ago    e_i, then (1 - M + L) e_i
    it began long ago      (1 - L)^-1 (1 - M) e_i at both

where M is what the readings of the last step have in the expected ones, and L what its residuals have in the present ones.
Each residual within its threshold of share b gives an interval of b; intersected over all residuals and both steps they are
the sizes that explain everything. A sensor none of whose sizes does is excluded: if all are, the fault is none of these. Of
those that are left the least sum of squares, in units of the deviations, has the name.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class Evidence(NamedTuple):
    """Residuals (R, N) of a step, NaN where not evaluated, their standard deviations and thresholds (inf: says nothing)."""

    residual: Array
    deviation: Array
    threshold: Array


class Explanation(NamedTuple):
    """The sensor (R,) that explains the residuals best, -1 where none does; the interval and the estimate of its fault (R,)."""

    sensor: Array
    low: Array
    high: Array
    size: Array


def explain(before: Evidence, now: Evidence, from_readings: Array, from_residuals: Array, suspects: Array) -> Explanation:
    """Explain R runs by one of the suspects (R, N) each; from_readings M and from_residuals L (R, N, N)."""
    one = np.broadcast_to(np.eye(suspects.shape[-1]), from_readings.shape)
    fresh = one - from_readings
    lasting = np.linalg.solve(one - from_residuals, fresh)
    found = [_sizes(before, now, *shares) for shares in ((0.0 * one, one), (one, fresh + from_residuals), (lasting, lasting))]
    low, high, size, cost = (np.concatenate(parts, axis=-1) for parts in zip(*found, strict=True))
    cost = np.where((low <= high) & np.tile(suspects, 3), cost, np.inf)
    best = np.argmin(cost, axis=-1)[:, None]
    chosen = (np.take_along_axis(a, best, axis=-1)[:, 0] for a in (low, high, size))
    explained = np.isfinite(np.take_along_axis(cost, best, axis=-1)[:, 0])
    return Explanation(np.where(explained, best[:, 0] % suspects.shape[-1], -1), *chosen)


def _sizes(before: Evidence, now: Evidence, share_before: Array, share_now: Array) -> tuple[Array, Array, Array, Array]:
    """(R, N) each: interval of the faults that explain the residuals, the best of them, and its sum of squares."""
    residual, deviation, threshold = (np.concatenate(parts, axis=-1)[..., None] for parts in zip(before, now, strict=True))
    share = np.concatenate([share_before, share_now], axis=-2)
    says = np.isfinite(residual) & np.isfinite(threshold)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ends = np.stack([(residual - threshold) / share, (residual + threshold) / share])
        without = np.where(np.abs(residual) > threshold, np.nan, np.inf)  # of no share: explained already, or never
        least = np.where(share == 0.0, -without, np.minimum(*ends))
        most = np.where(share == 0.0, without, np.maximum(*ends))
    low = np.max(np.where(says, least, -np.inf), axis=-2)
    high = np.min(np.where(says, most, np.inf), axis=-2)
    weight = np.where(says, 1.0 / np.where(says, deviation, 1.0) ** 2, 0.0)
    value = np.where(says, residual, 0.0)
    square, product = np.sum(weight * share**2, axis=-2), np.sum(weight * share * value, axis=-2)
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.clip(product / square, low, high)
    cost = np.sum(weight * value**2, axis=-2) - 2 * size * product + size**2 * square
    return low, high, size, np.where(np.isfinite(cost), cost, np.inf)
