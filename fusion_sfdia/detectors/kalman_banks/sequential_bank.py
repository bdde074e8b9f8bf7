"""Detector: one central filter with sequential tests of its standardised innovations or leave-one-out innovations.

The textbook tests for weak faults, which accumulate evidence over time (see `sequential_rules`), on

    innovation       z_i = d_i / sqrt(S_ii)    reading less the prediction of the model
    leave-one-out    z_i = u_i / sqrt(w_i)     reading less the prediction from the model and all other readings (leave_one_out)

Both are N(0, 1) when healthy. For a correct model innovations are white in time, and so are leave-one-out innovations, which
are linear forms of the innovation of one step. Tests may be combined, such as a cumulative sum for small faults and a limit on
the present sample for large ones (Lucas 1982); they then share the false-alarm probability.

The sensor with the largest ratio of statistic to limit is isolated. The leave-one-out statistics of the other sensors are then
updated without it, until none exceeds its limit. An innovation does not depend on the other readings of its step, so with
innovations only the sensor with the largest ratio is isolated in a step. As in `leave_one_out_bank` an isolated sensor is left
out, replaced and readmitted by a likelihood ratio. The memories of all sensors restart, because the filter has distributed the
fault over them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.exclusion import Exclusion, none_excluded
from fusion_sfdia.detectors.kalman_banks.excluding_bank import ExcludingBank, ExclusionUpdate, SensorTests
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, eliminate, one_hot, posterior, statistics
from fusion_sfdia.detectors.kalman_banks.sequential_rules import SequentialRule, Shewhart
from fusion_sfdia.filters.estimators import UNUSED, Estimator, Extended, GaussianState, Prior, step_stream
from fusion_sfdia.filters.gaussian import Joint

Array = NDArray[Any]


class TestedInnovations(NamedTuple):
    """Innovations with their standard deviations (..., N), the memory of each rule after them (..., rows, N), and the largest
    ratio of a statistic to its limit (..., N).
    """

    innovation: Array
    deviation: Array
    of_rules: tuple[Array, ...]
    ratio: Array


class SequentialMemory(NamedTuple):
    """The filter's estimate, the sensors that are left out, and the memory of each rule (..., rows, N)."""

    estimate: GaussianState
    exclusion: Exclusion
    rules: tuple[Array, ...]


@dataclass(frozen=True)
class SequentialBank(ExcludingBank):
    """Sequential tests of every sensor on one central filter (extended or unscented with redraw).

    Parameters
    ----------
    rules : tuple of SequentialRule, default (Shewhart(),)
        The tests of z; an alarm of any rule is an alarm.
    leave_one_out : bool, default True
        z from the model and the other readings; otherwise from the model alone.
    estimator : Estimator, default Extended()
        The kind of filter.
    false_alarm : float, default 1e-3
        Probability that an alarm begins in one step with healthy sensors, shared equally by the sensors and rules (Bonferroni).
        It is a bound for a correct model, if the limits of the rules are exact.
    max_faults : int, optional
        Sensors that may be excluded at once (None: what the plant's redundancy allows, half of the sensors or fewer, see
        `redundancy`; `inspect` states it, and `Decision.capped` where it binds).
    accommodate : bool, default True
        Leave out isolated sensors; without it the statistics are those of the filter on all sensors, and no memory restarts.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import Cusum, SequentialBank, Shewhart
    >>> from fusion_sfdia.plants import two_tanks
    >>> bank = SequentialBank(two_tanks(), rules=(Shewhart(), Cusum()))
    >>> recording = simulate(bank.plant, 40, seeds=[1])
    >>> y = recording.y[:, 0] + (recording.t > 100)[:, None] * [0.2, 0.0, 0.0, 0.0]
    >>> run(bank, bank.init(), recording.t, y, recording.u)[1].isolated[-1].tolist()
    [True, False, False, False]
    """

    rules: tuple[SequentialRule, ...] = (Shewhart(),)
    leave_one_out: bool = True
    estimator: Estimator = field(default_factory=Extended)
    false_alarm: float = 1e-3
    max_faults: int | None = None
    accommodate: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.rules, tuple) or not self.rules:
            raise ValueError(f"rules is {shown(self.rules)}; expected a tuple of at least one, such as (Shewhart(), Cusum())")

    def _start(self, batch: tuple[int, ...], seed: int) -> SequentialMemory:
        count = len(self.plant.sensors)
        estimate = self.estimator.start(self.plant, batch, step_stream(seed, 0))
        return SequentialMemory(estimate, none_excluded(batch, count), tuple(rule.start(batch, count) for rule in self.rules))

    def _judge(self, memory: SequentialMemory, now: TimeStep, y: Array, u: Array) -> tuple[SequentialMemory, Decision]:
        estimate, exclusion, of_rules = memory
        plant, est, count = self.plant, self.estimator, y.shape[-1]
        usable = np.isfinite(y) & ~exclusion.out
        prior = est.predict(plant, estimate, now.t_start, u, now.dt, UNUSED)
        joint = self._joint(now, estimate.x, prior, u, usable)
        y = plant.near(y, joint.y)
        everything = statistics(joint, y, usable)
        innovations = self._test(joint, everything, y, of_rules)
        found, isolated, capped = self._eliminate(joint, everything, innovations, y, of_rules, exclusion.out)
        if not self.accommodate:
            found = everything
        x, p = posterior(joint, found)
        of_rules = innovations.of_rules
        if self.accommodate and np.any(isolated):
            restart = np.any(isolated, axis=-1)[..., None, None]
            fresh = (rule.start(y.shape[:-1], count) for rule in self.rules)
            of_rules = tuple(np.where(restart, new, old) for new, old in zip(fresh, of_rules, strict=True))

        limit = (self.threshold_scale * ndtri(self.false_alarm / count / 2)) ** 2
        signed = np.where(np.signbit(innovations.innovation), -innovations.ratio, innovations.ratio)
        threshold = innovations.deviation * np.sqrt(limit)
        update = ExclusionUpdate(x, p, prior, joint, found)
        tested = SensorTests(usable, isolated, signed * threshold, threshold, innovations.innovation, capped, limit)
        exclusion, decision = self._conclude(now, y, u, exclusion, update, tested)
        return SequentialMemory(GaussianState(x, p), exclusion, of_rules), decision

    def _joint(self, now: TimeStep, before: Array, prior: Prior, u: Array, usable: Array) -> Joint:
        """The joint Gaussian of state and readings; before: the estimate before the step (..., n)."""
        return self.estimator.joint(self.plant, prior, now.t, u)

    def _test(self, joint: Joint, found: LeaveOneOut, y: Array, of_rules: tuple[Array, ...]) -> TestedInnovations:
        if self.leave_one_out:
            innovation, variance = found.innovation, found.variance
        else:
            innovation = np.where(found.used, y, joint.y) - joint.y
            variance = np.where(found.used, np.diagonal(joint.S, axis1=-2, axis2=-1), np.inf)
        deviation = np.sqrt(variance)
        z = np.where(found.used, innovation / deviation, np.nan)
        of_rules = tuple(rule.advance(m, z) for rule, m in zip(self.rules, of_rules, strict=True))
        share = self.false_alarm / y.shape[-1] / len(self.rules)
        ratios = [rule.statistic(m) / rule.limit(m, share) for rule, m in zip(self.rules, of_rules, strict=True)]
        ratio = np.where(found.used, np.max(ratios, axis=0) / self.threshold_scale, 0.0)
        return TestedInnovations(innovation, deviation, of_rules, ratio)

    def _eliminate(
        self,
        joint: Joint,
        found: LeaveOneOut,
        innovations: TestedInnovations,
        y: Array,
        of_rules: tuple[Array, ...],
        out: Array,
    ) -> tuple[LeaveOneOut, Array, Array]:
        """Eliminate the worst sensor above its limit; with leave-one-out statistics until none is above it or too many are
        excluded.

        Return the statistics of the other sensors, the eliminated sensors (..., N), and whether a sensor above its limit stays
        because of max_faults (...).
        """
        isolated = np.zeros(found.used.shape, bool)
        while True:
            worst = np.argmax(innovations.ratio, axis=-1)
            above = np.max(innovations.ratio, axis=-1) > 1
            room = np.sum(out | isolated, axis=-1) < self.most_faults
            where = above & room & (self.leave_one_out | ~np.any(isolated, axis=-1))
            if not np.any(where):
                return found, isolated, above & ~room
            isolated = isolated | (where[..., None] & one_hot(worst, y.shape[-1]))
            found = eliminate(found, worst, where)
            innovations = self._test(joint, found, y, of_rules)
