"""Detector: leave-one-out bank on the augmented plant, where faults of sensors compete with differences of the plant.

The central filter estimates what the plant declares as unknown (`core.augment`). On its innovations the hypotheses of
`hypotheses` compete; `competition` decides between sensor, process and "cannot tell".

- A sensor is isolated by the present sample, or by the windows, where it explains the readings better than any difference of
  the plant, by a margin. What it has done to the estimate is removed.
- A process hypothesis is accepted in the same way. The estimate is moved to it, with its uncertainty, the windows restart, and
  sensors that were isolated in the recent past are used again: the diagnosis of sensors continues. While the hypothesis stands
  a sensor needs the larger margin, and soon after it was accepted the lead in `PERSISTENT` samples in a row. While it leaves
  readings of several sensors unexplained, none is isolated.
- Otherwise an alarm is undecided, and its suspects are reported.
- A sensor whose readings are too quiet is isolated, too (`quiet`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.core.arguments import number, whole
from fusion_sfdia.core.batch_detector import TimeStep
from fusion_sfdia.core.detector import Decision, ProcessHypothesis
from fusion_sfdia.core.exclusion import restored
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.filters.estimators import Extended, GaussianState, Prior, step_stream
from fusion_sfdia.kalman_banks.competition import (
    Accepted,
    Evidence,
    Limits,
    Present,
    absorbed_before,
    accepted,
    alternatives,
    eliminated,
    gathered,
    led_by,
    one_sample_evidence,
    suspects,
)
from fusion_sfdia.kalman_banks.excluding_bank import UNUSED, ExcludingBank, SensorTests, Update
from fusion_sfdia.kalman_banks.freed_estimates import Tested, moved, widened, with_alternatives
from fusion_sfdia.kalman_banks.hypotheses import PARAMETER_SIZE, SLOW_STEP, Hypotheses
from fusion_sfdia.kalman_banks.leave_one_out import LeaveOneOut, one_hot, posterior_and_gain, statistics
from fusion_sfdia.kalman_banks.likelihood_window import (
    Grid,
    Window,
    best_onset,
    residual_and_threshold,
    shifted,
    updated,
    weigh,
)
from fusion_sfdia.kalman_banks.quiet import Pairs, no_pairs, paired, too_quiet
from fusion_sfdia.kalman_banks.robust_memory import RobustMemory, faded, leaves_unexplained, nothing_known
from fusion_sfdia.kalman_banks.standing import Standing, added_noise, followed, sizes, with_accepted
from fusion_sfdia.kalman_banks.window_step import WindowStep, last_update, window_step

Array = NDArray[Any]

QUIET_SHARE = 0.1  # of the false alarms, for readings that are too quiet
LATELY = 15  # samples after a process hypothesis was accepted, in which what changed may turn out to be more
PERSISTENT = 3  # samples in a row that isolate a sensor then
USUAL = 1.0  # of the prior standard deviation of a parameter or input: so much is no change of the process


@dataclass(frozen=True)
class RobustBank(ExcludingBank):
    """Leave-one-out bank with competing hypotheses about sensors and process.

    window, memory: samples in which the onset of a bias, jump or error of an equation, and that of a ramp or drift, is sought.
    false_alarm: probability that an alarm of the sensors begins in one step, as of `LeaveOneOutBank`: a tenth for readings that
    are too quiet, the rest in equal parts for the sample and the windows; process_false_alarm: the same of the process
    hypotheses. By Bonferroni both are bounds, for a correct model. sensor_margin, process_margin: by how much the evidence
    (twice a logarithm of a likelihood ratio) of a sensor must exceed that of the process, and the reverse. smallest: size, over
    the noise of a sensor, below which the windows isolate no sensor, since a model errs by as much: the alarm is undecided. A
    parameter or input must differ by `USUAL` of its prior standard deviation.
    max_faults: sensors that may be left out at once (None: what the plant's redundancy allows, half of the
    sensors or fewer, see `redundancy`; `inspect_plant` states it, and `Decision.capped` where it binds).
    accommodate: leave out isolated sensors and follow the process; without it the statistics are those of one filter, for
    sweeps over the threshold.
    """

    window: int = 32
    memory: int = 256
    false_alarm: float = 1e-3
    process_false_alarm: float = 1e-5
    sensor_margin: float = 3.0
    process_margin: float = 10.0
    smallest: float = 1.5
    max_faults: int | None = None
    accommodate: bool = True
    estimator: Extended = field(default_factory=Extended)

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("window, in samples,", self.window, least=4)
        whole("memory, in samples,", self.memory, least=4 * SLOW_STEP)
        for what in ("sensor_margin", "process_margin", "smallest"):
            if not 0 <= number(what, getattr(self, what)) < np.inf:
                raise ValueError(f"{what} is {getattr(self, what)}; expected a finite number of at least 0")

    @cached_property
    def _hypotheses(self) -> Hypotheses:
        return Hypotheses(self.plant)

    @property
    def model(self) -> Plant:
        """The augmented plant, which the filter estimates."""
        return self._hypotheses.model

    @property
    def process_hypotheses(self) -> tuple[ProcessHypothesis, ...]:
        """What of the plant may differ from the model, in the order of `Decision.process`."""
        return self._hypotheses.process

    @cached_property
    def _grids(self) -> tuple[Grid, Grid]:
        return Grid.spanning(self.window), Grid.spanning(self.memory, SLOW_STEP)

    @cached_property
    def _limits(self) -> Limits:
        """Quantiles of normal variables, shared by sensors or process hypotheses and by the onsets."""
        scale, onsets = self.threshold_scale, sum(grid.slots for grid in self._grids)
        half = (1 - QUIET_SHARE) * self.false_alarm / 2 / len(self.plant.sensors)
        shares = (half, half / onsets, self.process_false_alarm / len(self.process_hypotheses) / onsets)
        one, window, process = (float((scale * ndtri(s / 2)) ** 2) for s in shares)
        of, none = self._hypotheses, np.zeros(len(self.plant.states))
        smallest = np.concatenate([self.smallest * self.plant.sensor_sigma, USUAL * of.sd, none])
        return Limits(one, window, process, np.array(self.sensor_margin), self.process_margin, smallest)

    def _start(self, batch: tuple[int, ...], seed: int) -> RobustMemory:
        of = self._hypotheses
        return nothing_known(of, self.estimator.start(of.model, batch, step_stream(seed, 0)), batch, self._grids)

    def _readmitted(self, memory: RobustMemory, t: float, which: Array) -> RobustMemory:
        used: RobustMemory = super()._readmitted(memory, t, which)
        out_for, led = (np.where(which, 0.0, a) for a in (memory.out_for, memory.led))
        fresh = no_pairs(memory.led.shape[:-1], which.shape[-1])
        first = np.where(which, fresh.first, memory.pairs.first)
        pairs = Pairs(first, np.where(which[..., None, :], fresh.squares, memory.pairs.squares))
        return used._replace(out_for=out_for, led=led, pairs=pairs)

    def _judge(self, memory: RobustMemory, now: TimeStep, y: Array, u: Array) -> tuple[RobustMemory, Decision]:
        estimate, exclusion, out_for, led, *windows, last, standing, pairs, nis = memory
        of, est, count = self._hypotheses, self.estimator, y.shape[-1]
        stands = np.asarray(standing.accepted.any(axis=-1))
        unexplained = none = np.zeros(stands.shape, bool)
        limits, handicap, room = self._limits, of.handicap, self.most_faults - exclusion.out.sum(axis=-1)
        if stands.any():
            limits = limits._replace(sensor_margin=np.where(stands, self.process_margin, self.sensor_margin))
            handicap = np.where(stands[..., None], 0.0, handicap)
            unexplained = stands & leaves_unexplained(nis)  # no sensor is isolated then
            room = np.where(unexplained, 0, room)
        prior = self._predict(estimate, standing, now, u)
        joint = est.joint(of.model, prior, now.t, u)
        y = self.plant.near(y, joint.y)
        usable = np.isfinite(y) & ~exclusion.out
        everything = statistics(joint, y, usable)
        assert prior.tangent is not None and joint.H is not None
        step = window_step(last, prior.tangent, joint.H, everything, windows[0].eta.dtype, of.leading)
        tested = self._test(windows, prior.tangent, step, now.k, everything)
        one = one_sample_evidence(everything, of.recent_sizes[:count])
        evidence = gathered(tested.best_recent, tested.best_slow, tested.slow.age, one, handicap)
        isolated, capped = np.zeros(y.shape, bool), none
        if (everything.chi_square > limits.one).any():
            present = Present(tested.recent.changes(slice(0, 1), count)[..., 0, :, :], of.recent_sizes, handicap)
            isolated, capped = eliminated(everything, evidence, present, limits, room)
        by_windows = accepted(evidence, limits, np.asarray(~isolated.any(axis=-1)))
        found, led, leads, process, restart = everything, np.zeros(led.shape), led, by_windows.is_process, none
        if isolated.any() or by_windows.is_sensor.any() or process.any():
            capped = capped | (by_windows.is_sensor & (room < 1))
            sensor, lately = by_windows.is_sensor & (room > 0), stands & (standing.since <= LATELY)
            isolated = isolated | (sensor[..., None] & one_hot(by_windows.sensor, count))
            led = led_by(leads, isolated, np.where(isolated, everything.innovation, 0.0))
            isolated = isolated & (np.abs(led) >= np.where(lately, PERSISTENT, 1)[..., None])
            reopened = isolated.any(axis=-1) & lately & ~standing.reopened & self.accommodate
            isolated = isolated & ~reopened[..., None]
            freed = absorbed_before(evidence, isolated, by_windows.sensor)
            changed, leaves = freed | process | reopened, isolated.any(axis=-1)
            if self.accommodate and changed.any():
                rivals = alternatives(evidence, by_windows, self.process_margin)
                standing = self._stand(standing, by_windows, evidence, prior, rivals > 0)
                standing = standing._replace(reopened=standing.reopened | reopened)
                prior = with_alternatives(moved(prior, tested, evidence, by_windows, freed), tested, rivals)
                likely = reopened[..., None] & (evidence.process[..., : of.added] > 0)
                prior = widened(prior, likely, PARAMETER_SIZE * of.changes)
                joint = est.joint(of.model, prior, now.t, u)
            restart = (changed | leaves) & self.accommodate
            if restart.any():
                found = statistics(joint, y, usable & ~isolated)
        capped = capped & ~unexplained
        x, p, gain = posterior_and_gain(joint, found)
        last = last_update(step, gain, restart)
        recent, slow = (updated(w, restart) for w in (tested.recent, tested.slow))

        pairs = paired(pairs, y, self.plant.sensor_sigma, self.plant.sensor_resolution)
        quiet = too_quiet(pairs, QUIET_SHARE * self.false_alarm / count)
        quiet = quiet & ~unexplained[..., None]
        if quiet.any():
            held = exclusion.out | isolated
            fits = held | (np.cumsum(quiet & ~held, axis=-1) <= self.most_faults - np.sum(held, axis=-1, keepdims=True))
            quiet, capped = quiet & fits, capped | np.any(quiet & ~fits, axis=-1)
        again = process | unexplained
        if self.accommodate and again.any():
            exclusion = restored(exclusion, again[..., None] & (out_for <= self.window))
        update = Update(x, p, prior, joint, found)
        exclusion, decision = self._conclude(
            now, y, u, exclusion, update, self._shown(everything, evidence, usable, isolated | quiet, capped)
        )
        added = slice(len(self.plant.states), None)
        variance = np.diagonal(p, axis1=-2, axis2=-1)[..., added]
        standing = followed(standing, x[..., added], variance)
        out_for = np.where(exclusion.out, out_for + 1, 0.0)
        memory = RobustMemory(
            GaussianState(x, p), exclusion, out_for, led, recent, slow, last, standing, pairs, faded(nis, found)
        )
        undecided = (decision.score > 1) & ~decision.isolated.any(axis=-1) & ~process
        return memory, self._with_process(decision, evidence, standing, undecided, (x[..., added], variance))

    def _predict(self, estimate: GaussianState, standing: Standing, now: TimeStep, u: Array) -> Prior:
        """The prediction of the augmented state, with process noise by errors of equations."""
        of = self._hypotheses
        prior = self.estimator.predict(of.model, estimate, now.t_start, u, now.dt, UNUSED)
        x, p = prior.core
        if (noise := added_noise(standing, of.rates, x[..., len(self.plant.states) :])) is None:
            return prior
        return prior._replace(core=GaussianState(x, p + noise))

    def _test(self, windows: Sequence[Window], F: Array, step: WindowStep, k: int, found: LeaveOneOut) -> Tested:
        """Add the present readings to both windows; F: tangent of the step, the k-th."""
        of = self._hypotheses
        recent, slow = (shifted(w, grid, k) for w, grid in zip(windows, self._grids, strict=True))
        weighed = weigh(recent, step, of.recent(F, recent.age.shape[-1]))
        slowly = weigh(slow, step, of.slow(F, slow.age))
        every = np.ones(weighed.a.shape[:-2] + weighed.a.shape[-1:], bool)
        every[..., : found.used.shape[-1]] = found.used
        best_slow = best_onset(slowly, every[..., : slow.a.shape[-1]], of.slow_sizes(slow.age))
        return Tested(weighed, slowly, best_onset(weighed, every, of.recent_sizes), best_slow)

    def _stand(self, standing: Standing, by_windows: Accepted, evidence: Evidence, prior: Prior, rivals: Array) -> Standing:
        """The process hypotheses that stand, with those accepted now and their rivals."""
        which = by_windows.is_process[..., None] & one_hot(by_windows.process, evidence.process.shape[-1])
        z = prior.core.x[..., len(self.plant.states) :]
        return with_accepted(standing, which, rivals, z, evidence.size_p, np.sqrt(1.0 / evidence.information_p))

    def _shown(self, everything: LeaveOneOut, evidence: Evidence, usable: Array, isolated: Array, capped: Array) -> SensorTests:
        """Residual and threshold of each sensor: those of the window or of the sample, by the larger ratio."""
        one, window, *_ = self._limits
        by_onset = evidence.statistic_s, evidence.size_s, evidence.information_s
        residual, threshold = residual_and_threshold(everything, *by_onset, (one, window))
        return SensorTests(usable, isolated, residual, threshold, residual, capped, one)

    def _with_process(
        self, decision: Decision, evidence: Evidence, standing: Standing, undecided: Array, added: tuple[Array, Array]
    ) -> Decision:
        """The decision with the process hypotheses and the suspects; estimate and covariance of the plant's own states."""
        n, (z, variance) = len(self.plant.states), added
        nominal = self._hypotheses.model.x0[n:]
        size, sd = sizes(standing, z - nominal, variance)
        assert decision.covariance is not None
        found = {
            "estimate": decision.estimate[..., :n], "covariance": decision.covariance[..., :n, :n],
            "process": standing.accepted, "process_size": size, "process_sd": sd,
            "suspect": suspects(evidence, undecided, self.process_margin), "probability": evidence.probability,
        }  # fmt: skip
        return Decision(**{**vars(decision), **found})
