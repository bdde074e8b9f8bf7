"""The filter of a second look at a log: its steps, of one run or a batch, and what is known of each sample."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.kalman_banks.steady_gains import (
    SETTLED,
    Gains,
    SteadyGains,
    can_rest,
    estimate_at_rest,
    near,
    predicted,
    statistics_at_rest,
)
from fusion_sfdia.filters.estimators import Extended, GaussianState, step_stream
from fusion_sfdia.filters.gaussian import condition
from fusion_sfdia.plant.gaps import Track
from fusion_sfdia.plant.limits import finite
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

FILTER, NO_DRAWS = Extended(), step_stream(0, 0)


class Residuals(NamedTuple):
    """Error and its standard deviation by sample and sensor (K, N), as in a Hindsight."""

    error: Array
    sd: Array


class Hindsight(NamedTuple):
    """Of each sample and sensor (K, N): error, the reading less its estimate from the other sensors, sd of that without a
    fault, and normal, the innovation over its standard deviation where the reading is used. nis (K,): normalised innovation
    squared per reading used, and used (K,), their number. NaN where nothing is known.
    """

    error: Array
    sd: Array
    normal: Array
    nis: Array
    used: Array

    @property
    def residuals(self) -> Residuals:
        """What is needed of it once the model has been judged."""
        return Residuals(self.error, self.sd)


def unknown(count: int, n: int) -> Hindsight:
    """Of `count` samples of n sensors nothing is known."""
    error, sd, normal = (np.full((count, n), np.nan) for _ in range(3))
    return Hindsight(error, sd, normal, np.full(count, np.nan), np.zeros(count, int))


def begun(model: Plant) -> GaussianState:
    """The filter at its start."""
    found: GaussianState = FILTER.start(model, (), NO_DRAWS)
    return found


class Steps:
    """Of each step of a track (S,): its length without rounding errors (even, s), and which readings (S, N) are used."""

    def __init__(self, track: Track, out: Array) -> None:
        self.track = track
        dt = track.t - np.where(np.isfinite(track.begins), track.begins, np.concatenate([[np.nan], track.t[:-1]]))
        usual = float(np.median(dt))  # with one rounding error, in place of those of all times
        as_usual = np.abs(dt - usual) <= 1e-9 * usual
        self.even = np.broadcast_to(usual, dt.shape) if as_usual.all() else np.where(as_usual, usual, dt)
        self.use = np.isfinite(track.y)
        self.use[track.own] &= ~out
        self._sample = None if track.own.all() else np.maximum(np.cumsum(track.own) - track.own, 0)

    def before(self, s: int) -> float:
        """The time before a step (s)."""
        begins = self.track.begins[s]
        return float(begins if np.isfinite(begins) else self.track.t[s - 1])

    def sample(self, s: Any) -> Any:
        """The sample of a step, or of several."""
        return s if self._sample is None else self._sample[s]


class HindsightStep(NamedTuple):
    """A step of the filter: what it carries on, whether that is sound (...), and the row of a Hindsight."""

    core: GaussianState
    sound: Array
    row: Hindsight


def seen_at(
    model: Plant, core: GaussianState, before: Any, now: Any, dt: float, y: Array, u: Array, use: Array
) -> HindsightStep:
    """A step of the filter over dt (s) to the readings y (..., N) of which some are used (..., N)."""
    prior = FILTER.predict(model, core, before, u, dt, NO_DRAWS)
    joint = FILTER.joint(model, prior, now, u)
    y = model.near(y, joint.y)
    after = condition(joint, y, use)
    sound = ~prior.lost & finite(after.x) & finite(after.P.reshape(*after.x.shape[:-1], -1))
    w = np.where(use, np.diagonal(after.inverse, axis1=-2, axis2=-1), np.nan)
    d = np.where(use, after.innovation, 0.0)
    error, variance = (after.inverse @ d[..., None])[..., 0] / w, 1 / w
    if not use.all():
        left = ~np.all(use, axis=-1)
        x, P, given, unused = after.x[left], after.P[left], u[left], ~use[left]
        h = model.output_jacobian_at(now, x, given)
        error[left] = np.where(unused, _apart(model, y[left], model.output(now, x, given)), error[left])
        variance[left] = np.where(unused, np.sum((h @ P) * h, axis=-1) + model.sensor_cov, variance[left])
    sd = np.sqrt(variance)
    normal = np.where(use, d / np.sqrt(np.diagonal(joint.S, axis1=-2, axis2=-1)), np.nan)
    return HindsightStep(GaussianState(after.x, after.P), sound, Hindsight(error, sd, normal, after.nis, np.sum(use, axis=-1)))


class OneRun:
    """The steps of the filter over one run: of a large linear plant with gains at rest, where they are, see `steady_gains`."""

    def __init__(self, model: Plant) -> None:
        self.model = model
        self._gains = SteadyGains(model, (), ()) if can_rest(model) else None
        self._used, self._since = np.zeros(len(model.sensors), bool), 0  # the readings used, and in how many steps before

    def seen_at(self, core: GaussianState, before: float, now: float, y: Array, u: Array, use: Array) -> HindsightStep:
        """The step from the time before (s) to the readings y (N,), of which those in `use` (N,)."""
        step = TimeStep(before, now, now - before, 0, 0)
        if self._gains is not None and self._gains.is_nominal(step.dt):
            self._since = self._since + 1 if np.array_equal(use, self._used) else 0
            self._used = use
            gains = self._gains.of(use) if self._since >= SETTLED else None
            if gains is not None and near(core.P[None], gains.posterior).all():
                if (seen := self._at_rest(gains, core, step, y, u)) is not None:
                    return seen
        return seen_at(self.model, core, before, now, step.dt, y, u, use)

    def _at_rest(self, gains: Gains, core: GaussianState, step: TimeStep, y: Array, u: Array) -> HindsightStep | None:
        """The same by gains at rest; None where the model is another one, or has no finite value."""
        model, use = self.model, gains.used
        _, joint, same = predicted(model, gains, core.x[None], step, u[None])
        y = model.near(y, joint.y[0])
        found = statistics_at_rest(gains, joint, y[None])
        after = estimate_at_rest(gains, joint, found)
        x, whitened, d = after.x[0], found.whitened[0], np.where(use, y - joint.y[0], 0.0)
        if not (same.all() and finite(x).all()):
            return None
        error = whitened / np.where(use, gains.weight, np.nan)
        if not use.all():
            error = np.where(use, error, _apart(model, y, model.output(step.t, x, u)))
        normal = np.where(use, d / np.sqrt(np.diagonal(gains.S)), np.nan)
        count = np.sum(use)
        row = Hindsight(error, gains.sd, normal, d @ whitened / count, count)
        return HindsightStep(GaussianState(x, after.P[0]), np.array(True), row)


def _apart(model: Plant, y: Array, expected: Array) -> Array:
    return np.asarray(model.near(y, expected) - expected)


def keep(found: Hindsight, samples: Any, seen: HindsightStep, own: Any = ...) -> None:
    """Note what is known of some samples: of a batch of steps those that have one of their own."""
    for values, row in zip(found, seen.row, strict=True):
        values[samples] = row[own]
