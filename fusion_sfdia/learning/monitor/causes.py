"""The verdict of each row in trouble: a sensor, the process, operation that was not learnt, the recorder, or "cannot tell".

A sensor is named where leaving it out explains everything: no test of any other one is beyond its limit, and operation is as
learnt. Other channels of which that holds as well are rivals, and the verdict is that one of them is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.monitor.held_out import WITNESS, LearntLimits
from fusion_sfdia.learning.monitor.judging import Judged
from fusion_sfdia.learning.monitor.residuals import Test, level_errors, novelty
from fusion_sfdia.learning.monitor.steps import Stepped, steps

Array = NDArray[Any]

OK, SENSOR, MOVED, ONE_OF, PROCESS, OUTSIDE, RECORDER = range(7)
MOST = 5  # sensors that are tried, those with the largest ratios
NEAR = 0.4  # by so much more may be left by a rival
SMALL = 0.15  # or so small a share of the largest ratio; chosen on a recorded fault of the chemical plant (d05)
TWO = 8  # sensors, from which on two may be named
CLEAR = 2.0  # times its limit that the first of two leaves, from which on the second is named, too, and not suspected
WORSE = 2.0  # times as far off as it disagrees with others of its quantity: a sensor that is not wrong alone
EVIDENCE = 0.6  # difference of squares of two of one quantity, in limits: likelihoods above 100 to 1 where limits are 4 sd
QUIET = 0.5  # of how far a reading is off, in limits, up to which others that its input drives have not moved with it
HOLD = 4  # windows of the scale that saw it, for which a process verdict keeps sensors from being named
PART = 0.75  # of a limit, some 4 standard deviations: by so much a shorter window exceeds one that shows a part of a fault
LASTS = 1024  # rows after a step in which it decides: the longest window
REST = 16  # rows without trouble after which it is over


class Causes(NamedTuple):
    """Of each row its kind (K,), the sensors that are named and the channels suspected (K, n), and what shows it.

    size (K, N): by how much a named sensor is off, in standard deviations. scale (K,): rows of the window that shows it most.
    ratio (K,): how far the largest statistic is beyond its limit. outside (K,): whether operation is outside what was learnt.
    stepped (K, N): where a step names a sensor, by how many of the largest healthy jumps it is off.
    """

    kind: Array
    named: Array
    suspect: Array
    size: Array
    scale: Array
    ratio: Array
    outside: Array
    stepped: Array

    @property
    def alarm(self) -> Array:
        """Rows in trouble (K,) other than by operation that was not learnt alone."""
        return np.asarray((self.kind != OK) & (self.kind != OUTSIDE))


class Trouble(NamedTuple):
    """What of the rows before decides whether sensors are named, counted to the next row.

    until, last: rows until which the process keeps them from it, and since the last row in trouble, negative; process, sensor:
    rows of such verdicts since the trouble began; moved (n,): sensors that have "moved" since. agreed, apart (N,): rows since a
    sensor disagreed with others of its quantity, and how much more it was off than these since then. stepped: what has jumped.
    begun: the row in which the trouble began. shown (N,): the row in which a step last named a sensor.
    """

    until: int
    last: int
    process: int
    sensor: int
    moved: Array
    agreed: Array
    apart: Array
    stepped: Stepped
    begun: int
    shown: Array

    @classmethod
    def none(cls, channels: int, sensors: int) -> Trouble:
        """At the beginning."""
        stepped, agreed, no = Stepped.none(channels, sensors), np.full(sensors, REST + 1), np.zeros(channels, bool)
        return cls(-1, -REST - 1, 0, 0, no, agreed, np.zeros(sensors), stepped, 0, np.full(sensors, -REST - 1))


def causes(learnt: LearntLimits, found: Judged, driven: Array, before: Trouble) -> tuple[Causes, Trouble]:
    """The verdict of each row, and what the next ones take from them; driven (K, N): sensors whose input is as never learnt."""
    tests = learnt.limits.tests
    total, n = found.ratio.shape[1:]
    channels = found.means[1].now.shape[1]
    ratio = found.ratio.copy()
    stops = np.array([t.kind in ("repeats", "missing") for t in tests])
    ratio[:, found.stopped] = 0.0
    ratio[stops] = 0.0
    outside = found.outside
    by_sensor = ratio.max(axis=0)
    top = by_sensor.max(axis=1)
    kind = np.full(total, OK)
    named, suspect = np.zeros((total, channels), bool), np.zeros((total, channels), bool)
    size = np.full((total, n), np.nan)
    scale = np.array([t.scale for t in tests])[np.argmax(ratio.max(axis=2), axis=0)]
    rows = np.flatnonzero((top > 1) | outside)
    compared = np.array([t.kind == "same" for t in tests])
    same = ratio[compared].max(axis=0, initial=0.0)
    apart, before = _apart(found.apart, same, before)
    proven = np.zeros(named.shape, bool)
    off, since, after = steps(learnt.jumps, found.jumps, found.stopped, before.stepped)
    if rows.size:
        left, nov = _explain(learnt, found, ratio[:, rows], rows, (kind, named, suspect))
        _by_same(learnt, found, rows, (left, nov), (same[rows], apart[rows]), (kind, named, suspect, proven))
        most, whole = _scales(learnt, ratio[:, rows])
        _sizes(learnt, found, rows, most, (named | suspect)[rows, :n] | (off[rows] != 0), size)
        _agreeing(learnt, found, rows, (ratio[:, rows], most), (kind, named, suspect, proven, size))
        _words(learnt, found, rows, (ratio[:, rows], driven), (kind, named, suspect, proven))
        _sizes(learnt, found, rows, whole, (whole != most) & (named | suspect)[rows, :n], size)
    named[:, :n] |= found.stopped
    kind[found.stopped.any(axis=1) & (kind == OK)] = SENSOR
    kind[found.together] = RECORDER
    named[found.together] = suspect[found.together] = False
    before = _by_steps((off, since), (by_sensor, found.stopped), before, (kind, named, suspect, proven, size))
    size[~named[:, :n] | found.stopped] = np.nan
    sure = proven
    sure[:, :n] |= found.stopped
    trouble = _hold((kind, named, suspect), sure, found.stopped | (off != 0), scale, before)._replace(stepped=after)
    shown = np.maximum(top, np.where(found.stopped.any(axis=1), found.ratio[stops].max(axis=(0, 2)), 0.0))
    shown = np.maximum(shown, np.maximum(found.novel.max(axis=0), found.unlike.max(axis=1)))
    stepped = np.abs(off) / learnt.jumps.jump[:n]
    return Causes(kind, named, suspect, size, scale, np.maximum(shown, stepped.max(axis=1)), outside, stepped), trouble


def _apart(apart: Array, same: Array, before: Trouble) -> tuple[Array, Trouble]:
    """The most by which sensors were further off than others of their quantity (K, N), since these disagree by half a limit."""
    found, agreed, most = apart.copy(), before.agreed, before.apart
    if apart.any():
        for k in range(len(apart)):
            agreed = np.where(same[k] > 0.5, 0, agreed + 1)
            found[k] = most = np.where(agreed <= REST, np.maximum(most, apart[k]), apart[k])
    return found, before._replace(agreed=agreed, apart=most)


def _explain(
    learnt: LearntLimits, found: Judged, ratio: Array, rows: Array, into: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    """The verdicts of rows by what leaving sensors out explains; what each channel leaves, and the novelty then (R, n)."""
    kind, named, suspect = into
    tests = learnt.limits.tests
    n, channels = ratio.shape[2], found.means[1].now.shape[1]
    slow = np.array([t.kind in ("level", "change") for t in tests])
    by_scale = {w: [k for k, t in enumerate(tests) if slow[k] and t.scale == w] for w in {t.scale for t in tests}}
    wanted = {w: (ratio[ks].max(axis=(0, 2)) > 1) for w, ks in by_scale.items() if ks}
    by_sensor = ratio.max(axis=0)
    order = np.argsort(-by_sensor, axis=1)[:, : min(MOST, n)]
    tried = np.zeros((rows.size, channels), bool)
    np.put_along_axis(tried, order, True, axis=1)
    tried[:, :n] &= by_sensor > 0
    tried[:, n:] = True
    tried[:, :n] |= ratio[[t.kind == "same" for t in tests]].max(axis=0, initial=0.0) > 1
    partner = learnt.limits.partner
    for i in np.flatnonzero(partner >= 0):
        tried[:, partner[i]] |= tried[:, i]
    left = np.full((rows.size, channels), np.inf)
    nov = np.full((rows.size, channels), np.inf)
    for s in range(channels):
        own = np.flatnonzero(tried[:, s])
        if own.size:
            left[own, s], nov[own, s] = _without(learnt, found, rows[own], (s,), {w: m[own] for w, m in wanted.items()})
    largest = by_sensor.max(axis=1)
    explains = (left <= 1) & (nov <= 1)
    explains[:, n:] = False
    best = np.argmin(np.where(explains, left, np.inf), axis=1)
    some = explains.any(axis=1) & (largest > 1)
    least = left[np.arange(rows.size), best][:, None]
    rival = (((left < 1) & (left < least + NEAR)) | (left < SMALL * largest[:, None])) & some[:, None]
    rival[np.arange(rows.size), best] = False
    outside = found.outside[rows]
    only_fast = (ratio[slow].max(axis=(0, 2)) <= 1) & (largest > 1)
    for r, row in enumerate(rows):
        if only_fast[r] and outside[r]:
            kind[row] = OUTSIDE  # where noise is another one, too
            continue
        if only_fast[r]:
            above = np.flatnonzero(_as_noisy(tests, ratio[:, r]) | (by_sensor[r] > 1))
            if above.size == 1:
                kind[row], named[row, above] = SENSOR, True
                continue
            if above.size == 2 or np.sum(by_sensor[r] > 1) <= 2:
                kind[row], suspect[row, above] = ONE_OF, True
                continue
        if some[r]:
            s = int(best[r])
            if s < n and partner[s] >= 0 and left[r, partner[s]] < CLEAR:
                rival[r, partner[s]] = True
            if rival[r].any():
                kind[row], suspect[row] = ONE_OF, rival[r]
                suspect[row, s] = True
            else:
                kind[row], named[row, s] = SENSOR, True
            continue
        if n >= TWO and largest[r] > 1:
            pair = _two(learnt, found, row, by_sensor[r], (left[r], {w: m[r] for w, m in wanted.items()}))
            if pair and partner[pair[0]] == pair[1]:
                kind[row], suspect[row, list(pair)] = ONE_OF, True
                continue
            if pair:
                kind[row], named[row, pair[0]] = SENSOR, True
                (named if left[r, pair[0]] > CLEAR else suspect)[row, pair[1]] = True
                continue
        kind[row] = OUTSIDE if outside[r] else PROCESS
    drifted = named[rows][:, :n] & learnt.limits.trend
    for r in np.flatnonzero(drifted.any(axis=1)).tolist():  # while they were learnt: they are not named
        suspect[rows[r], :n] |= drifted[r]
        named[rows[r], :n] &= ~drifted[r]
        kind[rows[r]] = kind[rows[r]] if named[rows[r]].any() else OUTSIDE
    return left, nov


def _by_same(
    learnt: LearntLimits, found: Judged, rows: Array, without: tuple[Array, Array], of_rows: tuple[Array, Array],
    into: tuple[Array, Array, Array, Array],
) -> None:  # fmt: skip
    """What disagreement with others of one quantity decides, see `stated_physics`; of_rows: its ratios, and `_apart`."""
    (left, nov), (same, apart), (kind, named, suspect, proven) = without, of_rows, into
    for of in learnt.stated.groups:
        for r in np.flatnonzero((same[:, of] > 1).any(axis=1)).tolist():
            row, over = rows[r], of[same[r, of] > 1]
            known = of[~found.stopped[row, of]]
            wrong = over if known.size > 2 else known[apart[r, known] - np.min(apart[r, known], initial=np.inf) > EVIDENCE]
            if wrong.size == 1 and left[r, wrong[0]] <= 1 and nov[r, wrong[0]] <= 1:
                kind[row], proven[row, wrong] = SENSOR, True
                named[row], suspect[row] = proven[row], False
            elif wrong.size != 1 and kind[row] in (SENSOR, ONE_OF) and (named | suspect)[row, of].any():
                kind[row], suspect[row, over] = ONE_OF, True
                named[row] = suspect[row, learnt.limits.limit.shape[1] :] = False


def _agreeing(
    learnt: LearntLimits, found: Judged, rows: Array, of_rows: tuple[Array, Array],
    into: tuple[Array, Array, Array, Array, Array],
) -> None:  # fmt: skip
    """A sensor whose level is off, and that agrees with others of its quantity, is not wrong: the quantity has moved.

    of_rows: ratios (T, R, N), and the windows (R, N) whose level shows most.
    """
    (ratio, most), (kind, named, suspect, proven, size) = of_rows, into
    n, gain = size.shape[1], np.abs(learnt.stated.gain)
    top = ratio[[t.kind == "level" for t in learnt.limits.tests]].max(axis=0)
    for w, disagree in found.disagree.items():
        d = disagree[rows]
        with np.errstate(invalid="ignore"):
            agrees = (most == w) & (top > 1) & (WORSE * d < np.abs(size[rows]) * gain) & ~proven[rows][:, :n]
        for r in np.flatnonzero((agrees & (named | suspect)[rows][:, :n]).any(axis=1)):
            row = rows[r]
            named[row, :n] &= ~agrees[r]
            suspect[row, :n] &= ~agrees[r]
            if not (named | suspect)[row].any():
                kind[row] = OUTSIDE if found.outside[row] else PROCESS


def _as_noisy(tests: Sequence[Test], ratio: Array) -> Array:
    """Sensors (N,) about as near the limit of their noise as the nearest, beyond it, ratio (T, N).

    The logarithm of a root mean square over w rows has a standard deviation of 1 / sqrt(2 w), and the difference of two one of
    1 / sqrt(w): less than two of these apart, neither stands out.
    """
    found = np.zeros(ratio.shape[1], bool)
    for k, test in enumerate(tests):
        if test.kind == "noise" and (most := ratio[k].max()) > 1:
            found |= ratio[k] > most * np.exp(-2 / np.sqrt(test.scale))
    return found


def _without(
    learnt: LearntLimits, found: Judged, rows: Array, which: tuple[int, ...], wanted: dict[int, Array]
) -> tuple[Array, Array]:
    """The largest ratio of other sensors at the wanted scales, and novelty, without some channels (R,)."""
    tests, limits = learnt.limits.tests, learnt.limits.limit
    n = limits.shape[1]
    at = {t: k for k, t in enumerate(tests)}
    left, nov = np.zeros(rows.size), np.zeros(rows.size)
    for scale in learnt.familiar:
        means = found.every[scale.w].at(rows)
        for s in which:
            means = means.without(s)
        nov = np.fmax(nov, np.nan_to_num(novelty(scale, means.now) / scale.limit))
    for scale in learnt.model:
        if scale.w not in wanted or not wanted[scale.w].any():
            continue
        means = found.means[scale.w].at(rows)
        for s in which:
            means = means.without(s)
        e = level_errors(scale, means, n)
        for name, values in (("level", e.level), ("change", e.change)):
            r = np.nan_to_num(np.abs(values) / limits[at[Test(name, scale.w)]])
            if name == "level":
                r[:, learnt.limits.trend] = 0.0
            for s in which:
                if s < n:
                    r[:, s] = 0.0
            left = np.fmax(left, np.where(wanted[scale.w], r.max(axis=1), 0.0))
    return left, nov


def _two(
    learnt: LearntLimits, found: Judged, row: int, by_sensor: Array, of_row: tuple[Array, dict[int, Array]]
) -> tuple[int, int] | None:
    """Two sensors that explain a row together, the best one with each of the next three; of_row: what each leaves, and the
    scales in alarm.
    """
    n, (left, wanted) = by_sensor.size, of_row
    order = np.argsort(-by_sensor)
    first = int(np.argmin(left[:n])) if np.isfinite(left[:n]).any() else int(order[0])
    at, one = np.array([row]), {w: np.array([m]) for w, m in wanted.items()}
    for other in [int(s) for s in order if s != first][:3]:
        if by_sensor[other] <= 1:
            break
        rest, nov = _without(learnt, found, at, (first, other), one)
        if rest[0] <= 1 and nov[0] <= 1:
            return first, other
    return None


def _sizes(learnt: LearntLimits, found: Judged, rows: Array, scales: Array, wanted: Array, size: Array) -> None:
    """By how much wanted sensors (R, N) are off in rows: their level over windows of so many rows, scales (R, N)."""
    n = size.shape[1]
    for scale in (s for s in learnt.model if s.w in found.means):
        some = wanted & (scales == scale.w)
        own = np.flatnonzero(some.any(axis=1))
        if own.size:
            e = level_errors(scale, found.means[scale.w].at(rows[own])._replace(quarter=None), n)
            at = rows[own]
            size[at] = np.where(some[own], e.level * e.wider, size[at])


def _scales(learnt: LearntLimits, ratio: Array) -> tuple[Array, Array]:
    """The windows (R, N) whose level shows most how far a sensor is off, ratio (T, R, N), and those that show how far it is.

    A window that began before the fault shows only a part of it, and so does a long one of readings that are limited, see
    `judged`. So of the first and shorter ones it is the longest that no shorter one exceeds by more than `PART` of its limit.
    """
    levels = [k for k, t in enumerate(learnt.limits.tests) if t.kind == "level"]  # from the shortest window on
    of = np.array([learnt.limits.tests[k].scale for k in levels])
    limit = learnt.limits.limit[levels][:, None]
    level = ratio[levels] * limit
    exceeded = np.maximum.accumulate(level - PART * limit, axis=0)
    whole = np.concatenate([np.ones((1, *level.shape[1:]), bool), level[1:] >= exceeded[:-1]])
    most = np.argmax(ratio[levels], axis=0)
    until = np.arange(len(of))[:, None, None] <= most
    return of[most], of[len(of) - 1 - np.argmax((whole & until)[::-1], axis=0)]


def _words(
    learnt: LearntLimits, found: Judged, rows: Array, of_rows: tuple[Array, Array], into: tuple[Array, Array, Array, Array]
) -> None:
    """A sensor that nothing else measures has moved: it or the process."""
    (ratio, driven), (kind, named, suspect, proven) = of_rows, into
    tests = learnt.limits.tests
    n = ratio.shape[2]
    alone = learnt.limits.explained < WITNESS
    noisy = [k for k, t in enumerate(tests) if t.kind in ("noise", "spike")]
    of_four = [k for k, t in enumerate(tests) if t.kind in ("level", "change") and t.scale == 4]
    long = [k for k, t in enumerate(tests) if t.kind in ("level", "change") and t.scale >= 16]
    by_noise = ratio[noisy].max(axis=0) >= ratio[of_four].max(axis=0) if of_four else ratio[noisy].max(axis=0) > 1
    if long:
        by_noise &= ratio[long].max(axis=0) <= 1
    by_noise &= ratio[noisy].max(axis=0) > 1
    by_sensor = ratio.max(axis=0)
    own = driven[rows] & ~by_noise & ~found.stopped[rows]
    for r in np.flatnonzero((own & (by_sensor > 1)).any(axis=1) & (kind[rows] != RECORDER)).tolist():
        row = rows[r]
        named[row, :n] &= ~own[r]
        suspect[row, :n] &= ~own[r]
        if not named[row].any():
            kind[row], suspect[row] = OUTSIDE, False
    driver = learnt.stated.driver.astype(float)
    others = driver @ driver.T * ~np.eye(n, dtype=bool) > 0
    of_others = np.array([np.max(np.where(others, r, 0.0), axis=1) for r in by_sensor])
    apart = others.any(axis=1) & (of_others <= QUIET * by_sensor)
    doubt = (kind[rows] == SENSOR)[:, None] & named[rows][:, :n] & alone & ~by_noise & ~proven[rows][:, :n] & ~apart
    for r in np.flatnonzero(doubt.any(axis=1)).tolist():
        row = rows[r]
        suspect[row, :n] |= doubt[r]
        named[row, :n] &= ~doubt[r]
        if not named[row].any():
            kind[row] = MOVED


def _by_steps(
    steps: tuple[Array, Array], of_rows: tuple[Array, Array], before: Trouble, into: tuple[Array, Array, Array, Array, Array]
) -> Trouble:
    """A sensor that stepped as the process cannot is named for `REST` rows, and then while it is off to that side. For `REST`
    rows after it came back windows hold what was: where it is named or suspected then, it is named.

    steps: by how much it is off (K, N), set to 0 where it is not named, and since which row. of_rows (K, N): the largest
    ratio of sensors, and those that stopped.
    """
    (off, since), (by_sensor, stopped), (kind, named, suspect, proven, size) = steps, of_rows, into
    n = off.shape[1]
    begun, last, shown = before.begun, before.last, before.shown
    for k in np.flatnonzero((kind != OK) | (off != 0).any(axis=1)).tolist():
        begun = begun if k - last <= REST else k
        beyond = by_sensor[k] > 1
        off[k] = np.where(beyond & ~(off[k] * size[k] > 0), 0.0, off[k])
        off[k, (since[k] < k - REST) & (~beyond | (since[k] < max(begun - REST, k - LASTS)))] = 0.0
        which = (off[k] != 0) & (kind[k] != RECORDER)
        if kind[k] in (SENSOR, MOVED, ONE_OF):
            which &= (named | suspect)[k, :n]
        off[k, ~which] = 0.0
        after = (named | suspect)[k, :n] & ~stopped[k] & (shown >= k - REST) & ~which
        shown = np.where(which, k, shown)
        if (which | after).any():
            suspect[k] &= kind[k] == SENSOR
            suspect[k, :n] &= ~(which | after)
            named[k, :n] |= which | after
            kind[k], proven[k, :n] = SENSOR, proven[k, :n] | which | after
            size[k, after] = np.nan
            size[k] = np.where(which & (~np.isfinite(size[k]) | (since[k] >= k - REST)), off[k], size[k])
        last = k if kind[k] != OK else last
    return before._replace(begun=begun, shown=shown)


def _hold(verdicts: tuple[Array, Array, Array], sure: Array, stopped: Array, scale: Array, before: Trouble) -> Trouble:
    """While trouble is mostly the process, no sensor is named but those that stopped; nor is one that has "moved" before.

    verdicts: kind (K,), named and suspect (K, n), which change. sure (K, n): sensors that are named also if they have moved.
    """
    (kind, named, suspect), n = verdicts, stopped.shape[1]
    until, last, process, sensor, moved, *_ = before._replace(moved=before.moved.copy())
    for k in np.flatnonzero(kind != OK).tolist():
        if k - last > REST and k > until:
            process = sensor = 0
        if k - last > REST:
            moved[:] = False
        if kind[k] in (PROCESS, OUTSIDE):
            process += 1
            until = max(until, k + HOLD * max(int(scale[k]), REST))
        elif kind[k] in (SENSOR, MOVED, ONE_OF):
            if kind[k] == MOVED:
                moved |= suspect[k]
            again = named[k] & moved & ~sure[k]
            if (k <= until or k - last <= REST) and process > sensor:
                suspect[k] |= named[k]
                named[k, :n] &= stopped[k]
                kind[k] = SENSOR if named[k].any() else PROCESS
            elif again.any():
                suspect[k] |= again
                named[k] &= ~again
                kind[k] = SENSOR if named[k].any() else MOVED
            sensor += 1
        last = k
    rows = len(kind)
    return before._replace(
        until=until - rows,
        last=last - rows,
        process=process,
        sensor=sensor,
        moved=moved,
        begun=before.begun - rows,
        shown=before.shown - rows,
    )
