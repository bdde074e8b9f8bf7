"""Thresholds from healthy logs, each set on logs that the model has not seen, and their rate counted on others again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import probability, whole
from fusion_sfdia.common.order_statistics import order_statistic
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.silent import silent, silent_scores
from fusion_sfdia.learning.innovations import side_by_side
from fusion_sfdia.plant.log import Log

Array = NDArray[Any]

FACTOR, STEPS = 1.1, 20  # by which thresholds are raised, and how often at most, until the deployed detector has the rate


@dataclass(frozen=True, eq=False)
class Calibration:
    """A detector fitted to all healthy logs, with thresholds at which logs that it had not seen were in alarm at most at the
    rate `false_alarm` of their samples.

    Attributes
    ----------
    detector : Detector
        With these thresholds.
    false_alarm : float
        The stated rate.
    counted : tuple of float
        The share of the samples of each group of logs in alarm, with a detector fitted without it and thresholds set on the
        other groups.
    samples : tuple of int
        Of each group.

    Examples
    --------
    See `Calibration.of`.
    """

    detector: Any
    false_alarm: float
    counted: tuple[float, ...]
    samples: tuple[int, ...]

    @property
    def rate(self) -> float:
        """The share of all held-out samples in alarm."""
        return float(np.average(self.counted, weights=self.samples))

    def __str__(self) -> str:
        each = ", ".join(f"{rate:.2g}" for rate in self.counted)
        return f"{self.rate:.2g} of {sum(self.samples)} held-out healthy samples in alarm ({each}), stated {self.false_alarm:g}"

    @classmethod
    def of(
        cls,
        fit: Callable[[Sequence[Log]], Detector],
        groups: Sequence[Sequence[Log]],
        false_alarm: float = 1e-2,
        warm_up: int = 20,
    ) -> Calibration:
        """Fit a detector to healthy runs and set its thresholds, nested over groups of them.

        For each group a detector is fitted to the others. The scale is the order statistic of the scores of all groups, each by
        the detector that has not seen it, raised by FACTOR until these detectors, which isolate and readmit, are in alarm in at
        most `false_alarm` of the samples after the first `warm_up` of a run. For the rate that is counted on a group, its own
        scores and alarms are left out of that as well.

        Parameters
        ----------
        fit : callable
            Gives a detector with a `threshold_scale` from runs, a sequence of Log.
        groups : sequence of sequences of Log
            What is left out in turn, of runs without gaps.
        false_alarm : float, default 1e-2
            Share of the samples in alarm.
        warm_up : int, default 20
            Samples that are left out at the beginning of each run.

        Returns
        -------
        Calibration
            The detector fitted to all groups, and the rates that were counted.

        Raises
        ------
        ValueError
            Where there are fewer than two groups, or less than one sample is expected in alarm.

        Examples
        --------
        >>> from fusion_sfdia import Log, simulate
        >>> from fusion_sfdia.detectors import CentralFilter
        >>> from fusion_sfdia.learning import Calibration
        >>> from fusion_sfdia.plants import two_tanks
        >>> plant = two_tanks()
        >>> groups = [[Log(r.t, r.y[:, 0], r.u)] for r in (simulate(plant, 200, seeds=[seed]) for seed in range(2))]
        >>> calibrated: Calibration = Calibration.of(lambda logs: CentralFilter(plant), groups, false_alarm=0.05)
        >>> calibrated.rate <= 0.05, calibrated.samples
        (True, (180, 180))
        """
        probability("false_alarm", false_alarm)
        whole("warm_up", warm_up, least=0)
        if len(groups) < 2:
            raise ValueError(
                f"{len(groups)} group of healthy runs; expected at least two, to set thresholds on what was not learnt"
            )
        batches = [side_by_side(group) for group in groups]
        judged = [_judged(own, warm_up) for _, _, own in batches]
        samples = tuple(int(own.sum()) for own in judged)
        if sum(samples) * false_alarm < 1 or min(samples) == 0:
            raise ValueError(
                f"{sum(samples)} healthy samples after the first {warm_up} of each run cannot set thresholds that one in "
                f"{1 / false_alarm:.0f} exceeds; record more, or choose a higher false-alarm rate"
            )
        detectors: list[Any] = [
            fit([run for j, group in enumerate(groups) if j != k for run in group]) for k in range(len(groups))
        ]
        scores = []
        for detector, (y, u, _), own in zip(detectors, batches, judged, strict=True):
            found = silent_scores(silent(replace(detector, threshold_scale=1.0)), _times(detector, len(y)), y, u)[1]
            scores.append(np.nan_to_num(found, nan=0.0)[own])

        @cache
        def alarms(k: int, scale: float) -> int:
            """Samples of a group in alarm at a scale, by the detector that has not seen it."""
            detector, (y, u, _) = replace(detectors[k], threshold_scale=scale), batches[k]
            state, count = detector.init(y.shape[1:-1], 0.0), 0
            for step, t in enumerate(_times(detector, len(y))):
                state, decision = detector.step(state, float(t), y[step], u[step])
                count += int(np.sum(decision.alarm & judged[k][step]))
            return count

        def scale_of(others: Sequence[int]) -> float:
            """The scale at which these groups together have the rate."""
            start = float(order_statistic(np.concatenate([scores[k] for k in others]), false_alarm))
            allowed = false_alarm * sum(samples[k] for k in others)
            for step in range(STEPS):
                scale = max(start, 1e-6) * FACTOR**step
                if sum(alarms(k, scale) for k in others) <= allowed:
                    break
            return scale

        every = range(len(groups))
        counted = tuple(alarms(k, scale_of([j for j in every if j != k])) / samples[k] for k in every)
        fitted: Any = fit([run for group in groups for run in group])
        return cls(replace(fitted, threshold_scale=scale_of(list(every))), false_alarm, counted, samples)


def _times(detector: Detector, steps: int) -> Array:
    return detector.plant.dt * np.arange(1, steps + 1)


def _judged(own: Array, warm_up: int) -> Array:
    """Samples (K, B) of a run after its first `warm_up`."""
    return np.asarray(own & (np.arange(len(own))[:, None] >= warm_up))
