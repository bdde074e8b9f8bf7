"""Exclusion of isolated sensors: the sizes of their faults, and their readmission."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

MEMORY = 5  # samples over which the size of a fault is averaged: follows a drift, reduces noise by sqrt(5)
QUIET = 2  # samples in a row within the threshold before a sensor is readmitted


class Exclusion(NamedTuple):
    """The exclusion of each sensor (..., N).

    out: left out (bool). The others in order: size of its fault, samples in that size, evidence that it is healthy, and samples
    in a row within the limit.
    """

    out: Array
    size: Array
    samples: Array
    evidence: Array
    quiet: Array


def none_excluded(batch: tuple[int, ...], sensors: int) -> Exclusion:
    """Return the state in which every sensor is trusted."""
    shape = (*batch, sensors)
    return Exclusion(np.zeros(shape, bool), *(np.zeros(shape) for _ in range(4)))


def exclude(now: Exclusion, faulty: Array, size: Array) -> Exclusion:
    """Leave out the sensors for which `faulty` (..., N) holds, with a first estimate of size."""
    if not np.any(faulty):
        return now
    return Exclusion(
        now.out | faulty,
        np.where(faulty, size, now.size),
        np.where(faulty, 1.0, now.samples),
        np.where(faulty, 0.0, now.evidence),
        np.where(faulty, 0.0, now.quiet),
    )


def restored(now: Exclusion, where: Array) -> Exclusion:
    """Use the sensors `where` (..., N) holds again, as if they had not been left out."""
    if not np.any(where):
        return now
    return Exclusion(now.out & ~where, *(np.where(where, 0.0, v) for v in now[1:]))


def readmit(now: Exclusion, error: Array, variance: Array, limit: float, level: float) -> Exclusion:
    """Follow the faults of the sensors that are out and readmit those that are healthy again.

    error (..., N): reading less its estimate from the trusted sensors, NaN where missing (nothing changes then);
    variance (..., N): of error when healthy. The evidence is the cumulative sum, kept at or above zero, of the
    log-likelihood ratio of "no fault" against "a fault of the estimated size" (at least one standard deviation, so
    that a healthy sensor that was left out is readmitted), over samples within error^2 <= limit variance: any other resets
    it to zero. The size is constant while evidence accumulates. A sensor is readmitted when the evidence exceeds `level` and
    the last QUIET samples were all within that limit.
    """
    seen = now.out & np.isfinite(error)
    if not np.any(seen):
        return now
    e = np.where(seen, error, 0.0)
    v = np.where(seen, variance, 1.0)
    assumed = np.where(now.size < 0, -1.0, 1.0) * np.maximum(np.abs(now.size), np.sqrt(v))
    gain = ((e - assumed) ** 2 - e**2) / (2 * v)
    plausible = e**2 <= limit * v
    evidence = np.where(seen, np.where(plausible, np.maximum(now.evidence + gain, 0.0), 0.0), now.evidence)
    quiet = np.where(seen, np.where(plausible, now.quiet + 1, 0.0), now.quiet)
    learns = seen & (evidence == 0.0)
    count = now.samples + learns
    size = now.size + np.where(learns, (e - now.size) / np.clip(count, 1.0, MEMORY), 0.0)
    back = seen & (evidence > level) & (quiet >= QUIET)
    return Exclusion(
        now.out & ~back, np.where(back, 0.0, size), np.where(back, 0.0, count), np.where(back, 0.0, evidence), quiet
    )
