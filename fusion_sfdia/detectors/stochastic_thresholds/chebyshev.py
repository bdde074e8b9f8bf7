"""Detector: residuals of present readings with stochastic thresholds alpha s (Boem et al. 2018, "B18", sec. III).

A plant that states its areas has a diagnoser in each, with consensus on the states that they share (consensus_equations); any
other plant has one diagnoser (present_readings). Sensors are isolated by the sizes of a constant fault that explain all
residuals that it affects, left out, and readmitted when they are healthy again (exclusion). B18 does not
isolate sensors: a diagnoser there needs only brackets and drives from the other areas. Isolation of a sensor needs the
residuals of its area and of the areas that share its variable.

Kougiatsos and Reppa 2024 bound the residual of each module of a plant that states its scalar equations (adaptive_threshold).
With the rule "bound" the prediction of `present_readings` has a bound e of the error of each state instead of its variance,

    e+ = |F| e + w,   |y - y_hat| <= |H| e+ + d,   e = |1 - W H| e+ + |W| d        with W the gain, d and w the bounds of noise

This is exact for linear physics. For nonlinear physics it is of first order in the errors and not a guaranteed bound.

Hypotheses of faults: a fault b of sensor i changes the residuals of the last and of this step by known shares of b, which
depend on its onset:

    onset now           0, then e_i
    onset a step ago    e_i, then (1 - M + L) e_i
    onset long ago      (1 - L)^-1 (1 - M) e_i in both steps

where M is the derivative of the expected readings by the readings of the last step, and -L the derivative by its residuals. The
reach of a sensor is its own residual and all residuals that depend on it through M or L: in a network, those of its area and of
the areas that share its variable.

The sizes b for which a residual less share b is within its threshold are an interval. The intersection over the reach and both
steps contains the sizes that explain all of these residuals. A sensor with an empty intersection is excluded; if all sensors
are excluded, the fault is none of these. Of the other sensors that explain an alarm, the one with the largest log-likelihood
ratio to "no fault" is isolated, then the best of those whose reach does not overlap with that of the first, and so on: faults
far from each other are isolated in one step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, number, shown, whole
from fusion_sfdia.common.covariance import diagonal
from fusion_sfdia.detectors.batch_detector import AccommodatingDetector, TimeStep, without_false_alarms
from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.exclusion import Exclusion, exclude, none_excluded, readmit, restored
from fusion_sfdia.detectors.stochastic_thresholds.area_diagnosers import AreaDiagnosers
from fusion_sfdia.detectors.stochastic_thresholds.consensus import MODES
from fusion_sfdia.detectors.stochastic_thresholds.present_readings import (
    PredictedReadings,
    PresentMemory,
    PresentReadings,
    ReadingPredictor,
    Taken,
)
from fusion_sfdia.detectors.stochastic_thresholds.threshold_rules import (
    BOUND,
    CONFORMAL,
    RULES,
    alpha_for,
    conformal_alpha,
    require_alpha,
    require_rule,
)
from fusion_sfdia.filters.estimators import Estimator, Unscented, require_filter
from fusion_sfdia.filters.ukf import SigmaPoints
from fusion_sfdia.plant.redundancy import require_max_faults

Array = NDArray[Any]

CUBATURE = SigmaPoints(alpha=1.0, beta=0.0)
PAPER_ALPHA, PAPER_LAMBDA = 2.0, 0.3  # B18, sec. VIII
AT_ONCE = 32  # runs whose alarms are explained together
READMISSION = 1e-3  # probability with which a sensor that is still faulty is readmitted: exp(-level) of the evidence
ROUNDING = 1e-12  # relative widening of bounds: far more than the rounding of a step
WITHIN = 3.0  # standard deviations, the bound of a noise without a stated bound; chosen here, not published


class ChebyshevMemory(NamedTuple):
    """residual, deviation: (..., N) of the last readings, NaN where not evaluated or left out. exceeded: (..., N) steps in a
    row for which each residual has exceeded its threshold. exclusion: the sensors that are left out. diagnoser: its memory,
    Diagnosers for a plant with areas, PresentMemory for any other.
    """

    residual: Array
    deviation: Array
    exceeded: Array
    exclusion: Exclusion
    diagnoser: Any


@dataclass(frozen=True)
class Chebyshev(AccommodatingDetector):
    """Stochastic thresholds; hypotheses are the sensors.

    Parameters
    ----------
    lam : float, default 0.3
        Filter parameter, 0 <= lam < 1, the share of a residual in the next one; thresholds are tightest with 0. The default is
        that of B18, sec. VIII.
    mode : str, default "corrected"
        "corrected", or "paper" for (15) and (17) as printed.
    rule : str, default "chebyshev"
        Of `threshold_rules`. The rule "conformal" needs alpha from `fit_thresholds`.
    alpha : float or sequence of float (N,), optional
        Thresholds in standard deviations, one number or one for each sensor. With neither alpha nor false_alarm, alpha is 2 as
        in B18, or 1 with the rule "bound", whose thresholds are the largest effect of bounded noise (`BoundedReadings`, one
        diagnoser for the whole plant).
    false_alarm : float, optional
        Instead of alpha: the largest probability of a false alarm of a diagnoser in a step, shared by its sensors.
    moments : Estimator, default Unscented(CUBATURE)
        E and Var of f(x) - f(y) for a plant without areas. Unscented(): sigma points, such as the cubature rule, whose sums do
        not cancel. Extended(): the tangent, exact for linear physics. MonteCarlo(): random draws.
    confirmations : int, default 1
        Steps in a row for which a residual must have exceeded its threshold before a sensor is isolated.
    max_faults : int, optional
        Sensors that may be left out at once (None: what the plant's redundancy allows); no further sensor is isolated where
        more would be left out.
    accommodate : bool, default True
        Leave out isolated sensors; without it no sensor is isolated.

    Raises
    ------
    ValueError
        For settings that are inconsistent.

    Notes
    -----
    Boem et al. 2018 (B18). residual and threshold: as of (13), y - y_hat; its mean is subtracted from the estimate, not from
    the thresholds.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import Chebyshev
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = Chebyshev(two_tanks(), alpha=5.0)
    >>> recording = simulate(detector.plant, 40, seeds=[1])
    >>> y = recording.y[:, 0] + (recording.t > 100)[:, None] * [0.5, 0.0, 0.0, 0.0]
    >>> decisions = run(detector, detector.init(), recording.t, y, recording.u)[1]
    >>> float(recording.t[decisions.isolated[:, 0]][0])
    105.0
    """

    lam: float = PAPER_LAMBDA
    mode: str = "corrected"
    rule: str = "chebyshev"
    alpha: float | Sequence[float] | None = None
    false_alarm: float | None = None
    moments: Estimator = field(default_factory=lambda: Unscented(CUBATURE))
    confirmations: int = 1
    max_faults: int | None = None
    accommodate: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= number("lam", self.lam) < 1:
            raise ValueError(f"lam is {self.lam}; expected at least 0 and less than 1, so that old residuals decay")
        if self.mode not in MODES:
            raise ValueError(f"mode is {shown(self.mode)}; known: {', '.join(MODES)}")
        require_rule(self.rule)
        require_filter(self.moments)
        whole("confirmations", self.confirmations, least=1)
        require_max_faults(self.plant, self.max_faults)
        if self.alpha is not None and self.false_alarm is not None:
            raise ValueError(
                f"alpha is {shown(self.alpha)} and false_alarm {self.false_alarm}; each determines the other: give one"
            )
        if self.alpha is None and self.rule == CONFORMAL:
            raise ValueError(
                "the rule 'conformal' needs alpha from healthy data; leave it out and call fit_thresholds(healthy)"
            )
        self.diagnoser  # noqa: B018 - checks the areas of the plant
        self.alphas  # noqa: B018 - checks that alpha gives a bound of false alarms

    def fit_thresholds(self, healthy: Any, false_alarm: float = 1e-3, warm_up: int = 20) -> Self:
        """The detector with the rule "conformal": alpha of each sensor from healthy readings (see `conformal_alpha`).

        Parameters
        ----------
        healthy : Recording, Log, frame or tuple
            As in `fit`.
        false_alarm : float, default 1e-3
            Rate per step of a diagnoser, shared equally by its sensors.
        warm_up : int, default 20
            Samples that are left out at the beginning.

        Returns
        -------
        Self
            The fitted detector.

        Raises
        ------
        ValueError
            Where there are too few samples.
        """
        t, y, u = self._healthy(healthy, false_alarm, warm_up)
        plain = replace(self, rule="gaussian", alpha=1.0, false_alarm=None, accommodate=False, threshold_scale=1.0)
        _, decisions = run(plain, plain.init(y.shape[1:-1], float(t[0]) - self.plant.dt), t, y, u)
        scores = np.where(np.isfinite(decisions.residual), decisions.scores, np.nan)[warm_up:].reshape(-1, y.shape[-1])
        alpha = [conformal_alpha(scores[:, i], false_alarm / c) for i, c in enumerate(self.components)]
        return replace(
            self, rule=CONFORMAL, alpha=tuple(float(a) for a in alpha), false_alarm=None, threshold_scale=1.0,
            fitted_rate=false_alarm * self.diagnoser_count,
        )  # fmt: skip

    @cached_property
    def diagnoser(self) -> ReadingPredictor:
        """The plant's diagnosers."""
        if self.rule == BOUND:
            return BoundedReadings(self.plant, self.lam, self.moments)
        if self.plant.structure.areas is not None:
            return AreaDiagnosers(self.plant, self.plant.structure.areas, self.lam, self.mode)
        return PresentReadings(self.plant, self.lam, self.moments)

    @cached_property
    def components(self) -> Array:
        """Number of sensors (N,) of the diagnoser of each sensor."""
        return np.array([self._owners.count(owner) for owner in self._owners])

    @property
    def diagnoser_count(self) -> int:
        """One for each area, or one for the plant."""
        return len({*self._owners})

    @cached_property
    def _owners(self) -> list[str]:
        """The area of each sensor (N,), "" for all where the plant has none."""
        return [s.owner if self.plant.structure.areas is not None else "" for s in self.plant.sensors]

    @property
    def claimed_rate(self) -> float:
        """The sum of what the rule states for each sensor at its limit; 0 with thresholds that bounded noise cannot cross, of a
        linear plant with a bound of its process noise.
        """
        if self.rule == CONFORMAL:
            return super().claimed_rate
        if self.rule == BOUND:
            bounded = self.plant.process_bound is not None and all(self.plant.linear) and np.all(self.limits >= 1)
            return without_false_alarms(self.plant) if bounded else np.nan
        stated = RULES[self.rule]
        bound = float(np.sum(stated.false_alarm(self.limits))) if np.all(self.limits > stated.least) else np.nan
        return bound if bound < 1 else np.nan

    @cached_property
    def alphas(self) -> Array:
        """Threshold of each sensor (N,) in standard deviations."""
        count = len(self.plant.sensors)
        if self.false_alarm is not None:
            return np.array([alpha_for(self.rule, self.false_alarm, int(c)) for c in self.components])
        usual = 1.0 if self.rule == BOUND else PAPER_ALPHA
        given = np.atleast_1d(floats("alpha", usual if self.alpha is None else self.alpha))
        if given.shape not in {(1,), (count,)}:
            raise ValueError(f"alpha has shape {given.shape}; expected one number or one for each of {count} sensors")
        return np.broadcast_to([require_alpha(self.rule, a) for a in given], (count,)).astype(float)

    @property
    def limits(self) -> Array:
        """`alphas` (N,) times threshold_scale."""
        return self.threshold_scale * self.alphas

    def _start(self, batch: tuple[int, ...], seed: int) -> ChebyshevMemory:
        count = len(self.plant.sensors)
        shape = (*batch, count)
        last = np.full(shape, np.nan), np.full(shape, np.inf), np.zeros(shape)
        return ChebyshevMemory(*last, none_excluded(batch, count), self.diagnoser.start(batch, seed))

    def _readmitted(self, memory: ChebyshevMemory, t: float, which: Array) -> ChebyshevMemory:
        return memory._replace(
            residual=np.where(which, np.nan, memory.residual),
            deviation=np.where(which, np.inf, memory.deviation),
            exceeded=np.where(which, 0.0, memory.exceeded),
            exclusion=restored(memory.exclusion, which),
        )

    def _judge(self, memory: ChebyshevMemory, now: TimeStep, y: Array, u: Array) -> tuple[ChebyshevMemory, Decision]:
        exceeded, exclusion = memory.exceeded, memory.exclusion
        predicted = self.diagnoser.predict(memory.diagnoser, now, u)
        expected, deviation = predicted.expected, predicted.deviation
        y = self.plant.near(y, expected)
        residual, threshold = y - expected, self.limits * deviation
        exceeded = np.where(np.abs(residual) > threshold, exceeded + 1, 0.0)
        capped = np.zeros(y.shape[:-1], bool)
        if self.accommodate:
            exclusion = readmit(exclusion, residual, deviation**2, self.limits**2, -np.log(READMISSION))  # type: ignore[arg-type]
            trusted = np.isfinite(y) & ~exclusion.out
            rows = np.any(trusted & (exceeded >= self.confirmations), axis=-1)
            if np.any(rows):
                isolated, absorbed, uncertainty = self._explained(memory, predicted, now, u, rows, trusted, residual, threshold)
                capped = np.any(isolated, axis=-1) & (np.sum(exclusion.out | isolated, axis=-1) > self.most_faults)
                isolated &= ~capped[..., None]
                if np.any(isolated & (absorbed != 0)):
                    faults = np.where(isolated, absorbed, 0.0), np.where(isolated, uncertainty, 0.0)
                    predicted = self.diagnoser.without_faults(memory.diagnoser, predicted, now, u, *faults)
                exclusion = exclude(exclusion, isolated, y - predicted.expected)
        used = np.where(exclusion.out, np.nan, y)
        taken = self.diagnoser.take(predicted, used)
        decision = Decision(
            estimate=taken.estimate,
            reconstruction=np.where(np.isfinite(used), used, predicted.expected),
            residual=residual,
            threshold=threshold,
            isolated=exclusion.out,
            fault_size=np.where(exclusion.out, exclusion.size, np.nan),
            diverged=predicted.lost | ~np.all(np.isfinite(taken.estimate), axis=-1),
            guarded=predicted.guarded,
            nis=np.full(predicted.lost.shape, np.nan),
            covariance=taken.covariance,
            capped=capped,
        )
        seen = np.where(exclusion.out, np.nan, residual)
        return ChebyshevMemory(seen, deviation, exceeded, exclusion, taken.memory), decision

    def _explained(
        self,
        memory: ChebyshevMemory,
        predicted: PredictedReadings,
        now: TimeStep,
        u: Array,
        rows: Array,
        trusted: Array,
        residual: Array,
        threshold: Array,
    ) -> tuple[Array, Array, Array]:
        """The sensors (B, N) isolated in the runs chosen by `rows` (B,), and the size and uncertainty (B, N) of faults in the
        last readings.

        A fault that began before this step also affects the last readings. Its size is the smallest that explains the
        residuals, its uncertainty by how much it may be larger. Both are 0 for other faults.
        """
        isolated = np.zeros(trusted.shape, bool)
        absorbed, uncertainty = np.zeros(trusted.shape), np.zeros(trusted.shape)
        flat = np.flatnonzero(rows)
        for part in np.array_split(flat, -(-flat.size // AT_ONCE)):  # bounds the memory, some N^2 numbers a run
            few = np.isin(np.arange(rows.size), part).reshape(rows.shape)
            deviation_before = memory.deviation[few]
            earlier = StepResiduals(memory.residual[few], deviation_before, self.limits * deviation_before)
            evaluated = np.where(trusted[few], residual[few], np.nan)
            present = StepResiduals(evaluated, threshold[few] / self.limits, threshold[few])
            found = explain(earlier, present, *self.diagnoser.effects(memory.diagnoser, predicted, now, u, few), trusted[few])
            isolated[few] = found.isolated
            late = found.isolated & found.late
            absorbed[few] = np.where(late, np.where(found.low > 0, found.low, found.high), 0.0)
            uncertainty[few] = np.where(late, found.high - found.low, 0.0)
        return isolated, absorbed, uncertainty


@dataclass(frozen=True)
class BoundedReadings(PresentReadings):
    """The diagnoser of a plant with the bounds e in its memory; `deviation` is a bound of the residual."""

    @cached_property
    def _noise(self) -> Array:
        """The bounds d (N,)."""
        stated = np.array([s.noise_bound for s in self.plant.sensors])
        return np.where(np.isfinite(stated), stated, WITHIN * self.plant.sensor_sigma)

    def _disturbance(self, dt: float) -> Array:
        """The bounds w (n,) over dt."""
        plant = self.plant
        if plant.process_bound is not None:
            return np.broadcast_to(plant.process_bound, (len(plant.states),)) * (dt / plant.dt)
        return np.asarray(WITHIN * np.sqrt(diagonal(plant.process_cov_over(dt))))

    def start(self, batch: tuple[int, ...], seed: int) -> PresentMemory:
        """As of PresentReadings, with the bound of x0's error."""
        error = WITHIN * np.sqrt(diagonal(self.plant.initial_cov))
        whole = np.broadcast_to(error, (*batch, len(self.plant.states))).copy()
        return super().start(batch, seed)._replace(error=whole)

    def predict(self, memory: PresentMemory, now: TimeStep, u: Array) -> PredictedReadings:
        predicted = super().predict(memory, now, u)
        every = np.ones(predicted.lost.shape, bool)
        F = self._tangent(memory, predicted, now, u, every)
        error = _bounded(F, memory.error) + self._disturbance(now.dt)
        return self._widened(memory, predicted, error)

    def take(self, predicted: PredictedReadings, y: Array) -> Taken:
        taken = super().take(predicted, y)
        W, H = taken.memory.gain, predicted.inner.readout
        kept = np.eye(H.shape[-1]) - W @ H
        error = _bounded(kept, predicted.inner.error) + np.abs(W) @ self._noise
        return taken._replace(memory=taken.memory._replace(error=error))

    def without_faults(
        self, memory: PresentMemory, predicted: PredictedReadings, now: TimeStep, u: Array, size: Array, uncertainty: Array
    ) -> PredictedReadings:
        error = predicted.inner.error
        rows = np.any(size != 0, axis=-1)
        error[rows] += _bounded(self._tangent(memory, predicted, now, u, rows) @ memory.gain[rows], uncertainty[rows])
        return self._widened(memory, super().without_faults(memory, predicted, now, u, size, uncertainty), error)

    def _widened(self, memory: PresentMemory, predicted: PredictedReadings, error: Array) -> PredictedReadings:
        """The predicted readings with bounds of their residuals (B, N) from bounds of the states' errors (B, n)."""
        radius = (_bounded(predicted.inner.readout, error) + self._noise) * (1 + ROUNDING)
        return predicted._replace(deviation=self.lam * memory.deviation + radius, inner=predicted.inner._replace(error=error))


def _bounded(matrix: Array, bound: Array) -> Array:
    """|matrix| bound (..., n) of matrices (..., n, m) and bounds (..., m)."""
    return np.asarray((np.abs(matrix) @ bound[..., None])[..., 0])


class StepResiduals(NamedTuple):
    """Residuals (R, N) of a step, NaN where not evaluated, their standard deviations and thresholds (inf: not testable yet)."""

    residual: Array
    deviation: Array
    threshold: Array


class Explanation(NamedTuple):
    """Result for each run and sensor, (R, N) each.

    isolated: bool. low, high, size: interval and estimate of the fault under the best hypothesis of the sensor. late: whether
    the fault began before this step, so that it affects the expected readings.
    """

    isolated: Array
    low: Array
    high: Array
    size: Array
    late: Array


def explain(
    before: StepResiduals, now: StepResiduals, from_readings: Array, from_residuals: Array, suspects: Array
) -> Explanation:
    """Return the explanation of the residuals of R runs by sensors among `suspects` (R, N) bool.

    from_readings: M, from_residuals: L, both (R, N, N).
    """
    one = np.broadcast_to(np.eye(suspects.shape[-1]), from_readings.shape)
    reach = (one != 0) | (from_readings != 0) | (from_residuals != 0)
    fresh = one - from_readings
    lasting = np.linalg.solve(one - from_residuals, fresh)
    hypotheses = (0.0 * one, one), (one, fresh + from_residuals), (lasting, lasting)
    found = [_sizes(before, now, np.where(reach, a, 0.0), np.where(reach, b, 0.0), reach) for a, b in hypotheses]
    low, high, size, gain = (np.stack(parts) for parts in zip(*found, strict=True))
    explains = (low <= high) & ~((low <= 0) & (high >= 0))
    gain = np.where(explains & suspects, gain, -np.inf)
    best = np.argmax(gain, axis=0)[None]
    low, high, size, gain = (np.take_along_axis(a, best, axis=0)[0] for a in (low, high, size, gain))
    return Explanation(_apart(gain, reach), low, high, size, best[0] > 0)


def _apart(gain: Array, reach: Array) -> Array:
    """Return (R, N) bool: the best sensor, then the best of those whose reach overlaps with that of no chosen one."""
    isolated = np.zeros(gain.shape, bool)
    runs, gain = np.arange(len(gain)), gain.copy()
    while np.any(gain > -np.inf):
        best = np.argmax(gain, axis=-1)
        found = gain[runs, best] > -np.inf
        isolated[runs[found], best[found]] = True
        touched = np.any(reach & reach[runs, :, best][:, :, None], axis=-2)
        gain = np.where(touched & found[:, None], -np.inf, gain)
    return isolated


def _sizes(
    before: StepResiduals, now: StepResiduals, share_before: Array, share_now: Array, reach: Array
) -> tuple[Array, Array, Array, Array]:
    """Return (R, N) each: low and high end of the fault sizes that explain the residuals, the best size, twice its
    log-likelihood ratio.
    """
    residual, deviation, threshold = (np.concatenate(parts, axis=-1)[..., None] for parts in zip(before, now, strict=True))
    share = np.concatenate([share_before, share_now], axis=-2)
    known = np.isfinite(residual) & np.isfinite(threshold) & np.concatenate([reach, reach], axis=-2)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ends = (residual - threshold) / share, (residual + threshold) / share
        without = np.where(
            np.abs(residual) > threshold, -np.inf, np.inf
        )  # where the share is 0: explained by any size, or by none
        least = np.where(share == 0.0, -without, np.minimum(*ends))
        most = np.where(share == 0.0, without, np.maximum(*ends))
    low = np.max(np.where(known, least, -np.inf), axis=-2)
    high = np.min(np.where(known, most, np.inf), axis=-2)
    weight = np.where(known, 1.0 / np.where(known, deviation, 1.0) ** 2, 0.0)
    value = np.where(known, residual, 0.0)
    square, product = np.sum(weight * share**2, axis=-2), np.sum(weight * share * value, axis=-2)
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.clip(product / square, low, high)
        gain = 2 * size * product - size**2 * square
    return low, high, size, np.where(np.isfinite(gain), gain, -np.inf)
