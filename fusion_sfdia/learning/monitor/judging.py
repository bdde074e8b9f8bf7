"""Rows of a log against what healthy ones taught: tests of each sensor over their limits, and whether operation was learnt.

Windows of up to 16 rows hold all readings. Longer ones, and noise, leave out the rows that were in trouble as soon as 16 rows
have been quiet, so that an alarm ends with its cause; until then they hold them, so that it does not end before.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.monitor.held_out import LearntLimits
from fusion_sfdia.learning.monitor.residuals import (
    NOISE,
    NOISE_CLIP,
    Means,
    Scale,
    ScaledRows,
    Test,
    about_reference,
    blank,
    level_errors,
    noise,
    novelty,
    stacked,
)
from fusion_sfdia.learning.monitor.windows import Errors, window_sums

Array = NDArray[Any]

QUIET = 16  # rows
FEW = 1 / 3  # share of the sensors that may be off in a row whose far readings are limited


class Judged(NamedTuple):
    """Of the rows of a piece: the means of each scale, sizes and ratios of the tests (T,), and novelty.

    means: as the tests take them, every: as they are. ratio (T, K, N): statistic over its limit. novel (S, K): novelty of
    each scale over its limit. unlike (K, N): how far a sensor is from the learnt runs, or one that drifted when it was learnt
    from its level, over the limit. stopped (K, N): sensors that repeat their reading or have none for too long; they are left
    out of all other tests. together (K,): whether sensors stopped at once. apart (K, N): how much more a sensor is off than
    others of its quantity, see `_apart`. disagree: by how much it disagrees with these, (K, N) of each scale. jumps (K, n): of
    readings.
    """

    tests: tuple[Test, ...]
    means: dict[int, Means]
    every: dict[int, Means]
    ratio: Array
    novel: Array
    unlike: Array
    stopped: Array
    together: Array
    apart: Array
    disagree: dict[int, Array]
    jumps: Array

    @property
    def outside(self) -> Array:
        """Whether operation is outside what was learnt (K,)."""
        return np.asarray(np.any(self.novel > 1, axis=0) | np.any(self.unlike > 1, axis=1))


class Tails(NamedTuple):
    """Of the last rows, oldest first: scaled readings as they are and with far ones limited (K, n), errors of single readings
    (K, N), whether they were in trouble by short windows, and whether a sensor had stopped (K,).
    """

    z: Array
    limited: Array
    change: Array
    unquiet: Array
    stops: Array

    def and_then(self, *rows: Array) -> Tails:
        """With the rows that follow."""
        return Tails(*(np.concatenate(both) for both in zip(self, rows, strict=True)))

    def last(self, rows: int) -> Tails:
        """Of the last so many rows."""
        return Tails(*(a[max(len(a) - rows, 0) :] for a in self))

    def padded(self, rows: int) -> Tails:
        """With zeros in front, so many rows."""
        return Tails(*(np.concatenate([np.zeros((rows - len(a), *a.shape[1:]), a.dtype), a]) for a in self))


class Before(NamedTuple):
    """What the rows before leave to the tests. operation: rows since the present operation began."""

    tails: Tails
    operation: int

    @classmethod
    def none(cls, learnt: LearntLimits) -> Before:
        """At the beginning."""
        n, count = len(learnt.familiar[0].centre), learnt.limits.limit.shape[1]
        no = np.zeros(0, bool)
        return cls(Tails(np.zeros((0, n)), np.zeros((0, n)), np.zeros((0, count)), no, no), 0)


def reach(learnt: LearntLimits) -> int:
    """How many rows before a row its tests take."""
    return max(2 * max(s.w for s in learnt.familiar), max(NOISE) + QUIET, learnt.longest)


def judged(learnt: LearntLimits, rows: ScaledRows, before: Before | None = None) -> tuple[Judged, Before]:
    """Judge the rows that follow on others, of which at least the last `reach` are given; and what is before the next ones."""
    n, tests, limits = learnt.limits.limit.shape[1], learnt.limits.tests, learnt.limits.limit
    before = before or Before.none(learnt)
    new = slice(len(before.tails.z), None)  # these rows among all
    at = {test: k for k, test in enumerate(tests)}
    ratio = np.zeros((len(tests), len(rows.z), n), np.float32)

    def set_ratio(kind: str, w: int, values: Array) -> Array:
        k = at[Test(kind, w)]
        with np.errstate(invalid="ignore"):
            ratio[k] = np.nan_to_num(np.abs(values) / limits[k])
        return np.asarray(ratio[k])

    lasting = [(set_ratio(kind, 1, values), values) for kind, values in (("repeats", rows.repeats), ("missing", rows.missing))]
    stopped = np.any([r > 1 for r, _ in lasting], axis=0)
    together = np.any([_together(r, values) for r, values in lasting], axis=0)
    set_ratio("spike", 1, rows.spikes)
    z = rows.z.copy()
    z[:, :n][stopped] = np.nan
    tested = {scale.w: scale for scale in learnt.model if Test("level", scale.w) in at}
    familiar = {scale.w: scale for scale in learnt.familiar}

    every_z = np.concatenate([before.tails.z, z])
    starts = _operations(learnt, every_z, new.start - before.operation, new.start)
    plain = stacked(every_z, [1])
    means = {1: _as_tested(learnt, plain, starts, [1])[1].at(new)}
    disagree: dict[int, Array] = {}

    def set_ratios(w: int) -> Errors:
        e = level_errors(tested[w], means[w], n)
        set_ratio("level", w, e.level), set_ratio("change", w, e.change)
        if Test("same", w) in at:
            disagree[w] = learnt.stated.disagreement(means[w], w)
            set_ratio("same", w, disagree[w])
        return e

    found = set_ratios(1)
    off = np.fmax(ratio[at[Test("level", 1)]], ratio[at[Test("change", 1)]])
    most = NOISE_CLIP * limits[at[Test("change", 1)]]
    with np.errstate(invalid="ignore"):
        beyond = np.nan_to_num(found.change - np.clip(found.change, -most, most))
    limited = z.copy()  # of the sensor that is off most alone: errors of others may be due to it
    worst = (off == off.max(axis=1, keepdims=True)) & (np.mean(off > 1, axis=1, keepdims=True) <= FEW)
    limited[:, :n] -= np.where(worst, beyond, 0.0)
    known = before.tails.and_then(z, limited, found.change, np.zeros(len(z), bool), stopped.any(axis=1))

    full = {**stacked(known.limited, list(familiar)), 1: plain[1]}
    every = {w: means.at(new) for w, means in full.items()}
    noisy = {w: noise(known.change, w, most)[new] for w in NOISE}
    novel = np.stack([_novelty(scale, every[scale.w].now) for scale in learnt.familiar])
    short = [w for w in tested if w <= QUIET]
    means |= {w: m.at(new) for w, m in _as_tested(learnt, full, starts, short[1:]).items()}
    for w in short[1:]:
        set_ratios(w)
    if Test("noise", QUIET) in at:
        set_ratio("noise", QUIET, noisy[QUIET])
    fast = np.array([scale.w <= QUIET for scale in learnt.familiar])
    known.unquiet[new] = np.any(ratio > 1, axis=(0, 2)) | np.any(novel[fast] > 1, axis=0)
    trouble = known.unquiet[:, None]
    ended = window_sums(trouble.astype(float), QUIET)[:, :1] == 0
    calm = stacked(np.where(trouble, np.nan, known.limited), list(familiar))
    for k, scale in enumerate(learnt.familiar):
        if scale.w > QUIET:
            full[scale.w] = _either(ended, calm[scale.w], full[scale.w])
            every[scale.w] = full[scale.w].at(new)
            novel[k] = _novelty(scale, every[scale.w].now)
    long = [w for w in tested if w > QUIET]
    means |= {w: m.at(new) for w, m in _as_tested(learnt, full, starts, long).items()}
    for w in long:
        set_ratios(w)
    change = np.where(trouble, np.nan, known.change)
    stops = known.stops[:, None].astype(float)
    for w in NOISE:
        if Test("noise", w) in at:
            set_ratio("noise", w, np.where(ended[new], noise(change, w, most)[new], noisy[w]))
            ratio[at[Test("noise", w)]][window_sums(stops, w)[new, 0] > 0] = 0.0
    unlike, levels = _unlike(learnt, every, n), np.array([t.kind == "level" for t in tests])
    drifted = np.flatnonzero(learnt.limits.trend)  # while they were learnt: too little is known of their level
    unlike[:, drifted] = np.fmax(unlike[:, drifted], ratio[np.ix_(levels, np.arange(len(z)), drifted)].max(axis=0))
    ratio[np.ix_(levels, np.arange(len(z)), drifted)] = 0.0
    apart = _apart(learnt, tested, means, limits)
    left = Before(known.last(reach(learnt)), len(every_z) - starts[-1])
    return Judged(tests, means, every, ratio, novel, unlike, stopped, together, apart, disagree, rows.jumps), left


def _as_tested(learnt: LearntLimits, every: dict[int, Means], starts: Sequence[int], scales: Sequence[int]) -> dict[int, Means]:
    """The means that the tests take: as they are, or, where logs are runs, about the beginning of each operation."""
    if learnt.absolute is None:
        return {w: every[w] for w in scales}
    return about_reference(every, starts, scales)


def _operations(learnt: LearntLimits, z: Array, start: int, new: int) -> list[int]:
    """The rows in which operations begin: the present one, and, among the new rows, after the longest learnt run, and where the
    leading scores about the beginning are as in no learnt run whichever sensor is left out.
    """
    if learnt.absolute is None:
        return [0]
    scale = max((s for s in learnt.model if s.w <= QUIET), key=lambda s: s.w)
    means = stacked(z, [scale.w])
    starts = [start]
    while True:
        first = max(starts[-1], new)
        part = about_reference({scale.w: means[scale.w]}, starts, [scale.w])[scale.w].now[first:]
        rows = np.flatnonzero(novelty(scale, part) > scale.limit)
        for s in range(z.shape[1]):
            if rows.size:
                rows = rows[novelty(scale, blank(part[rows], s)) > scale.limit]
        ends = [first + int(rows[0])] if rows.size else []
        if starts[-1] + learnt.longest < len(z):
            ends.append(starts[-1] + learnt.longest)
        if not ends or min(ends) <= starts[-1]:
            return starts
        starts.append(min(ends))


def _unlike(learnt: LearntLimits, every: dict[int, Means], n: int) -> Array:
    """How far each sensor is from the learnt runs (K, N), the largest statistic over its limit; 0 where logs are no runs."""
    found = np.zeros((len(every[1].now), n))
    if learnt.absolute is not None:
        model, limits = learnt.absolute
        for k, test in enumerate(limits.tests):
            scale = next(s for s in model if s.w == test.scale)
            e = level_errors(scale, every[test.scale], n)
            values = e.level if test.kind == "level" else e.change
            with np.errstate(invalid="ignore"):
                found = np.fmax(found, np.nan_to_num(np.abs(values) / limits.limit[k]))
    return found


def _apart(learnt: LearntLimits, tested: dict[int, Scale], means: dict[int, Means], limits: Array) -> Array:
    """By how much more each sensor is off than the others of its quantity, each judged without these (K, N), else 0.

    The largest difference of the squares of errors over their limits, of one test at a time.
    """
    n, at = limits.shape[1], {test: k for k, test in enumerate(learnt.limits.tests)}
    found = np.zeros((len(means[1].now), n))
    for of in learnt.stated.groups:
        for w, scale in tested.items():
            squares = np.zeros((2, len(found), len(of)))
            for k, i in enumerate(of):
                alone = means[w]
                for other in of[of != i]:
                    alone = alone.without(int(other))
                e = level_errors(scale, alone, n)
                for which, (kind, values) in enumerate((("level", e.level), ("change", e.change))):
                    squares[which, :, k] = np.nan_to_num(values[:, i] / limits[at[Test(kind, w)], i]) ** 2
            for k, i in enumerate(of):
                more = squares[:, :, k] - np.delete(squares, k, axis=2).max(axis=2)
                found[:, i] = np.maximum(found[:, i], more.max(axis=0))
    return found


def _either(which: Array, one: Means, other: Means) -> Means:
    """The means of one or the other by row, which (K, 1)."""
    quarter = None
    if one.quarter is not None and other.quarter is not None:
        quarter = np.where(which, one.quarter, other.quarter)
    return Means(np.where(which, one.now, other.now), quarter, np.where(which, one.before, other.before))


def _novelty(scale: Scale, means: Array) -> Array:
    return np.asarray(np.nan_to_num(novelty(scale, means) / scale.limit))


def _together(ratio: Array, count: Array) -> Array:
    """Whether at least three sensors, each half way to its limit, stopped in the same row, one of them beyond it (K,)."""
    found = np.zeros(len(ratio), bool)
    for k in np.flatnonzero(np.any(ratio > 1, axis=1)):
        half_way = ratio[k] >= 0.5
        since, how_many = np.unique(count[k][half_way], return_counts=True)
        beyond = count[k][ratio[k] > 1]
        found[k] = np.any((how_many >= 3) & np.isin(since, beyond))
    return found
