"""The filter of a second look over parts of a long log, side by side as a batch."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.any_time import ANY_TIME
from fusion_sfdia.detectors.kalman_banks.steady_gains import can_rest
from fusion_sfdia.diagnosis.hindsight_steps import FILTER, NO_DRAWS, Hindsight, Steps, begun, keep, seen_at
from fusion_sfdia.filters.estimators import GaussianState
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

SHORTEST, FEWEST, MOST_PARTS, MOST_ELEMENTS = 1000, 8, 256, 2**18  # samples in a part of a long log; its parts; of their P
MARKS = 24  # states kept in each part, to be compared with
SAME = 1e-9  # standard deviations in which two filters differ that have forgotten their beginnings
SWEEPS = 3  # over parts, before what has not forgotten is filtered in order


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
