"""A second look at a log after its diagnosis: one Kalman filter without the readings that the detector isolated.

The detector decides sample by sample. Afterwards it is known which readings were faulty, and roughly since when; without these
the filter states what every sensor should have read and how well that is known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.any_time import ANY_TIME
from fusion_sfdia.core.gaps import Track
from fusion_sfdia.core.limits import finite
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.filters.estimators import Extended, GaussianState, step_stream
from fusion_sfdia.filters.gaussian import condition

Array = NDArray[Any]

LEAD = 15  # samples before an isolation that are left out, too: an alarm follows its fault
SHORTEST, FEWEST, MOST_PARTS, MOST_ELEMENTS = 1000, 8, 256, 2**18  # samples in a part of a long log; its parts; of their P
MARKS = 24  # states kept in each part, to be compared with
SAME = 1e-9  # standard deviations in which two filters differ that have forgotten their beginnings
SWEEPS = 3  # over parts, before what has not forgotten is filtered in order
FILTER, NO_DRAWS = Extended(), step_stream(0, 0)


class Residuals(NamedTuple):
    """Of each sample and sensor (K, N) the error and its sd, as a Hindsight has them."""

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
        return Residuals(self.error, self.sd)


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

    A long log is cut into parts, which are filtered side by side as a batch, see `_in_parts`, where the model is the same at
    all times.
    """
    count, n = out.shape
    found, start, steps = unknown(count, n), begun(model), _Steps(track, out)
    with np.errstate(all="ignore"):
        first, core = 0, start
        if track.t.size >= FEWEST * SHORTEST and _forgets(model, steps, found):
            parts = min(track.t.size // SHORTEST, MOST_PARTS, max(1, MOST_ELEMENTS // start.P.size))
            first, core = _in_parts(model, steps, parts, found, each)
        for s in each(range(first, track.t.size)):
            if np.isfinite(track.begins[s]):
                core = start
            before, now = steps.before(s), track.t[s]
            seen = _seen(model, core, before, now, now - before, track.y[s], track.u[s], steps.use[s])
            if not seen.sound:
                for values, none in zip(found, (np.nan, np.nan, np.nan, np.nan, 0), strict=True):
                    values[steps.sample(s) :] = none
                break
            core = seen.core
            if track.own[s]:
                _keep(found, steps.sample(s), seen)
    return found


def unknown(count: int, n: int) -> Hindsight:
    """Of `count` samples of n sensors nothing is known."""
    error, sd, normal = (np.full((count, n), np.nan) for _ in range(3))
    return Hindsight(error, sd, normal, np.full(count, np.nan), np.zeros(count, int))


def begun(model: Plant) -> GaussianState:
    """The filter at its start."""
    found: GaussianState = FILTER.start(model, (), NO_DRAWS)
    return found


def looked(
    model: Plant, core: GaussianState, times: tuple[float, float], values: tuple[Array, Array], use: Array
) -> tuple[GaussianState | None, Hindsight]:
    """One step of `hindsight` over `times` with readings y (N,), of which those to `use` (N,), and inputs u (m,): the filter
    after it, None where it has no finite value, and of this sample what is known.
    """
    (before, now), (y, u) = times, values
    with np.errstate(all="ignore"):
        seen = _seen(model, core, before, now, now - before, y, u, use)
    return (seen.core, seen.row) if seen.sound else (None, Hindsight(*(v[0] for v in unknown(1, len(y)))))


class _Steps:
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


class _Seen(NamedTuple):
    """A step of the filter: what it carries on, whether that is sound (...), and the row of a Hindsight."""

    core: GaussianState
    sound: Array
    row: Hindsight


def _seen(model: Plant, core: GaussianState, before: Any, now: Any, dt: float, y: Array, u: Array, use: Array) -> _Seen:
    """A step of the filter over dt (s) to the readings y (..., N) of which some are used (..., N)."""
    prior = FILTER.predict(model, core, before, u, dt, NO_DRAWS)
    joint = FILTER.joint(model, prior, now, u)
    after = condition(joint, y, use)
    sound = ~prior.lost & finite(after.x) & finite(after.P.reshape(*after.x.shape[:-1], -1))
    w = np.where(use, np.diagonal(after.inverse, axis1=-2, axis2=-1), np.nan)
    d = np.where(use, after.innovation, 0.0)
    error, variance = (after.inverse @ d[..., None])[..., 0] / w, 1 / w
    if not use.all():
        left = ~np.all(use, axis=-1)
        x, P, given, unused = after.x[left], after.P[left], u[left], ~use[left]
        h = model.output_jacobian_at(now, x, given)
        error[left] = np.where(unused, y[left] - model.output(now, x, given), error[left])
        variance[left] = np.where(unused, np.sum((h @ P) * h, axis=-1) + model.sensor_cov, variance[left])
    sd = np.sqrt(variance)
    normal = np.where(use, d / np.sqrt(np.diagonal(joint.S, axis1=-2, axis2=-1)), np.nan)
    return _Seen(GaussianState(after.x, after.P), sound, Hindsight(error, sd, normal, after.nis, np.sum(use, axis=-1)))


def _keep(found: Hindsight, samples: Any, seen: _Seen, own: Any = ...) -> None:
    for values, row in zip(found, seen.row, strict=True):
        values[samples] = row[own]


def _forgets(model: Plant, steps: _Steps, found: Hindsight) -> bool:
    """Whether two filters, of which one begins a standard deviation away and less certain, come to the same in SHORTEST steps.

    They begin after the first reading. Not so for a model that depends on time, or has no finite value.
    """
    x, P = FILTER.start(model, (2,), NO_DRAWS)
    x[1] += np.sqrt(np.diagonal(P[1]))
    now: GaussianState | None = GaussianState(x, np.stack([P[0], 4 * P[1]]))
    for k in range(1, SHORTEST):
        if (now := _batch_step(model, steps, np.array([k, k]), now, found)) is None:
            return False
        if _same(GaussianState(now.x[0], now.P[0]), GaussianState(now.x[1], now.P[1])):
            return True
    return False


def _in_parts(
    model: Plant, steps: _Steps, parts: int, found: Hindsight, each: Callable[[Sequence[int]], Iterable[int]]
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


def _batch_step(model: Plant, steps: _Steps, s: Array, core: GaussianState, found: Hindsight) -> GaussianState | None:
    """The steps s (B,) of a batch, at once those of one length; None where one has no finite value, or depends on time."""
    track, (x, P) = steps.track, core
    if np.any(fresh := np.isfinite(track.begins[s])):
        start = FILTER.start(model, (), NO_DRAWS)
        x, P = np.where(fresh[:, None], start.x, x), np.where(fresh[:, None, None], start.P, P)
    lengths = steps.even[s]
    ahead = GaussianState(np.empty_like(x), np.empty_like(P))
    of_one = [slice(None)] if (lengths == lengths[0]).all() else [lengths == dt for dt in np.unique(lengths)]
    for same in of_one:
        here, part = s[same], GaussianState(x[same], P[same])
        dt = float(lengths[same][0])
        try:
            seen = _seen(model, part, ANY_TIME, ANY_TIME, dt, track.y[here], track.u[here], steps.use[here])
        except Exception:  # whatever a model of numbers raises for a time that is none
            return None
        if not seen.sound.all():
            return None
        ahead.x[same], ahead.P[same] = seen.core
        own = track.own[here]
        _keep(found, steps.sample(here[own]), seen, own)
    return ahead


def _same(one: GaussianState, other: GaussianState) -> Array:
    """Whether states and covariances differ by at most SAME standard deviations (...)."""
    sd = np.sqrt(np.diagonal(one.P, axis1=-2, axis2=-1))
    near = np.all(np.abs(one.x - other.x) <= SAME * sd, axis=-1)
    return np.asarray(near & np.all(np.abs(one.P - other.P) <= SAME * sd[..., :, None] * sd[..., None, :], axis=(-2, -1)))
