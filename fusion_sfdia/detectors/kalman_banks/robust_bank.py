"""Detector: leave-one-out bank on the augmented plant, where faults of sensors compete with differences of the plant.

The central filter estimates what the plant declares as unknown (`plant.augment`). On its innovations the hypotheses of
`hypotheses` compete; `competition` decides between sensor, process and "cannot tell".

- A sensor is isolated by the windows, or by the present sample twice in a row, where it explains the readings better than any
  difference of the plant, by a margin. What it has done to the estimate is removed.
- A process hypothesis is accepted in the same way; soon after a far reading, where the estimate follows single sensors, in two
  samples in a row unless it explains several far readings: an outlier that the estimate has followed looks as a change of the
  plant in the next. The estimate is moved to the hypothesis, with its uncertainty, and the windows restart. While it stands a
  sensor needs the larger margin, and soon after it was accepted the lead in `PERSISTENT` samples in a row. While it leaves
  readings of several sensors unexplained, none is isolated.
- What readings show of their noise, its size, correlation and outliers, scales all evidence (`reading_noise`); parameters that
  keep moving to one side are allowed to (`parameter_walk`).
- Where something is uncertain, the first `START` samples give no verdict.
- Where a sensor's readings have not ruled out before that its fault was there since the first sample, it is left out, and a
  suspect beside the model (`since_start`); isolated where the model is known to fit.
- Otherwise an alarm is undecided, and its suspects are reported.
- A sensor whose readings are too quiet is isolated, too (`quiet`).
- While a verdict stands a second filter looks at it again: it readmits sensors, raises doubt, or finds that two sensors failed
  where one change of the process was named (`fresh_look`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.common.arguments import number, whole
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.detector import Decision, ProcessHypothesis
from fusion_sfdia.detectors.exclusion import exclude, restored
from fusion_sfdia.detectors.health import of_runs
from fusion_sfdia.detectors.kalman_banks.competition import (
    Accepted,
    ChiSquareLimits,
    Evidence,
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
from fusion_sfdia.detectors.kalman_banks.excluding_bank import ExcludingBank, ExclusionUpdate, SensorTests, least_change
from fusion_sfdia.detectors.kalman_banks.freed_estimates import Tested, moved, with_alternatives, with_prior_unknowns
from fusion_sfdia.detectors.kalman_banks.fresh_look import (
    FIRST,
    LINEARISED_AGAIN,
    MOST,
    Question,
    answered,
    begun,
    failed_instead,
    remembered,
    with_sample,
)
from fusion_sfdia.detectors.kalman_banks.hypotheses import SLOW_STEP, UNNAMED, Hypotheses
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, one_hot, posterior_and_gain, statistics, value_at
from fusion_sfdia.detectors.kalman_banks.likelihood_window import (
    Inflation,
    OnsetGrid,
    Shifted,
    Weighed,
    Window,
    best_onset,
    residual_and_threshold,
    shifted,
    updated,
    weigh,
    with_readings,
)
from fusion_sfdia.detectors.kalman_banks.parameter_walk import Walk, noise_of
from fusion_sfdia.detectors.kalman_banks.parameter_walk import followed as walked
from fusion_sfdia.detectors.kalman_banks.quiet import no_pairs, paired, quietest, too_quiet
from fusion_sfdia.detectors.kalman_banks.reading_noise import (
    CLIP,
    ReadingNoise,
    clipped,
    inflation_of,
    is_larger,
    larger_from,
    learnt,
    unclipped,
    with_sums,
)
from fusion_sfdia.detectors.kalman_banks.robust_memory import RobustMemory, empty_memory, faded, leaves_unexplained
from fusion_sfdia.detectors.kalman_banks.since_start import SINCE_START, RuledOut, before_jumps, seen_again
from fusion_sfdia.detectors.kalman_banks.standing import Standing, added_noise, followed, nothing, sizes, with_accepted
from fusion_sfdia.detectors.kalman_banks.steady_gains import (
    Gains,
    SteadyGains,
    can_rest,
    estimate_at_rest,
    predicted,
    statistics_at_rest,
    weigh_at_rest,
)
from fusion_sfdia.detectors.kalman_banks.window_step import WindowStep, last_update, window_step
from fusion_sfdia.detectors.verdicts import FAR
from fusion_sfdia.filters import gaussian
from fusion_sfdia.filters.estimators import UNUSED, Extended, GaussianState, Prior, step_stream
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.plant import slow_noise
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

QUIET_SHARE = 0.1  # of the false alarms, for readings that are too quiet
LATELY = 15  # samples after a process hypothesis was accepted, in which what changed may turn out to be more
PERSISTENT = 3  # samples in a row that isolate a sensor then
TWICE = 2  # samples in a row that isolate a sensor by themselves at other times: one may be an outlier
BRIEF, FOLLOWED_FOR = 2, 8  # samples since the onset of what may have been an outlier, or one that the estimate has followed
FOLLOWED = 0.4  # least share of an innovation that the estimate follows, for a single outlier to move it visibly
FAR_SQUARE = 20.0  # chi-square of a reading that is far off, as outliers are
USUAL_SQUARE = 6.6  # chi-square below which a reading is as expected (0.99)
START = 32  # samples without a verdict where something is uncertain
CALM = 0.5  # of its limit, in which a statistic shows no sign of an alarm
LEARNT_AGAIN = (8, 16)  # samples before which what is uncertain gets its prior spread again, linearised at a better estimate
USUAL = 1.0  # of the prior standard deviation of a parameter or input: so much is no change of the process


@dataclass(frozen=True)
class RobustBank(ExcludingBank):
    """Leave-one-out bank with competing hypotheses about sensors and process.

    Parameters
    ----------
    window : int, default 32
        Samples in which the onset of a bias, jump or error of an equation is sought.
    memory : int, default 256
        Samples in which the onset of a ramp or drift is sought.
    false_alarm : float, default 1e-3
        Probability that an alarm of the sensors begins in one step, as of `LeaveOneOutBank`: a tenth for readings that are too
        quiet, the rest in equal parts for the sample and the windows. By Bonferroni it is a bound, for a correct model.
    process_false_alarm : float, default 1e-5
        The same of the process hypotheses.
    sensor_margin : float, default 3
        By how much the evidence (twice a logarithm of a likelihood ratio) of a sensor must exceed that of the process.
    process_margin : float, default 10
        By how much the evidence of the process must exceed that of a sensor.
    smallest : float, default 2
        Size, over the noise of a sensor, below which the windows isolate no sensor, since a model errs by as much: the alarm is
        undecided. A parameter or input must differ by `USUAL` of its prior standard deviation.
    max_faults : int, optional
        Sensors that may be left out at once (None: what the plant's redundancy allows, half of the sensors or fewer, see
        `redundancy`; `inspect` states it, and `Decision.capped` where it binds).
    accommodate : bool, default True
        Leave out isolated sensors and follow the process; without it the statistics are those of one filter, for sweeps over
        the threshold.
    estimator : Extended, default Extended()
        The filter.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import RobustBank
    >>> from fusion_sfdia.plants import two_tanks
    >>> bank = RobustBank(two_tanks())
    >>> recording = simulate(bank.plant, 100, seeds=[1])
    >>> y = recording.y[:, 0] + (recording.t > 300)[:, None] * [0.2, 0.0, 0.0, 0.0]
    >>> decisions = run(bank, bank.init(), recording.t, y, recording.u)[1]
    >>> decisions.isolated[-1].tolist(), bool(decisions.process[-1].any())
    ([True, False, False, False], False)
    """

    window: int = 32
    memory: int = 256
    false_alarm: float = 1e-3
    process_false_alarm: float = 1e-5
    sensor_margin: float = 3.0
    process_margin: float = 10.0
    smallest: float = 2.0
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
        return (*self._hypotheses.process, *((SINCE_START,) if self._needs_earlier else ()))

    @cached_property
    def _needs_earlier(self) -> bool:
        """Whether a fault is that of a sensor only where readings have ruled it out before: see `since_start`."""
        return bool(self._hypotheses.added) and not self.plant.uncertainty.fits

    @cached_property
    def _grids(self) -> tuple[OnsetGrid, OnsetGrid]:
        return OnsetGrid.spanning(self.window), OnsetGrid.spanning(self.memory, SLOW_STEP)

    @cached_property
    def _stated_inflation(self) -> Array:
        """By how much sums over 0, 1, .. samples vary at least (memory + 1, N), by the slow noise that sensors state."""
        n = np.maximum(np.arange(self.memory + 1.0), 1.0)
        return np.array(slow_noise.inflation_of(n[:, None], *self.plant.slow_noise))

    @cached_property
    def _change_sigma(self) -> Array:
        """Standard deviation of the noise in a difference of successive readings (N,), over the square root of 2."""
        share, kept = self.plant.slow_noise
        return np.asarray(self.plant.sensor_sigma * np.sqrt(1 - share * kept))

    @cached_property
    def _limits(self) -> ChiSquareLimits:
        """Quantiles of normal variables, shared by sensors or process hypotheses and by the onsets."""
        scale, onsets = self.threshold_scale, sum(grid.slots for grid in self._grids)
        half = (1 - QUIET_SHARE) * self.false_alarm / 2 / len(self.plant.sensors)
        shares = (half, half / onsets, self.process_false_alarm / len(self._hypotheses.process) / onsets)
        one, window, process = (float((scale * ndtri(s / 2)) ** 2) for s in shares)
        of, none = self._hypotheses, np.zeros(len(self.plant.states))
        smallest = np.concatenate([self.smallest * self.plant.sensor_sigma, USUAL * of.sd, none])
        return ChiSquareLimits(one, window, process, np.array(self.sensor_margin), self.process_margin, smallest)

    def _start(self, batch: tuple[int, ...], seed: int) -> RobustMemory:
        of = self._hypotheses
        steady = self._gains.start(batch) if self._gains else ()
        return empty_memory(of, self.estimator.start(of.model, batch, step_stream(seed, 0)), batch, self._grids, steady)

    @cached_property
    def _gains(self) -> SteadyGains | None:
        """The gains at rest, where the model has such."""
        of = self._hypotheses
        if not can_rest(of.model):
            return None
        F = of.model.step_jacobian_at(0.0, of.model.x0, of.model.input_at(0.0), of.model.dt)
        return SteadyGains(of.model, [grid.oldest for grid in self._grids], [of.recent(F, 1), of.slow(F, np.ones(1))])

    def _readmitted(self, memory: RobustMemory, t: float, which: Array) -> RobustMemory:
        used: RobustMemory = super()._readmitted(memory, t, which)
        out_for, led = (np.where(which, 0.0, a) for a in (memory.out_for, memory.led))
        fresh = no_pairs(memory.led.shape[:-1], which.shape[-1])
        first = np.where(which, fresh.first, memory.pairs.first)
        pairs = memory.pairs._replace(first=first, squares=np.where(which[..., None, :], fresh.squares, memory.pairs.squares))
        return used._replace(out_for=out_for, led=led, pairs=pairs)

    def _judge(self, memory: RobustMemory, now: TimeStep, y: Array, u: Array) -> tuple[RobustMemory, Decision]:
        if self._gains is None:
            return self._judged(memory, now, y, u)[1]
        return self._gains.judged(
            memory.steady,
            memory.estimate.P,
            now.dt,
            lambda gains: self._judged(memory, now, y, u, gains),
            lambda: self._judged(memory, now, y, u)[1],
        )

    def _judged(
        self, memory: RobustMemory, now: TimeStep, y: Array, u: Array, gains: Gains | None = None
    ) -> tuple[Array, tuple[RobustMemory, Decision]]:
        """A step, at rest where gains are given, and the runs (...) in which that suffices: gains are those of the step, and
        neither the sample nor the windows isolate or accept anything.
        """
        estimate, exclusion, out_for, led, usual, proposed, since_far, *windows, last, standing, pairs = memory[:-6]
        nis, noise, walk, look, ruled_out, steady = memory[-6:]
        of, count = self._hypotheses, y.shape[-1]
        stands = np.asarray(standing.accepted.any(axis=-1))
        begins = of.added > 0 and now.k <= START  # no verdict before what is uncertain has been learnt
        unexplained = none = np.zeros(stands.shape, bool)
        limits, handicap, room = self._limits, of.handicap, self.most_faults - exclusion.out.sum(axis=-1)
        if stands.any():
            limits = limits._replace(sensor_margin=np.where(stands, self.process_margin, self.sensor_margin))
            handicap = np.where(stands[..., None], 0.0, handicap)
            unexplained = stands & leaves_unexplained(nis)  # no sensor is isolated then
            room = np.where(unexplained, 0, room)
        if begins:
            room = np.zeros_like(room)
        rests = none
        if gains:
            prior, joint, rests = predicted(of.model, gains, estimate.x, now, u)
        else:
            prior = self._predict(estimate, standing, walk, now, u)
            if of.added and now.k in LEARNT_AGAIN:
                prior = with_prior_unknowns(prior, of.sd)
            joint = self._joint(prior, noise, now, u)
        y = self.plant.near(y, joint.y)
        usable = np.isfinite(y) & ~exclusion.out
        spread = noise.spread
        everything = statistics_at_rest(gains, joint, y) if gains else statistics(joint, y, usable)
        counted, whole = clipped(everything, spread), none  # whole: runs in which outliers count as they are
        assert prior.tangent is not None and joint.H is not None
        if gains:
            less = (counted.less,) if counted.less.any() else ()
            weighed, *more = weigh_at_rest(self._shifted(windows, now.k), gains, counted.found.whitened, *less)
        else:
            step = window_step(last, prior.tangent, joint.H, counted.found, windows[0].eta.dtype, of.leading)
            if self._gains:
                steady, windows = self._gains.awake(steady, estimate.P, windows)
            weighed = self._weigh(windows, prior.tangent, step, now.k)
        inflations = tuple(inflation_of(noise, w.age, self._stated_inflation) for w in weighed)
        tested, evidence = self._compete(weighed, inflations, counted.found, handicap)
        of_whole = evidence
        if counted.less.any():  # of a fault of the process, it may be
            as_they_are = more[0] if gains else [with_readings(w, counted.less) for w in weighed]
            other, of_whole = self._compete(as_they_are, inflations, everything, handicap)
            whole = of_whole.best_process > self._of_outliers(everything, spread)
            if whole.any():
                tested, evidence = of_runs(whole, (other, of_whole), (tested, evidence))
                counted = unclipped(counted, everything, whole)
        isolated, capped = np.zeros(y.shape, bool), none
        far = (everything.chi_square > limits.one * spread).any(axis=-1)
        if far.any() and gains is None:
            present = Present(tested.recent.changes(slice(0, 1), count)[..., 0, :, :], of.recent_sizes, handicap)
            isolated, capped = eliminated(everything, of_whole, present, limits, room)
        by_windows = accepted(evidence, limits, np.asarray(~isolated.any(axis=-1)) & (not begins))
        usual = np.where(usable, np.where(everything.chi_square < USUAL_SQUARE * spread, usual + 1, 0.0), usual)
        since_far = np.where((everything.chi_square > FAR_SQUARE * spread).any(axis=-1), 0.0, since_far + 1)
        if by_windows.is_process.any() or proposed.any():
            several = np.sum(everything.chi_square > CLIP**2 * spread, axis=-1) > 1  # far readings
            again = (since_far <= FOLLOWED_FOR) & self._follows(everything, usable).any(axis=-1) & ~(whole & several)
            by_windows, proposed = self._confirmed(by_windows, proposed, again, usable)
        used, found, leads = everything, counted.found, led
        led = np.where(usable, 0.0, leads)  # a sensor that has no reading now keeps its lead
        process, restart = by_windows.is_process, none
        waits = np.zeros(y.shape, bool)
        if gains is None and (isolated.any() or by_windows.is_sensor.any() or process.any()):
            capped = capped | (by_windows.is_sensor & (room < 1))
            sensor, soon = by_windows.is_sensor & (room > 0), stands & (standing.since <= LATELY)
            spike = sensor & self._is_spike(tested, by_windows.sensor, usual, self._follows(everything, usable))
            led = np.where(usable, led_by(leads, isolated, np.where(isolated, everything.innovation, 0.0)), leads)
            waits = isolated & (np.abs(led) < np.where(soon, PERSISTENT, TWICE)[..., None])
            isolated = (isolated & ~waits) | ((sensor & ~spike)[..., None] & one_hot(by_windows.sensor, count))
            freed = absorbed_before(evidence, isolated, by_windows.sensor) | spike
            changed, leaves = freed | process, isolated.any(axis=-1)
            if self.accommodate and changed.any():
                rivals = alternatives(evidence, by_windows, self.process_margin)
                standing = self._stand(standing, by_windows, evidence, prior, rivals > 0)
                prior = with_alternatives(moved(prior, tested, evidence, by_windows, freed), tested, rivals)
                joint = self._joint(prior, noise, now, u)
            restart = (changed | leaves) & self.accommodate
            if restart.any() or (self.accommodate and waits.any()):
                used = statistics(joint, y, usable & ~isolated & ~waits)
                found = unclipped(clipped(used, spread), used, whole).found
        if self._needs_earlier:
            ruled_out = before_jumps(ruled_out, noise.last, everything, spread)
            if not begins:
                since = self._since_start(isolated, by_windows, ruled_out, everything, evidence)
                calm = ~stands & (evidence.statistic_p < limits.process * CALM).all(axis=-1)
                fits = usable & (evidence.statistic_s < limits.window * CALM) & calm[..., None]
                ruled_out = seen_again(ruled_out, weighed[0], inflations[0], fits)
                ruled_out = ruled_out._replace(unclear=ruled_out.unclear | since)
        if begins and now.k == LEARNT_AGAIN[-1]:
            restart = np.ones(stands.shape, bool)
        capped = capped & ~unexplained & (not begins)
        if self._gains:  # with more than the readings, which gains depend on
            depends = stands | walk.rate.any(axis=-1) | is_larger(noise).any(axis=-1)
        if gains:
            event = far | by_windows.is_sensor | by_windows.is_process | proposed.any(axis=-1)
            rests = rests & ~(event | depends | (usable != gains.used).any(axis=-1))
            (x, p), steady = estimate_at_rest(gains, joint, found), steady._replace(rests=np.ones_like(steady.rests))
        else:
            x, p, gain = posterior_and_gain(joint, found)
            last = last_update(step, gain, restart)
            if self._gains:
                steady = self._gains.followed(steady, usable, now.dt, ~(restart | waits.any(axis=-1) | depends))
        recent, slow = (updated(w, restart) for w in (tested.recent, tested.slow))

        share = QUIET_SHARE * self.false_alarm / count
        pairs = paired(pairs, y, self._change_sigma, self.plant.sensor_resolution, share)
        quiet = too_quiet(pairs, share)
        quiet = quiet & ~unexplained[..., None] & (not begins)
        if quiet.any():
            held = exclusion.out | isolated
            fits = held | quietest(pairs, quiet & ~held, self.most_faults - np.sum(held, axis=-1))
            quiet, capped = quiet & fits, capped | np.any(quiet & ~fits, axis=-1)
        if self.accommodate and unexplained.any():
            exclusion = restored(exclusion, unexplained[..., None] & (out_for <= self.window))
        update = ExclusionUpdate(x, p, prior, joint, used, at_rest=gains is not None)
        beyond = everything.chi_square > FAR**2 * limits.one
        counted = unclipped(counted, everything, np.all(beyond | ~usable, axis=-1) & (np.sum(beyond, axis=-1) > 1))
        shown = self._shown(counted.found, evidence, usable, isolated | quiet, capped)
        if begins:
            shown = shown._replace(threshold=np.full(y.shape, np.inf))
        exclusion, decision = self._conclude(now, y, u, exclusion, update, shown)
        ruled_out = ruled_out._replace(unclear=ruled_out.unclear & exclusion.out)
        own = slice(len(self.plant.states), None)
        variance = np.diagonal(p, axis1=-2, axis2=-1)[..., own]
        standing = followed(standing, x[..., own], variance)
        out_for = np.where(exclusion.out, out_for + 1, 0.0)
        learns = ~stands & (not begins or now.k > LEARNT_AGAIN[-1])
        noise = learnt(with_sums(noise, weighed[0], usable, self._stated_inflation, learns), everything, learns)
        before = np.diagonal(prior.core.P, axis1=-2, axis2=-1)[..., own]
        walk = walked(walk, x[..., own] - prior.core.x[..., own], before - variance, ~stands & (not begins))
        after = RobustMemory(
            GaussianState(x, p), exclusion, out_for, led, usual, proposed, since_far, recent, slow, last, standing, pairs,
            faded(nis, everything), noise, walk, look, ruled_out, steady,
        )  # fmt: skip
        if self.accommodate:
            after = self._with_look(memory, after, now, y, u, quiet)
        doubt = after.look.doubt | after.ruled_out.unclear
        if doubt.any():
            decision = replace(
                decision, isolated=decision.isolated & ~doubt, fault_size=np.where(doubt, np.nan, decision.fault_size)
            )
        accounted = np.any(decision.isolated | after.ruled_out.unclear, axis=-1)
        undecided = (decision.score > 1) & ~accounted & ~process
        evidence = of_runs(np.any(isolated, axis=-1), of_whole, evidence)
        return rests, (after, self._with_process(decision, evidence, after, undecided, (x[..., own], variance)))

    def _with_look(
        self, before: RobustMemory, now: RobustMemory, at: TimeStep, y: Array, u: Array, quiet: Array
    ) -> RobustMemory:
        """A fresh look while a verdict stands: it raises doubt, readmits sensors that are left out, as they are right, or
        leaves out those that failed in place of the process.

        It begins with each verdict, with one on the process alone at what was known `before` the step. quiet (..., N): sensors
        whose readings it does not use.
        """
        of, look = self._hypotheses, now.look
        process = np.any(now.standing.accepted & ~before.standing.accepted, axis=-1)
        alone = np.asarray(~now.exclusion.out.any(axis=-1))
        anew = np.asarray(np.any(now.exclusion.out & ~before.exclusion.out, axis=-1) | (process & ~alone))
        look = begun(look, before.estimate, process & alone & ~before.standing.accepted.any(axis=-1), first=True)
        if (look.samples > 0).any():
            prior = self._predict(look.estimate, now.standing, now.walk, at, u)
            joint = self._joint(prior, now.noise, at, u)
            found = statistics(joint, y, np.isfinite(y) & ~quiet)
            assert prior.tangent is not None
            look = with_sample(look, prior.tangent, joint, found)
            size = of.recent_sizes[: y.shape[-1] + of.added]
            inflation = inflation_of(now.noise, look.samples[..., None], self._stated_inflation).common[..., 0]
            out = now.exclusion.out & ~quiet
            judged, right = answered(look, Question(out, now.exclusion.size, size, inflation, self.sensor_margin))
            look, right = of_runs(anew, look, judged), right & ~anew  # what stands since now is not of this look
            if right.any():
                again = self._readmitted(now, at.t, out & right[..., None])
                now = again.restarted(of_runs(right, look.estimate, again.estimate), right)
            blamed = alone & now.standing.accepted[..., : of.added].any(axis=-1)
            failed, bias, estimate = failed_instead(look, size, inflation, blamed)
            if (instead := failed.any(axis=-1) & (np.sum(failed, axis=-1) <= self.most_faults)).any():
                none = nothing(instead.shape, of.added, len(self.plant.states))
                standing = of_runs(instead, none, now.standing)
                exclusion = exclude(now.exclusion, failed & instead[..., None], bias)
                now = now._replace(exclusion=exclusion, standing=standing)
                now, anew = now.restarted(of_runs(instead, estimate, now.estimate), instead), anew | instead
        stands = np.asarray(now.exclusion.out.any(axis=-1) | now.standing.accepted.any(axis=-1))
        if not (stands.any() or (look.samples > 0).any() or look.stood.any()):
            return now
        anew = anew | (stands & (look.samples == 0))
        lasted = np.where(look.first, FIRST, MOST)
        later = stands & ~anew & (look.samples > lasted)
        linearised = stands & ~anew & ~look.first & (look.samples == LINEARISED_AGAIN)
        look = begun(look, now.estimate, anew, first=True)
        if later.any():
            look = begun(look, self._uncertain(now, now.estimate.x, at, u), later, first=False)
        if linearised.any():
            start = self._uncertain(now, look.estimate.x, at, u)
            look = begun(look, start, linearised, first=False, samples=LINEARISED_AGAIN + 1)
        return now._replace(look=remembered(look, stands, now.standing.accepted))

    def _uncertain(self, now: RobustMemory, x: Array, at: TimeStep, u: Array) -> GaussianState:
        """The states of x (..., z) with the nominal unknowns, as uncertain as at first; the states also as now, and as the
        faults of the sensors that are left out would change them.
        """
        of, n = self._hypotheses, len(self.plant.states)
        x = np.where(np.arange(x.shape[-1]) < n, x, of.model.x0)
        p = np.zeros_like(now.estimate.P) + gaussian.dense(of.model.initial_cov)
        p[..., :n, :n] += now.estimate.P[..., :n, :n]
        out, fault, *_ = now.exclusion
        if out.any():
            changes = least_change(of.model.output_jacobian_at(at.t, x, u)[..., :n], self.plant.state_scale)
            g = changes * np.where(out, fault, 0.0)[..., None]
            p[..., :n, :n] += np.swapaxes(g, -1, -2) @ g
        return GaussianState(x, p)

    def _joint(self, prior: Prior, noise: ReadingNoise, now: TimeStep, u: Array) -> Joint:
        """State and readings before the update, of sensors whose noise is clearly larger than stated with that noise."""
        joint = self.estimator.joint(self._hypotheses.model, prior, now.t, u)
        larger = is_larger(noise)
        if not larger.any():
            return joint
        S = np.array(joint.S)
        np.einsum("...ii->...i", S)[...] += (
            np.where(larger, np.exp(noise.size - larger_from(larger.shape[-1])) - 1, 0.0) * self.plant.sensor_cov
        )
        return joint._replace(S=S, repeated=None)

    def _follows(self, found: LeaveOneOut, usable: Array) -> Array:
        """Whether the estimate follows so much of an innovation of a sensor (..., N) that one outlier moves it visibly."""
        return np.asarray(usable & (1 - found.weight * self.plant.sensor_sigma**2 > FOLLOWED))

    def _since_start(
        self, isolated: Array, by_windows: Accepted, ruled_out: RuledOut, found: LeaveOneOut, evidence: Evidence
    ) -> Array:
        """The sensors isolated now (..., N), by sample or windows, whose fault may have been there since the first one."""
        if not isolated.any():
            return np.zeros(isolated.shape, bool)
        named = by_windows.is_sensor[..., None] & one_hot(by_windows.sensor, isolated.shape[-1])
        with np.errstate(divide="ignore", invalid="ignore"):
            size = np.where(named, evidence.level[..., : isolated.shape[-1]], found.whitened / found.weight)
        return isolated & ruled_out.allows(size)

    def _is_spike(self, tested: Tested, sensor: Array, usual: Array, follows: Array) -> Array:
        """Whether a sensor (...) had an outlier: its onset is at most `BRIEF` samples ago, and its present reading as expected.

        One of a sensor that the estimate follows (..., N) shows for longer: its onset is at most `FOLLOWED_FOR` samples ago,
        and all but one of its readings since are as expected. usual (..., N): readings in a row that are.
        """
        slot = value_at(tested.best_recent.slot, sensor)
        age, expected = value_at(tested.recent.age, slot), value_at(usual, sensor)
        after = value_at(follows, sensor) & (age <= FOLLOWED_FOR) & (expected >= age - 1)
        return np.asarray((expected > 0) & ((age <= BRIEF) | after))

    def _confirmed(self, by_windows: Accepted, proposed: Array, again: Array, usable: Array) -> tuple[Accepted, Array]:
        """What the windows accept, and the process hypothesis (..., P) that they propose now.

        In the runs `again` (...) holds one is accepted only where it was proposed before, too.
        """
        some = np.asarray(usable.any(axis=-1))
        now = by_windows.is_process[..., None] & one_hot(by_windows.process, proposed.shape[-1])
        confirmed = by_windows.is_process & (~again | (some & value_at(proposed, by_windows.process)))
        return by_windows._replace(is_process=confirmed), np.where(some[..., None], now, proposed)

    def _predict(self, estimate: GaussianState, standing: Standing, walk: Walk, now: TimeStep, u: Array) -> Prior:
        """The prediction of the augmented state, with process noise by errors of equations and by parameters that walk."""
        of, n = self._hypotheses, len(self.plant.states)
        prior = self.estimator.predict(of.model, estimate, now.t_start, u, now.dt, UNUSED)
        x, p = prior.core
        if (noise := added_noise(standing, of.rates, x[..., n:])) is not None:
            p = p + noise
        if (variance := noise_of(walk, of.sd)) is not None:
            p = np.array(p)
            np.einsum("...ii->...i", p)[..., n:] += variance
        return prior if p is prior.core.P else prior._replace(core=GaussianState(x, p))

    def _weigh(self, windows: Sequence[Window], F: Array, step: WindowStep, k: int) -> list[Weighed]:
        """Add the present readings to both windows; F: tangent of the step, the k-th."""
        of, (recent, slow) = self._hypotheses, self._shifted(windows, k)
        return [weigh(recent, step, of.recent(F, recent.age.shape[-1])), weigh(slow, step, of.slow(F, slow.age))]

    def _shifted(self, windows: Sequence[Window], k: int) -> list[Shifted]:
        return [shifted(w, grid, k) for w, grid in zip(windows, self._grids, strict=True)]

    def _compete(
        self, weighed: Sequence[Weighed], inflations: tuple[Inflation, ...], found: LeaveOneOut, handicap: Array
    ) -> tuple[Tested, Evidence]:
        """The best onsets of the windows, and the evidence of all hypotheses."""
        of, (recent, slow), (near, far) = self._hypotheses, weighed, inflations
        every = np.ones(recent.a.shape[:-2] + recent.a.shape[-1:], bool)
        every[..., : found.used.shape[-1]] = found.used
        best_slow = best_onset(slow, every[..., : slow.a.shape[-1]], of.slow_sizes(slow.age), inflation=far)
        tested = Tested(recent, slow, best_onset(recent, every, of.recent_sizes, inflation=near), best_slow)
        one = one_sample_evidence(found, of.recent_sizes[: found.used.shape[-1]])
        return tested, gathered(tested.best_recent, best_slow, slow.age, one, handicap)

    def _of_outliers(self, found: LeaveOneOut, spread: Array) -> Array:
        """Evidence (...) of the sensors whose readings are clipped, of all together: each but one needs `UNNAMED` more."""
        beyond = found.chi_square > CLIP**2 * spread
        each = one_sample_evidence(found, self._hypotheses.recent_sizes[: beyond.shape[-1]])
        return np.asarray(np.sum(np.where(beyond, each - UNNAMED, 0.0), axis=-1) + UNNAMED)

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
        self, decision: Decision, evidence: Evidence, now: RobustMemory, undecided: Array, added: tuple[Array, Array]
    ) -> Decision:
        """The decision with the process hypotheses and the suspects; estimate and covariance of the plant's own states."""
        n, (z, variance) = len(self.plant.states), added
        nominal = self._hypotheses.model.x0[n:]
        size, sd = sizes(now.standing, z - nominal, variance)
        suspect = suspects(evidence, undecided, self.process_margin)
        suspect[..., : now.led.shape[-1]] |= (undecided[..., None] & now.look.doubt) | now.ruled_out.unclear
        process, probability = now.standing.accepted, evidence.probability
        if self._needs_earlier:
            more = now.ruled_out.unclear.any(axis=-1, keepdims=True)
            none, unknown = np.zeros_like(more), np.full(more.shape, np.nan)
            process, suspect = np.concatenate([process, none], axis=-1), np.concatenate([suspect, more], axis=-1)
            size, sd, probability = (
                np.concatenate([a, b], axis=-1) for a, b in ((size, unknown), (sd, unknown), (probability, 0.0 * more))
            )
        assert decision.covariance is not None
        found = {
            "estimate": decision.estimate[..., :n], "covariance": decision.covariance[..., :n, :n],
            "process": process, "process_size": size, "process_sd": sd, "suspect": suspect, "probability": probability,
        }  # fmt: skip
        return Decision(**{**vars(decision), **found})
