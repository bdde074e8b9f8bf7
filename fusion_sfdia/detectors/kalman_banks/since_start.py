"""Which faults of each sensor have not been there since the first sample.

An error that a sensor has had in all its readings is its fault, or one of the model: without a reading from before, nothing
tells these apart. A fault has begun since only where the sensor's own readings have ruled it out before. With c = a / b the
size of a bias by the oldest onset of the windows, and s its standard deviation (`likelihood_window`), in samples without a
sign of an alarm,

    high <- min(high, c + SURE s),    low <- max(low, c - SURE s)

A fault of size f was not there then if f > high or f < low. So does the sample before a jump, with c and s of the leave-one-out
error: an error of the model grows, while it is learnt or later, but does not jump.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.detector import ProcessHypothesis
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut
from fusion_sfdia.detectors.kalman_banks.likelihood_window import Inflation, Weighed

Array = NDArray[Any]

SURE = 3.0  # standard deviations
JUMP = 20.0  # half the squared change of a leave-one-out error from a sample to the next, in variances of its noise
SINCE_START = ProcessHypothesis("model since the start", "1", "since start", np.nan)


class RuledOut(NamedTuple):
    """Errors of each sensor (..., N), in its unit, that were not there in some sample: those above high and below low.

    unclear (..., N): sensors that are left out, and whose fault may have been there since the first sample.
    """

    high: Array
    low: Array
    unclear: Array

    def allows(self, fault: Array) -> Array:
        """Whether faults of that size (..., N) may have been there since the first sample."""
        return np.asarray((fault <= self.high) & (fault >= self.low))

    def beyond(self, size: Array, sd: Array, where: Array) -> RuledOut:
        """With what a sample rules out in which an error was of that size (..., N), of sensors `where` (..., N) holds."""
        high = np.minimum(self.high, np.where(where, size + SURE * sd, np.inf))
        return self._replace(high=high, low=np.maximum(self.low, np.where(where, size - SURE * sd, -np.inf)))


def nothing_ruled_out(batch: tuple[int, ...], sensors: int) -> RuledOut:
    """Before the first readings."""
    shape = (*batch, sensors)
    return RuledOut(np.full(shape, np.inf), np.full(shape, -np.inf), np.zeros(shape, bool))


def seen_again(now: RuledOut, window: Weighed, inflation: Inflation, where: Array) -> RuledOut:
    """With the windows of a sample, of sensors `where` (..., N) holds. inflation: of the noise in their sums."""
    sensors = now.high.shape[-1]
    a, b = window.a[..., -1, :sensors], window.b[..., -1, :sensors]
    with np.errstate(divide="ignore", invalid="ignore"):
        return now.beyond(a / b, np.sqrt(inflation.own[..., -1, :] / b), where & (b > 0))


def before_jumps(now: RuledOut, last: Array, found: LeaveOneOut, variance: Array) -> RuledOut:
    """With the sample before this one, of sensors whose error jumps.

    last (..., N): e of that sample, as of `reading_noise`, NaN without one. variance (..., N): that of e, by the noise.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        sd = 1 / np.sqrt(found.weight)
        jumps = found.used & ((found.whitened * sd - last) ** 2 / 2 > JUMP * variance)
        return now.beyond(last * sd, np.sqrt(variance) * sd, jumps) if jumps.any() else now
