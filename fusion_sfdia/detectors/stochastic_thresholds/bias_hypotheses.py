"""Sensor faults that explain the residuals: sizes of a constant fault with which all affected residuals are within thresholds.

A fault b of sensor i changes the residuals of the last and of this step by known shares of b, which depend on its onset:

    onset now           0, then e_i
    onset a step ago    e_i, then (1 - M + L) e_i
    onset long ago      (1 - L)^-1 (1 - M) e_i in both steps

where M is the derivative of the expected readings by the readings of the last step, and -L the derivative by its residuals. The
reach of a sensor is its own residual and all residuals that depend on it through M or L: in a network, those of its area and of
the areas that share its variable.

The sizes b for which a residual less share b is within its threshold are an interval. The intersection over the reach and both
steps contains the sizes that explain all of these residuals. A sensor with an empty intersection is excluded; if all sensors
are excluded, the fault is none of these. Of the other sensors that explain an alarm, the one with the largest log-likelihood
ratio to "no fault" is isolated, then the best of those whose reach does not overlap with that of the first, and so on: faults
far from each other are isolated in one step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class StepResiduals(NamedTuple):
    """Residuals (R, N) of a step, NaN where not evaluated, their standard deviations and thresholds (inf: not testable yet)."""

    residual: Array
    deviation: Array
    threshold: Array


class Explanation(NamedTuple):
    """Result for each run and sensor, (R, N) each.

    isolated: bool. low, high, size: interval and estimate of the fault under the best hypothesis of the sensor. late: whether
    the fault began before this step, so that it affects the expected readings.
    """

    isolated: Array
    low: Array
    high: Array
    size: Array
    late: Array


def explain(
    before: StepResiduals, now: StepResiduals, from_readings: Array, from_residuals: Array, suspects: Array
) -> Explanation:
    """Return the explanation of the residuals of R runs by sensors among `suspects` (R, N) bool.

    from_readings: M, from_residuals: L, both (R, N, N).
    """
    one = np.broadcast_to(np.eye(suspects.shape[-1]), from_readings.shape)
    reach = (one != 0) | (from_readings != 0) | (from_residuals != 0)
    fresh = one - from_readings
    lasting = np.linalg.solve(one - from_residuals, fresh)
    hypotheses = (0.0 * one, one), (one, fresh + from_residuals), (lasting, lasting)
    found = [_sizes(before, now, np.where(reach, a, 0.0), np.where(reach, b, 0.0), reach) for a, b in hypotheses]
    low, high, size, gain = (np.stack(parts) for parts in zip(*found, strict=True))
    explains = (low <= high) & ~((low <= 0) & (high >= 0))
    gain = np.where(explains & suspects, gain, -np.inf)
    best = np.argmax(gain, axis=0)[None]
    low, high, size, gain = (np.take_along_axis(a, best, axis=0)[0] for a in (low, high, size, gain))
    return Explanation(_apart(gain, reach), low, high, size, best[0] > 0)


def _apart(gain: Array, reach: Array) -> Array:
    """Return (R, N) bool: the best sensor, then the best of those whose reach overlaps with that of no chosen one."""
    isolated = np.zeros(gain.shape, bool)
    runs, gain = np.arange(len(gain)), gain.copy()
    while np.any(gain > -np.inf):
        best = np.argmax(gain, axis=-1)
        found = gain[runs, best] > -np.inf
        isolated[runs[found], best[found]] = True
        touched = np.any(reach & reach[runs, :, best][:, :, None], axis=-2)
        gain = np.where(touched & found[:, None], -np.inf, gain)
    return isolated


def _sizes(
    before: StepResiduals, now: StepResiduals, share_before: Array, share_now: Array, reach: Array
) -> tuple[Array, Array, Array, Array]:
    """Return (R, N) each: low and high end of the fault sizes that explain the residuals, the best size, twice its
    log-likelihood ratio.
    """
    residual, deviation, threshold = (np.concatenate(parts, axis=-1)[..., None] for parts in zip(before, now, strict=True))
    share = np.concatenate([share_before, share_now], axis=-2)
    known = np.isfinite(residual) & np.isfinite(threshold) & np.concatenate([reach, reach], axis=-2)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ends = (residual - threshold) / share, (residual + threshold) / share
        without = np.where(
            np.abs(residual) > threshold, -np.inf, np.inf
        )  # where the share is 0: explained by any size, or by none
        least = np.where(share == 0.0, -without, np.minimum(*ends))
        most = np.where(share == 0.0, without, np.maximum(*ends))
    low = np.max(np.where(known, least, -np.inf), axis=-2)
    high = np.min(np.where(known, most, np.inf), axis=-2)
    weight = np.where(known, 1.0 / np.where(known, deviation, 1.0) ** 2, 0.0)
    value = np.where(known, residual, 0.0)
    square, product = np.sum(weight * share**2, axis=-2), np.sum(weight * share * value, axis=-2)
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.clip(product / square, low, high)
        gain = 2 * size * product - size**2 * square
    return low, high, size, np.where(np.isfinite(gain), gain, -np.inf)
