"""Detector: one central filter whose standardised innovations, or leave-one-out innovations, go through a sequential test.

The textbook's ways to remember a weak fault (see `memory_rules`), on

    innovation       z_i = d_i / sqrt(S_ii)    reading less what the model predicts
    leave-one-out    z_i = u_i / sqrt(w_i)     reading less what the model and all other readings predict (see leave_one_out)

Both are N(0, 1) when healthy; innovations are white in time for a model that is true, leave-one-out innovations (each a linear
form of one step's innovation) with them. The sensor with the largest ratio of statistic to limit is named. Leave-one-out
statistics of the rest then follow without it, until none is above its limit; an innovation does not depend on the
other readings of its step, so that only the largest is named in a step. As in `leave_one_out_bank` a named sensor is left out,
replaced and readmitted by a likelihood ratio, and what the others remember starts anew, since the filter has spread the fault
over them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.core.arguments import probability, whole
from fusion_sfdia.core.batch_detector import BatchDetector, Moment
from fusion_sfdia.core.detector import Decision, State
from fusion_sfdia.core.exclusion import Exclusion, exclude, nobody, watch
from fusion_sfdia.core.health import broken
from fusion_sfdia.filters.estimators import Ensemble, Estimator, Extended, Prior, require_filter, step_stream
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.kalman_banks.leave_one_out import LeaveOneOut, eliminate, normalised_innovation_squared, posterior, statistics
from fusion_sfdia.kalman_banks.memory_rules import Rule, Shewhart

Array = NDArray[Any]


class Judged(NamedTuple):
    """Innovations with their standard deviations, memory with them, ratio of statistic to limit (..., N; rows for memory)."""

    innovation: Array
    deviation: Array
    memory: Array
    ratio: Array


@dataclass(frozen=True)
class SequentialBank(BatchDetector):
    """A sequential test of every sensor on one central filter (extended or unscented with redraw).

    rule: what is remembered of z. leave_one_out: z from the other readings, too; otherwise from the model alone.
    false_alarm: probability that a healthy set of sensors begins an alarm in one step, shared equally by the sensors
    (Bonferroni); a bound for a model that is true as far as the rule's limit is exact.
    max_faults: sensors that may be out at once (None: a quarter of them, at least three, but never all).
    accommodate: leave faulty sensors out; without, statistics stay those of the undisturbed filter and no memory starts anew.
    """

    rule: Rule = field(default_factory=Shewhart)
    leave_one_out: bool = True
    estimator: Estimator = field(default_factory=Extended)
    false_alarm: float = 1e-3
    max_faults: int | None = None
    accommodate: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        require_filter(self.estimator)
        probability("false_alarm", self.false_alarm)
        if isinstance(self.estimator, Ensemble) or not self.estimator.consistent:
            raise ValueError(
                f"{self.estimator} has no consistent mean and covariance; use Extended() or Unscented(redraw=True)"
            )
        if self.max_faults is not None and not whole("max_faults", self.max_faults, least=1) < len(self.plant.sensors):
            raise ValueError(
                f"max_faults is {self.max_faults}; plant {self.plant.name!r} has {len(self.plant.sensors)} sensors"
            )

    @property
    def most_faults(self) -> int:
        """Sensors that may be out at once."""
        count = len(self.plant.sensors)
        return self.max_faults or min(max(3, count // 4), count - 1)

    def _start(self, batch: tuple[int, ...], seed: int) -> State:
        """x, P, the exclusions, and the rule's memory."""
        count = len(self.plant.sensors)
        core = self.estimator.start(self.plant, batch, step_stream(seed, 0))
        return *core, *nobody(batch, count), self.rule.start(batch, count)

    def _judge(self, core: State, now: Moment, y: Array, u: Array) -> tuple[State, Decision]:
        exclusion, memory = Exclusion(*core[2:7]), core[7]
        plant, est, count = self.plant, self.estimator, y.shape[-1]
        usable = np.isfinite(y) & ~exclusion.out
        prior = est.predict(plant, core[:2], now.last, u, now.dt, step_stream(0, 0))  # these filters draw nothing
        joint = self._joint(now, core[0], prior, u, usable)
        everything = statistics(joint, y, usable)
        judged = self._test(joint, everything, y, memory)
        found, named = self._eliminate(joint, everything, judged, y, memory, exclusion.out)
        if not self.accommodate:
            found = everything
        x, p = posterior(joint, found)
        memory = judged.memory
        if self.accommodate and np.any(named):
            restart = np.any(named, axis=-1)[..., None, None]
            memory = np.where(restart, self.rule.start(memory.shape[:-2], count), memory)

        expected = plant.output(now.t, x, u)
        h = plant.output_jacobian_at(now.t, x, u)
        variance = np.sum((h @ p) * h, axis=-1) + plant.sensor_cov
        error = y - expected  # of the sensors that are out: they have no part in `expected`
        limit = (self.threshold_scale * ndtri(self.false_alarm / count / 2)) ** 2
        if self.accommodate:
            exclusion = watch(exclusion, error, variance, limit, -np.log(self.false_alarm / count))
            exclusion = exclude(exclusion, named, error)
        held = exclusion.out if self.accommodate else named
        outside = np.isfinite(y) & ~usable
        shown = np.where(np.signbit(judged.innovation), -judged.ratio, judged.ratio)
        threshold = self.threshold_scale * judged.deviation * self.rule.limit(judged.memory, self.false_alarm / count)
        decision = Decision(
            estimate=x,
            measured=np.where(np.isfinite(y) & ~held, y, expected),
            residual=np.where(outside, error, np.where(everything.used, shown * threshold, np.nan)),
            threshold=np.where(outside, np.sqrt(limit * variance), threshold),
            isolated=held,
            fault_size=np.where(held, exclusion.size if self.accommodate else judged.innovation, np.nan),
            diverged=prior.lost | broken(x, p),
            guarded=prior.guarded,
            nis=normalised_innovation_squared(joint, found, y),
            covariance=p,
        )
        return (x, p, *exclusion, memory), decision

    def _joint(self, now: Moment, before: Array, prior: Prior, u: Array, usable: Array) -> Joint:
        """The joint Gaussian of state and readings; before: the estimate before the step (..., n)."""
        return self.estimator.joint(self.plant, prior, now.t, u)

    def _test(self, joint: Joint, found: LeaveOneOut, y: Array, memory: Array) -> Judged:
        if self.leave_one_out:
            innovation, variance = found.innovation, found.variance
        else:
            innovation = np.where(found.used, y, joint.y) - joint.y
            variance = np.where(found.used, np.diagonal(joint.S, axis1=-2, axis2=-1), np.inf)
        deviation = np.sqrt(variance)
        memory = self.rule.advance(memory, np.where(found.used, innovation / deviation, np.nan))
        limit = self.threshold_scale * self.rule.limit(memory, self.false_alarm / y.shape[-1])
        ratio = np.where(found.used, self.rule.statistic(memory) / limit, 0.0)
        return Judged(innovation, deviation, memory, ratio)

    def _eliminate(
        self, joint: Joint, found: LeaveOneOut, judged: Judged, y: Array, memory: Array, out: Array
    ) -> tuple[LeaveOneOut, Array]:
        """Eliminate the worst sensor above its limit, of leave-one-out statistics until none is left or too many are out."""
        named = np.zeros(found.used.shape, bool)
        for _ in range(self.most_faults if self.leave_one_out else 1):
            worst = np.argmax(judged.ratio, axis=-1)
            where = (np.max(judged.ratio, axis=-1) > 1) & (np.sum(out | named, axis=-1) < self.most_faults)
            if not np.any(where):
                break
            named = named | (where[..., None] & (np.arange(y.shape[-1]) == worst[..., None]))
            found = eliminate(found, worst, where)
            judged = self._test(joint, found, y, memory)
        return found, named
