"""Detector: changes since the start of the run, for faults that are slow and operations that no other run has had."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown, whole
from fusion_sfdia.detectors.batch_detector import BatchDetector, TimeStep
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.plant.log import Log

Array = NDArray[Any]


class SinceStartMemory(NamedTuple):
    """Sums of readings (..., N) and inputs (..., m) of the start, their numbers, and the memory of the detector of changes."""

    sum_y: Array
    count_y: Array
    sum_u: Array
    samples: Array
    inner: Any


@dataclass(frozen=True)
class SinceStart(BatchDetector):
    """A detector of changes y - y_0, u - u_0 about the means of the first `samples` readings and inputs of a run.

    Nothing is tested before, and a fault that is there from the beginning is not seen. A sensor without a reading in the first
    samples is never tested.

    Parameters
    ----------
    detector : BatchDetector
        Of the changes, its plant included (see `changes`).
    samples : int, default 30
        Of the means.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import FixedLimits
    >>> from fusion_sfdia.learning import SinceStart
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> limits = FixedLimits(plant, np.zeros(4), *np.full((2, 4), 6.0) * plant.sensor_sigma)
    >>> recording = simulate(plant, 40, seeds=[1])
    >>> y = recording.y[:, 0] + 0.5 * (recording.t > 180)[:, None] * [1.0, 0.0, 0.0, 0.0]
    >>> detector = SinceStart(plant, limits)
    >>> run(detector, detector.init(), recording.t, y, recording.u)[1].isolated[-1].tolist()
    [True, False, False, False]
    """

    detector: Any
    samples: int = 30

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("samples", self.samples, least=1)
        if not isinstance(self.detector, BatchDetector) or self.detector.plant is not self.plant:
            raise ValueError(f"detector is {shown(self.detector)}; expected a BatchDetector of the same plant, that of changes")

    @cached_property
    def _of_changes(self) -> Any:
        """The detector of changes with the thresholds of both."""
        return replace(self.detector, threshold_scale=self.detector.threshold_scale * self.threshold_scale)

    @property
    def most_faults(self) -> int:
        """How many sensors the detector of changes isolates at once."""
        return int(self.detector.most_faults)

    def _start(self, batch: tuple[int, ...], seed: int) -> SinceStartMemory:
        n, m = len(self.plant.sensors), len(self.plant.inputs)
        zero = np.zeros((*batch, n))
        return SinceStartMemory(zero, zero, np.zeros((*batch, m)), np.zeros(batch), self.detector._start(batch, seed))

    def _judge(self, memory: SinceStartMemory, now: TimeStep, y: Array, u: Array) -> tuple[SinceStartMemory, Decision]:
        sum_y, count_y, sum_u, count, inner = memory
        starting = count < self.samples
        known = np.isfinite(y) & starting[..., None]
        sum_y, count_y = sum_y + np.where(known, y, 0.0), count_y + known
        sum_u, count = sum_u + np.where(starting[..., None], u, 0.0), count + starting
        with np.errstate(invalid="ignore", divide="ignore"):
            start_y, start_u = sum_y / count_y, sum_u / count[..., None]
        inner, found = self._of_changes._judge(inner, now, np.where(starting[..., None], np.nan, y - start_y), u - start_u)
        used = np.isfinite(y) & ~found.isolated
        expected = found.reconstruction + np.where(np.isfinite(start_y), start_y, 0.0)
        memory = SinceStartMemory(sum_y, count_y, sum_u, count, inner)
        return memory, replace(found, reconstruction=np.where(used, y, expected))


def changes(logs: Sequence[Log], samples: int = 30) -> list[Log]:
    """Runs without gaps as changes since the mean of their first samples, which are left out; shorter runs are left out.

    Of a sensor without a reading in the first samples, the readings are missing.
    """
    found = []
    for t, y, u in logs:
        if len(t) > samples:
            first = np.isfinite(y[:samples])
            with np.errstate(invalid="ignore", divide="ignore"):
                start = np.where(first, y[:samples], 0.0).sum(axis=0) / first.sum(axis=0)
            found.append(Log(t[samples:], y[samples:] - start, u[samples:] - u[:samples].mean(axis=0)))
    return found
