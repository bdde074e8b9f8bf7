"""Detector: one central filter whose standardised innovations, or leave-one-out innovations, go through sequential tests.

The textbook's ways to remember a weak fault (see `memory_rules`), on

    innovation       z_i = d_i / sqrt(S_ii)    reading less what the model predicts
    leave-one-out    z_i = u_i / sqrt(w_i)     reading less what the model and all other readings predict (see leave_one_out)

Both are N(0, 1) when healthy; innovations are white in time for a model that is true, leave-one-out innovations (each a linear
form of one step's innovation) with them. Tests may be combined, as a cumulative sum for small faults with a limit on the
present sample for large ones (Lucas 1982), and then share the budget. The sensor with the largest ratio of statistic to limit
is named. Leave-one-out statistics of the rest follow without it, until none is above its limit; an innovation does not depend
on the other readings of its step, so that only the largest is named in a step. As in `leave_one_out_bank` a named sensor is
left out, replaced and readmitted by a likelihood ratio, and what the others remember starts anew, since the filter has spread
the fault over them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.core.arguments import shown
from fusion_sfdia.core.batch_detector import Moment
from fusion_sfdia.core.detector import Decision, State
from fusion_sfdia.core.exclusion import Exclusion, none_excluded
from fusion_sfdia.filters.estimators import Estimator, Extended, Prior, step_stream
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.kalman_banks.excluding_bank import ExcludingBank, Update, Verdict
from fusion_sfdia.kalman_banks.leave_one_out import LeaveOneOut, eliminate, posterior, statistics
from fusion_sfdia.kalman_banks.memory_rules import Rule, Shewhart

Array = NDArray[Any]


class Judged(NamedTuple):
    """Innovations with their standard deviations (..., N), memory of each rule with them (..., rows, N), and the
    largest ratio of a statistic to its limit (..., N).
    """

    innovation: Array
    deviation: Array
    memory: tuple[Array, ...]
    ratio: Array


@dataclass(frozen=True)
class SequentialBank(ExcludingBank):
    """Sequential tests of every sensor on one central filter (extended or unscented with redraw).

    rules: what is remembered of z; alarm of any. leave_one_out: z from the other readings, too; otherwise from the model alone.
    false_alarm: probability that a healthy set of sensors begins an alarm in one step, shared equally by the sensors
    and rules (Bonferroni); a bound for a model that is true as far as the rules' limits are exact.
    max_faults: sensors that may be out at once (None: `most_faults` of the plant); capped: another would be.
    accommodate: leave faulty sensors out; without, statistics stay those of the undisturbed filter and no memory starts anew.
    """

    rules: tuple[Rule, ...] = (Shewhart(),)
    leave_one_out: bool = True
    estimator: Estimator = field(default_factory=Extended)
    false_alarm: float = 1e-3
    max_faults: int | None = None
    accommodate: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.rules, tuple) or not self.rules:
            raise ValueError(f"rules is {shown(self.rules)}; expected a tuple of at least one, such as (Shewhart(), Cusum())")

    def _start(self, batch: tuple[int, ...], seed: int) -> State:
        """x, P, the exclusions, and the memory of each rule."""
        count = len(self.plant.sensors)
        core = self.estimator.start(self.plant, batch, step_stream(seed, 0))
        return *core, *none_excluded(batch, count), *(rule.start(batch, count) for rule in self.rules)

    def _judge(self, core: State, now: Moment, y: Array, u: Array) -> tuple[State, Decision]:
        exclusion, memory = Exclusion(*core[2:7]), core[7:]
        plant, est, count = self.plant, self.estimator, y.shape[-1]
        usable = np.isfinite(y) & ~exclusion.out
        prior = est.predict(plant, core[:2], now.last, u, now.dt, step_stream(0, 0))  # these filters draw nothing
        joint = self._joint(now, core[0], prior, u, usable)
        everything = statistics(joint, y, usable)
        judged = self._test(joint, everything, y, memory)
        found, named, capped = self._eliminate(joint, everything, judged, y, memory, exclusion.out)
        if not self.accommodate:
            found = everything
        x, p = posterior(joint, found)
        memory = judged.memory
        if self.accommodate and np.any(named):
            restart = np.any(named, axis=-1)[..., None, None]
            fresh = (rule.start(y.shape[:-1], count) for rule in self.rules)
            memory = tuple(np.where(restart, new, old) for new, old in zip(fresh, memory, strict=True))

        limit = (self.threshold_scale * ndtri(self.false_alarm / count / 2)) ** 2
        signed = np.where(np.signbit(judged.innovation), -judged.ratio, judged.ratio)
        threshold = judged.deviation * np.sqrt(limit)
        update = Update(x, p, prior, joint, found)
        verdict = Verdict(usable, named, signed * threshold, threshold, judged.innovation, capped, limit)
        exclusion, decision = self._conclude(now, y, u, exclusion, update, verdict)
        return (x, p, *exclusion, *memory), decision

    def _joint(self, now: Moment, before: Array, prior: Prior, u: Array, usable: Array) -> Joint:
        """The joint Gaussian of state and readings; before: the estimate before the step (..., n)."""
        return self.estimator.joint(self.plant, prior, now.t, u)

    def _test(self, joint: Joint, found: LeaveOneOut, y: Array, memory: State) -> Judged:
        if self.leave_one_out:
            innovation, variance = found.innovation, found.variance
        else:
            innovation = np.where(found.used, y, joint.y) - joint.y
            variance = np.where(found.used, np.diagonal(joint.S, axis1=-2, axis2=-1), np.inf)
        deviation = np.sqrt(variance)
        z = np.where(found.used, innovation / deviation, np.nan)
        memory = tuple(rule.advance(m, z) for rule, m in zip(self.rules, memory, strict=True))
        share = self.false_alarm / y.shape[-1] / len(self.rules)
        ratios = [rule.statistic(m) / rule.limit(m, share) for rule, m in zip(self.rules, memory, strict=True)]
        ratio = np.where(found.used, np.max(ratios, axis=0) / self.threshold_scale, 0.0)
        return Judged(innovation, deviation, memory, ratio)

    def _eliminate(
        self, joint: Joint, found: LeaveOneOut, judged: Judged, y: Array, memory: State, out: Array
    ) -> tuple[LeaveOneOut, Array, Array]:
        """Eliminate the worst sensor above its limit, of leave-one-out statistics until none is left or too many are out.

        Return the statistics of the rest, the sensors eliminated (..., N), and whether one above stays for want of room (...).
        """
        named = np.zeros(found.used.shape, bool)
        while True:
            worst = np.argmax(judged.ratio, axis=-1)
            above = np.max(judged.ratio, axis=-1) > 1
            room = np.sum(out | named, axis=-1) < self.most_faults
            where = above & room & (self.leave_one_out | ~np.any(named, axis=-1))
            if not np.any(where):
                return found, named, above & ~room
            named = named | (where[..., None] & (np.arange(y.shape[-1]) == worst[..., None]))
            found = eliminate(found, worst, where)
            judged = self._test(joint, found, y, memory)
