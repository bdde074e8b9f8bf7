"""A second look at a log after its diagnosis: one Kalman filter without the readings that the detector isolated.

The detector decides sample by sample. Afterwards it is known which readings were faulty, and roughly since when; without these
the filter states what every sensor should have read and how well that is known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.any_time import ANY_TIME
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

LEAD = 15  # samples before an isolation that are left out, too: an alarm follows its fault
FILTER, NO_DRAWS = Extended(), step_stream(0, 0)
SHORTEST, FEWEST, MOST_PARTS, MOST_ELEMENTS = 1000, 8, 256, 2**18  # samples in a part of a long log; its parts; of their P
MARKS = 24  # states kept in each part, to be compared with
SAME = 1e-9  # standard deviations in which two filters differ that have forgotten their beginnings
SWEEPS = 3  # over parts, before what has not forgotten is filtered in order


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

    def with_unknown(self, n: int) -> Hindsight:
        """The same of n sensors, nothing being known of those behind."""
        nan = np.full((*self.error.shape[:-1], n - self.error.shape[-1]), np.nan)
        return self._replace(**{k: np.concatenate([getattr(self, k), nan], axis=-1) for k in ("error", "sd", "normal")})


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


def beginning(
    model: Plant, steps: Steps, found: Hindsight, each: Callable[[Sequence[int]], Iterable[int]]
) -> tuple[int, GaussianState]:
    """Filter as much of a log as is long enough, and a filter that forgets allows; return the next step and its state."""
    start, count = begun(model), steps.track.t.size
    if count < FEWEST * SHORTEST or can_rest(model) or not _forgets(model, steps, found):
        return 0, start
    return _in_parts(model, steps, min(count // SHORTEST, MOST_PARTS, max(1, MOST_ELEMENTS // start.P.size)), found, each)


def _forgets(model: Plant, steps: Steps, found: Hindsight) -> bool:
    """Whether two filters, one of which starts a standard deviation away and less certain, agree after SHORTEST steps.

    They begin after the first reading. Not so for a model that depends on time, or has no finite value.
    """
    x, P = FILTER.start(model, (2,), NO_DRAWS)
    x[1] += np.sqrt(np.diagonal(P[1]))
    now = GaussianState(x, np.stack([P[0], 4 * P[1]]))
    for k in range(1, SHORTEST):
        if (after := _batch_step(model, steps, np.array([k, k]), now, found)) is None:
            return False
        now = after
        if _same(GaussianState(now.x[0], now.P[0]), GaussianState(now.x[1], now.P[1])):
            return True
    return False


def _in_parts(
    model: Plant, steps: Steps, parts: int, found: Hindsight, each: Callable[[Sequence[int]], Iterable[int]]
) -> tuple[int, GaussianState]:
    """Filter parts of equal length as a batch; return the next step and its state.

    A first sweep starts all parts from the plant's x0. A second one starts all but the first from the end of the part before,
    until they have come to what the first sweep found, within SAME standard deviations: from there on the filter has forgotten
    where it began. Further sweeps do so where a part had not forgotten by its end (Lions, Maday and Turinici 2001, with x0 in
    place of a coarse solver). The first part that has not after SWEEPS, and all after it, are left; all, where the model has
    no finite value.
    """
    length = steps.track.t.size // parts
    x, P = (value.copy() for value in FILTER.start(model, (parts,), NO_DRAWS))
    start = GaussianState(x[0].copy(), P[0].copy())
    ends = GaussianState(x.copy(), P.copy())
    marks: dict[int, GaussianState] = {}
    which, at = np.arange(parts), set(np.geomspace(8, length, MARKS).astype(int).tolist())
    for sweep in range(SWEEPS):
        now, running = GaussianState(x[which], P[which]), which
        for k in each(range(length)) if sweep == 0 else range(length):
            after = _batch_step(model, steps, running * length + k, now, found)
            if after is None:
                return 0, start
            now = after
            if k + 1 in at:
                old = marks.setdefault(k, GaussianState(np.full_like(x, np.nan), np.full_like(P, np.nan)))
                far = ~_same(now, GaussianState(old.x[running], old.P[running]))
                old.x[running], old.P[running] = now
                if not far.all():
                    running, now = running[far], GaussianState(now.x[far], now.P[far])
                    if not running.size:
                        break
        ends.x[running], ends.P[running] = now
        which = running[running < parts - 1] + 1  # those whose beginning has changed
        if not which.size:
            break
        x[which], P[which] = ends.x[which - 1], ends.P[which - 1]
    done = int(which.min()) if which.size else parts
    return done * length, GaussianState(ends.x[done - 1], ends.P[done - 1])


def _batch_step(model: Plant, steps: Steps, s: Array, core: GaussianState, found: Hindsight) -> GaussianState | None:
    """The steps s (B,) of a batch, at once those of one length; None where one has no finite value, or depends on time."""
    track, (x, P) = steps.track, core
    if np.any(fresh := np.isfinite(track.begins[s])):
        start = FILTER.start(model, (), NO_DRAWS)
        x, P = np.where(fresh[:, None], start.x, x), np.where(fresh[:, None, None], start.P, P)
    lengths = steps.even[s]
    if (lengths == lengths[0]).all():
        return _equal_step(model, steps, s, GaussianState(x, P), found)
    ahead = GaussianState(np.empty_like(x), np.empty_like(P))
    for dt in np.unique(lengths):
        same = lengths == dt
        if (part := _equal_step(model, steps, s[same], GaussianState(x[same], P[same]), found)) is None:
            return None
        ahead.x[same], ahead.P[same] = part
    return ahead


def _equal_step(model: Plant, steps: Steps, s: Array, core: GaussianState, found: Hindsight) -> GaussianState | None:
    """The same of steps of one length."""
    track = steps.track
    try:
        seen = seen_at(model, core, ANY_TIME, ANY_TIME, float(steps.even[s[0]]), track.y[s], track.u[s], steps.use[s])
    except Exception:  # whatever a model of numbers raises for a time that is none
        return None
    if not seen.sound.all():
        return None
    own = track.own[s]
    if own.all():
        keep(found, steps.sample(s), seen)
    else:
        keep(found, steps.sample(s[own]), seen, own)
    return seen.core


def _same(one: GaussianState, other: GaussianState) -> Array:
    """Whether states and covariances differ by at most SAME standard deviations (...)."""
    sd = np.sqrt(np.diagonal(one.P, axis1=-2, axis2=-1))
    near = np.all(np.abs(one.x - other.x) <= SAME * sd, axis=-1)
    return np.asarray(near & np.all(np.abs(one.P - other.P) <= SAME * sd[..., :, None] * sd[..., None, :], axis=(-2, -1)))


def left_out(isolated: Array, lead: int = LEAD) -> Array:
    """Which readings (K, N) are left out: those that are isolated, and `lead` samples before each."""
    found = isolated.copy()
    for shift in range(1, min(lead, len(isolated) - 1) + 1):
        found[:-shift] |= isolated[shift:]
    return found


def hindsight(model: Plant, track: Track, out: Array, each: Callable[[Sequence[int]], Iterable[int]] = iter) -> Hindsight:
    """Run the extended Kalman filter of a plant over a log without the readings `out` (K, N).

    Of a reading that is used, the error is the leave-one-out residual u_i / w_i with u = S^-1 d and w = diag S^-1, whose
    variance is 1 / w_i; of one that is not, y - h(x) after the others were used, with the variance R + H P H'. Where the
    filter has no finite value any more, everything after is NaN.

    A long log is cut into parts, which are filtered side by side as a batch, where the model is the same at all times: see
    `beginning`. One of a large linear plant is filtered with gains at rest. Of sensors that the plant does not have, behind
    its own, nothing is known.
    """
    count, n = out.shape
    if n > (own := len(model.sensors)):
        return hindsight(model, track._replace(y=track.y[:, :own]), out[:, :own], each).with_unknown(n)
    found, start, steps, run = unknown(count, n), begun(model), Steps(track, out), OneRun(model)
    with np.errstate(all="ignore"):
        first, core = beginning(model, steps, found, each)
        for s in each(range(first, track.t.size)):
            if np.isfinite(track.begins[s]):
                core = start
            seen = run.seen_at(core, steps.before(s), float(track.t[s]), track.y[s], track.u[s], steps.use[s])
            if not seen.sound:
                for values, none in zip(found, (np.nan, np.nan, np.nan, np.nan, 0), strict=True):
                    values[steps.sample(s) :] = none
                break
            core = seen.core
            if track.own[s]:
                keep(found, steps.sample(s), seen)
    return found


def looked(
    model: Plant, core: GaussianState, times: tuple[float, float], values: tuple[Array, Array], use: Array
) -> tuple[GaussianState | None, Hindsight]:
    """One step of `hindsight` over `times` with readings y (N,), of which those to `use` (N,), and inputs u (m,): the filter
    after it, None where it has no finite value, and of this sample what is known.
    """
    (before, now), (y, u), own = times, values, len(model.sensors)
    with np.errstate(all="ignore"):
        seen = seen_at(model, core, before, now, now - before, y[:own], u, use[:own])
    if not seen.sound:
        return None, Hindsight(*(v[0] for v in unknown(1, len(y))))
    return seen.core, seen.row if len(y) == own else seen.row.with_unknown(len(y))
