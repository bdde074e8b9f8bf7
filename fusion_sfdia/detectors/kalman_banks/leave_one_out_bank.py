"""Detector: one central Kalman filter with exact leave-one-out statistics, windowed likelihood ratios, and readmission.

The statistically consistent form of the bank: every sensor is tested against all others, at a stated false-alarm probability.

- One sample: the leave-one-out chi-square u_i^2 / w_i (see `leave_one_out`). The worst sensor above the threshold is
  eliminated, and the statistics of the other sensors follow by a downdate of rank one, until none exceeds it. This separates
  simultaneous faults.
- A window of onsets: generalised likelihood ratios (see `likelihood_window`), which include the effect of the fault on the
  filter.
- Accommodation: an isolated sensor is left out of the update, and its reading is replaced by the estimate. After an alarm of
the
  window the effect of the fault on the estimate is removed. The sensor is readmitted by a likelihood ratio of "healthy" to "as
  faulty as estimated".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.common.arguments import whole
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.exclusion import Exclusion, none_excluded
from fusion_sfdia.detectors.kalman_banks.excluding_bank import ExcludingBank, ExclusionUpdate, SensorTests
from fusion_sfdia.detectors.kalman_banks.leave_one_out import (
    LeaveOneOut,
    eliminate,
    one_hot,
    posterior,
    posterior_and_gain,
    statistics,
)
from fusion_sfdia.detectors.kalman_banks.likelihood_window import (
    Best,
    Effect,
    OnsetGrid,
    Weighed,
    Window,
    absorbed,
    best_onset,
    empty,
    residual_and_threshold,
    shifted,
    updated,
    weigh,
)
from fusion_sfdia.detectors.kalman_banks.steady_gains import (
    Gains,
    SteadyGains,
    can_rest,
    estimate_at_rest,
    predicted,
    statistics_at_rest,
    weigh_at_rest,
)
from fusion_sfdia.detectors.kalman_banks.window_step import LastUpdate, last_update, no_update, window_step
from fusion_sfdia.filters.estimators import UNUSED, Estimator, Extended, GaussianState, Prior, step_stream

Array = NDArray[Any]


class LeaveOneOutMemory(NamedTuple):
    """The filter's estimate, the sensors that are left out, the likelihood ratios of the window, the last update of it, and
    whether its gains are at rest (nothing where they cannot be).
    """

    estimate: GaussianState
    exclusion: Exclusion
    window: Window
    update: LastUpdate
    steady: Any  # Steady, or ()


@dataclass(frozen=True)
class LeaveOneOutBank(ExcludingBank):
    """Leave-one-out bank on one central filter (extended or unscented with redraw).

    Parameters
    ----------
    estimator : Estimator, default Extended()
        The kind of filter.
    window : int, default 15
        Samples over which a fault may have begun; 1 for the one-sample chi-square alone.
    false_alarm : float, default 1e-3
        Probability that an alarm begins in one step with healthy sensors. With accommodation an alarm lasts until its sensor is
        readmitted, otherwise until its samples have left the window. The sensors share it equally; with a window, one half is
        for the one-sample test and one half for the onsets. By Bonferroni it is a bound, for a correct model.
    max_faults : int, optional
        Sensors that may be excluded at once (None: what the plant's redundancy allows, half of the sensors or fewer, see
        `redundancy`; `inspect` states it, and `Decision.capped` where it binds).
    accommodate : bool, default True
        Leave out isolated sensors; without it the statistics are those of the filter on all sensors, for sweeps over the
        threshold.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import LeaveOneOutBank
    >>> from fusion_sfdia.plants import two_tanks
    >>> bank = LeaveOneOutBank(two_tanks())
    >>> recording = simulate(bank.plant, 40, seeds=[1])
    >>> y = recording.y[:, 0] + (recording.t > 100)[:, None] * [0.2, 0.0, 0.0, 0.0]
    >>> run(bank, bank.init(), recording.t, y, recording.u)[1].isolated[-1].tolist()
    [True, False, False, False]
    """

    estimator: Estimator = field(default_factory=Extended)
    window: int = 15
    false_alarm: float = 1e-3
    max_faults: int | None = None
    accommodate: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("window, in samples,", self.window, least=1)

    @cached_property
    def limits(self) -> tuple[float, float]:
        """Thresholds on the one-sample statistic and on those of the window: chi-square quantiles with 1 degree of freedom."""
        count, scale = len(self.plant.sensors), self.threshold_scale
        if self.window == 1:
            return float((scale * ndtri(self.false_alarm / count / 2)) ** 2), np.inf
        half = self.false_alarm / 2 / count
        return float((scale * ndtri(half / 2)) ** 2), float((scale * ndtri(half / (self.window - 1) / 2)) ** 2)

    @cached_property
    def _grid(self) -> OnsetGrid:
        """The onsets of the window: the present one, which is the one-sample test, and those before it."""
        return OnsetGrid(self.window if self.window > 1 else 0)

    @cached_property
    def _bias(self) -> Effect:
        """A bias changes the readings by the same in all steps since any onset."""
        return Effect(np.ones(self.window))

    @cached_property
    def _gains(self) -> SteadyGains | None:
        """The gains at rest, where the plant has such."""
        return SteadyGains(self.plant, [self._grid.oldest], [self._bias]) if self.window > 1 and can_rest(self.plant) else None

    def _start(self, batch: tuple[int, ...], seed: int) -> Any:
        n, count = len(self.plant.states), len(self.plant.sensors)
        estimate = self.estimator.start(self.plant, batch, step_stream(seed, 0))
        last = no_update(batch, n, count) if self.window > 1 else no_update(batch, 0, 0)
        steady = self._gains.start(batch) if self._gains else ()
        return LeaveOneOutMemory(estimate, none_excluded(batch, count), empty(batch, self._grid, n, count), last, steady)

    def _judge(self, memory: Any, now: TimeStep, y: Array, u: Array) -> tuple[Any, Decision]:
        if self._gains is None:
            return self._judge_anew(memory, now, y, u)
        return self._gains.judged(
            memory.steady,
            memory.estimate.P,
            now.dt,
            lambda gains: self._judge_at_rest(memory, now, y, u, gains),
            lambda: self._judge_anew(memory, now, y, u),
        )

    def _judge_at_rest(
        self, memory: Any, now: TimeStep, y: Array, u: Array, gains: Gains
    ) -> tuple[Array, tuple[Any, Decision]]:
        """A step at rest, and the runs (...) in which it suffices: they use the readings of the gains, and nothing alarms."""
        (x, _), exclusion, window, last, steady = memory
        plant, (one_limit, window_limit), none = self.plant, self.limits, np.zeros(y.shape, bool)
        prior, joint, rests = predicted(plant, gains, x, now, u)
        y = plant.near(y, joint.y)
        usable = np.isfinite(y) & ~exclusion.out
        found = statistics_at_rest(gains, joint, y)
        ((onsets,),) = weigh_at_rest([shifted(window, self._grid, now.k)], gains, found.whitened)
        best = best_onset(onsets, usable, plant.sensor_sigma, first=1)
        residual, threshold = residual_and_threshold(found, best.statistic, best.size, best.information, self.limits)
        x, p = estimate_at_rest(gains, joint, found)
        tested = SensorTests(usable, none, residual, threshold, found.innovation, none[..., 0], one_limit)
        exclusion, decision = self._conclude(
            now, y, u, exclusion, ExclusionUpdate(x, p, prior, joint, found, at_rest=True), tested
        )
        alarm = (found.chi_square > one_limit) | (best.statistic > window_limit) | (usable != gains.used)
        window, steady = updated(onsets, none[..., 0]), steady._replace(rests=np.ones_like(steady.rests))
        after = LeaveOneOutMemory(GaussianState(x, p), exclusion, window, last, steady)
        return rests & ~alarm.any(axis=-1), (after, decision)

    def _judge_anew(self, memory: Any, now: TimeStep, y: Array, u: Array) -> tuple[Any, Decision]:
        estimate, exclusion, window, last, steady = memory
        plant, est, t = self.plant, self.estimator, now.t
        one_limit, window_limit = self.limits
        prior = est.predict(plant, estimate, now.t_start, u, now.dt, UNUSED)
        joint = est.joint(plant, prior, t, u)
        y = plant.near(y, joint.y)
        usable = np.isfinite(y) & ~exclusion.out
        everything = statistics(joint, y, usable)
        found, isolated, capped = self._eliminate(everything, exclusion.out)
        size = residual = everything.innovation
        if self.window == 1:
            threshold = np.sqrt(one_limit * everything.variance)
        else:
            tangent = prior.tangent if prior.tangent is not None else plant.step_jacobian_at(now.t_start, estimate.x, u, now.dt)
            H = joint.H if joint.H is not None else plant.output_jacobian_at(t, prior.core.x, u)
            step = window_step(last, tangent, H, everything, window.eta.dtype)
            if self._gains:
                steady, (window,) = self._gains.awake(steady, estimate.P, [window])
            onsets = weigh(shifted(window, self._grid, now.k), step, self._bias)
            best = best_onset(onsets, usable, plant.sensor_sigma, first=1)
            residual, threshold = residual_and_threshold(everything, best.statistic, best.size, best.information, self.limits)
            exceeds = best.statistic > window_limit
            if exceeds.any() and (further := exceeds.any(axis=-1) & ~isolated.any(axis=-1)).any():
                worst = np.argmax(best.statistic, axis=-1)
                room = np.sum(exclusion.out, axis=-1) < self.most_faults
                capped = capped | (further & ~room)
                chosen = (further & room)[..., None] & one_hot(worst, y.shape[-1])
                size = np.where(chosen, best.size, size)
                if np.any(chosen) and self.accommodate:
                    joint = est.joint(plant, prior := _without_fault(prior, onsets, best, worst, chosen), t, u)
                    found, isolated, again = self._eliminate(statistics(joint, y, usable & ~chosen), exclusion.out | chosen)
                    capped = capped | again
                isolated = isolated | chosen
        if not self.accommodate:
            found = everything
        if self.window > 1:
            x, p, gain = posterior_and_gain(joint, found)
            restart = np.asarray(isolated.any(axis=-1) & self.accommodate)
            window, last = updated(onsets, restart), last_update(step, gain, restart)
            if self._gains:
                steady = self._gains.followed(steady, usable, now.dt, ~restart)
        else:
            x, p = posterior(joint, found)
        update = ExclusionUpdate(x, p, prior, joint, found)
        tested = SensorTests(usable, isolated, residual, threshold, size, capped, one_limit)
        exclusion, decision = self._conclude(now, y, u, exclusion, update, tested)
        return LeaveOneOutMemory(GaussianState(x, p), exclusion, window, last, steady), decision

    def _eliminate(self, found: LeaveOneOut, out: Array) -> tuple[LeaveOneOut, Array, Array]:
        """Eliminate the worst sensor above the one-sample threshold until none is above it or too many are excluded.

        Return the statistics of the other sensors, the eliminated sensors (..., N), and whether another is above it (...).
        """
        isolated = np.zeros(found.used.shape, bool)
        limit, _ = self.limits
        while True:
            chi_square = found.chi_square
            above = np.asarray((chi_square > limit).any(axis=-1))
            if not above.any():
                return found, isolated, above
            worst = np.argmax(chi_square, axis=-1)
            where = above & (np.sum(out | isolated, axis=-1) < self.most_faults)
            if not where.any():
                return found, isolated, above
            isolated = isolated | (where[..., None] & one_hot(worst, found.used.shape[-1]))
            found = eliminate(found, worst, where)


def _without_fault(prior: Prior, onsets: Weighed, best: Best, sensor: Array, chosen: Array) -> Prior:
    """The prior without the effect of the fault of `sensor` since its onset, plus the uncertainty of that effect."""
    x, p = prior.core
    moved = np.where(np.any(chosen, axis=-1)[..., None], absorbed(onsets, best, sensor), 0.0)
    size, information = (np.take_along_axis(v, sensor[..., None], axis=-1) for v in (best.size, best.information))
    return prior._replace(core=GaussianState(x - moved * size, p + moved[..., :, None] * (moved / information)[..., None, :]))
