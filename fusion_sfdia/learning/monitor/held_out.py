"""Limits for a stated rate of rows in alarm, from healthy blocks that the model of each has not seen.

The healthy rows are cut into blocks, or, from four logs on, each log is one. Of each block the statistics come from a model of
other blocks: of those on its longer side without the neighbour where most of the block is operation that this model knows, else
of all but it and its neighbours; of logs from a model of all others. A limit is an upper tolerance limit over blocks of their
quantiles, log-normal (Hahn and Meeker 1991, Statistical intervals, sec. 4.6); with limits from the other blocks, each block
then gives the factor of each sensor, and all sensors together one more.

Where k alarms are asked for in all healthy rows, this one is the k-th largest peak of the held-out ratios, of which those less
than `JOINED` rows apart are one: of as many rows to come k peaks are expected above it.
"""

from __future__ import annotations

import warnings
from bisect import bisect, insort
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fusion_sfdia.common.steps import Each, in_silence
from fusion_sfdia.diagnosis.events import spans
from fusion_sfdia.learning.monitor.residuals import (
    NOISE,
    SCALES,
    Means,
    Model,
    Scale,
    ScaledRows,
    Test,
    about_reference,
    learn_scale,
    level_errors,
    moments_of,
    noise,
    novelty,
    settled,
    stacked,
    tests_of,
)
from fusion_sfdia.learning.monitor.stated_physics import Stated
from fusion_sfdia.learning.monitor.steps import JumpLimits
from fusion_sfdia.learning.monitor.windows import WindowSums, errors, precision_of

Array = NDArray[Any]

BLOCKS = 8
RUNS, MOST_RUNS = 4, 12  # logs, from which on each is a run of its own, and above which neighbours are joined
LONGEST_RELATIVE = 64  # rows of windows about the beginning of an operation
TESTED = 24  # windows of a scale that the healthy rows must hold for its tests
KNOWN = 12  # and for its novelty
RIDGES = (0.001, 0.01, 0.05, 0.2)
OF_TESTS = 0.25  # of the stated rate: the quantile of a single test
OF_SENSORS = 0.5  # and of a single sensor
SURE, SURE_OF_ALL = 0.9, 0.95  # of the tolerance limits of tests and sensors, and of all sensors together
LEAST_FACTOR = 0.7
LEAST_ROWS = 8  # of repeated or missing readings that count
MOST_OUTSIDE = 0.3  # least share of a block that must be inside, for the rows outside to be left out
UNLIKE = 2.0  # factor of a sensor in a block, from which on the block is reported
WITNESSED = (16, 64)  # rows: windows over which it is judged whether others explain a sensor
WITNESS = 0.5  # least share of its slow motion that they explain then
MOSTLY_NOISE = 0.8  # share of the variance of a window's mean beyond which noise is not taken off
STEADY, MOVES = 1.2, 0.75  # ratio of steps to variance of the blocks' means, and their size over the deviation within: a trend
RANGE = (0.005, 0.995)  # quantiles of the readings of a piece, between which they range without a gap
JOINED = 16  # rows: alarms that are fewer apart are one
WILD = 3.0  # times the median over blocks: a block that widens a limit is reported


class Asked(NamedTuple):
    """What is asked: the share of rows in false alarm, and, where a count in a time is stated, the alarms in all healthy rows.

    An alarm is a run of rows in alarm, less than `JOINED` rows apart.
    """

    rows: float
    alarms: float | None = None

    def of(self, part: float) -> Asked:
        """Of a part of the rows."""
        return self if self.alarms is None else self._replace(alarms=self.alarms * part)


class UnlikeBlock(NamedTuple):
    """A block in which a sensor differs from the rest: its place (block), the sensor's index and by which factor."""

    block: int
    sensor: int
    factor: float


@dataclass(frozen=True, eq=False)
class Limits:
    """tests (T,); limit (T, N) of each test and sensor, factors included. rate: share of held-out rows in alarm, its interval.
    alarms: how many begin in a held-out row, runs of rows in alarm, as an interval.

    wild: blocks that widen limits, unlike: blocks that differ. trend (N,): sensors that drifted while they were learnt.
    explained (N,): share of a sensor's slow variance that others explain, partner (N,): the one other sensor that does so
    alone, -1 for none. deviation (T, N): of the statistics of levels, NaN for other tests.
    """

    tests: tuple[Test, ...]
    limit: Array
    rate: tuple[float, float, float]
    alarms: tuple[float, float, float]
    wild: tuple[UnlikeBlock, ...]
    unlike: tuple[UnlikeBlock, ...]
    trend: Array
    explained: Array
    partner: Array
    deviation: Array


class Family(NamedTuple):
    """Tests of one kind of means: their model and limits."""

    model: Model
    limits: Limits


@dataclass(frozen=True, eq=False)
class LearntLimits:
    """What healthy rows teach: the model and the limits of the tests that raise alarms, and the rows between blocks (B + 1,).

    absolute: where the blocks are runs, the tests of the means as they are; those that raise alarms are then about the
    beginning of each operation, which starts anew after `longest` rows, those of the longest run. stated: physics. jumps: what
    is a step of a sensor that has inertia.
    """

    model: Model
    limits: Limits
    edges: Array
    stated: Stated
    jumps: JumpLimits
    absolute: Family | None = None
    longest: int = 0

    @property
    def familiar(self) -> Model:
        """The model of the means as they are: what operation was learnt."""
        return self.model if self.absolute is None else self.absolute.model


class _Rows(NamedTuple):
    """All healthy rows: pieces, the block of each row (K,), how many blocks, whether these are runs, sensors, and physics."""

    pieces: Sequence[ScaledRows]
    of: Array
    blocks: int
    are_runs: bool
    sensors: int
    stated: Stated

    @property
    def starts(self) -> Array:
        return np.cumsum([0, *(len(p.z) for p in self.pieces)])

    def others(self, b: int) -> list[int]:
        """The blocks that do not touch block b; of runs all others."""
        return [c for c in range(self.blocks) if abs(c - b) > (0 if self.are_runs else 1)]


class _View(NamedTuple):
    """Means of all rows as one family of tests sees them, moments of the blocks, and the ridge, of each scale."""

    every: dict[int, Means]
    moments: dict[int, list[WindowSums]]
    ridge: dict[int, float]
    centred: bool

    def model(self, rows: _Rows, which: Sequence[int]) -> Model:
        """The model of these blocks."""
        found = []
        for w, moments in self.moments.items():
            total = WindowSums.together([moments[b] for b in which])
            means = self.every[w].now[np.isin(rows.of, which)][:: max(w // 4, 1)]
            found.append(learn_scale(w, total, self.ridge[w], self.centred, means))
        return tuple(found)


def learn(
    pieces: Sequence[ScaledRows], stated: Stated, rate: Asked, logs: Sequence[int] = (), each: Each = in_silence
) -> LearntLimits:
    """Learn from pieces of healthy rows.

    stated: physics, of all sensors. rate: of alarms. logs: of which log each piece is; with at least `RUNS` logs,
    none longer than half of all rows, the blocks are logs: each is a run of its own. each: wraps the blocks, to show progress.
    """
    lengths, count = [len(p.z) for p in pieces], stated.group.size
    total = sum(lengths)
    blocks_of_runs = _runs(lengths, list(logs) or [0] * len(pieces))
    if blocks_of_runs is None:
        edges = np.linspace(0, total, BLOCKS + 1).round().astype(int)
    else:
        edges = np.cumsum([0, *blocks_of_runs])
    of = np.searchsorted(edges, np.arange(total), side="right") - 1
    rows = _Rows(pieces, of, len(edges) - 1, blocks_of_runs is not None, count, stated)
    known = [w for w in SCALES if w <= max(total / KNOWN, 1)]
    tested = [w for w in known if w <= max(total / TESTED, 1)]
    jumps = _jumps(rows)
    absolute, slow = _view(rows, known), ("level", "change", "same") if stated.groups else ("level", "change")
    if not rows.are_runs:
        return LearntLimits(*_family(rows, absolute, tests_of(tested, total // TESTED, slow), rate, each), edges, stated, jumps)
    shortest = float(np.median(np.diff(edges)))
    relative = [w for w in tested if w <= LONGEST_RELATIVE and settled(w)[1] <= max(shortest / 2, settled(1)[1])]
    unlike = tuple(t for t in tests_of(tested, 0) if t.kind in ("level", "change"))
    of_all = _family(rows, absolute, unlike, rate._replace(alarms=None), each)
    own = _family(rows, _view(rows, relative, relative=True), tests_of(relative, total // TESTED, slow), rate, each)
    explained = np.fmax(own.limits.explained, of_all.limits.explained)
    limits = replace(own.limits, explained=explained, trend=np.zeros(count, bool))
    return LearntLimits(own.model, limits, edges, stated, jumps, of_all, max(lengths))


def _jumps(rows: _Rows) -> JumpLimits:
    """What is a step, by upper tolerance limits of the largest jumps of blocks."""
    jumps = np.concatenate([p.jumps for p in rows.pieces])
    of_blocks = [jumps[rows.of == b] for b in range(rows.blocks)]
    most = np.stack([_of_known(np.nanmax, np.abs(one), axis=0) for one in of_blocks])
    most = np.where(most > 0, most, np.nan)
    largest = [tolerance(np.delete(most, b, axis=0), SURE, pooled=True) for b in range(rows.blocks)]
    ranges = [np.diff(_of_known(np.nanquantile, p.z[:, : rows.sensors], RANGE, axis=0), axis=0)[0] for p in rows.pieces]
    return JumpLimits.of(
        of_blocks, _of_known(np.nanmax, np.stack(ranges), axis=0), np.stack([*largest, tolerance(most, SURE, pooled=True)])
    )


def _runs(lengths: Sequence[int], logs: Sequence[int]) -> list[int] | None:
    """Rows of the blocks where logs are runs of their own, None where they are too few or one is most of all rows."""
    each = [sum(n for n, log in zip(lengths, logs, strict=True) if log == k) for k in dict.fromkeys(logs)]
    if len(each) < RUNS or max(each) > sum(each) / 2:
        return None
    least, joined = np.median(each) / 4, each[:1]
    for n in each[1:]:
        if n < least or joined[-1] < least:
            joined[-1] += n
        else:
            joined.append(n)
    while len(joined) > MOST_RUNS:
        joined = [sum(joined[k : k + 2]) for k in range(0, len(joined), 2)]
    return joined if len(joined) >= RUNS else None


def _view(rows: _Rows, scales: Sequence[int], relative: bool = False) -> _View:
    """The rows as they are, or about the beginning of each piece; the moments of these are about the mean of each piece."""
    parts = [stacked(p.z, scales) for p in rows.pieces]
    if relative:
        parts = [about_reference(part, [0], scales) for part in parts]
    centred = rows.are_runs and not relative
    ridge, moments = {}, {}
    for w in scales:
        found = [moments_of(p.z, w, RIDGES[1]) for p in rows.pieces]
        own = [x - _of_known(np.nanmean, x, axis=0) if relative else x for x, _ in found]
        at = np.concatenate([every + s for (_, every), s in zip(found, rows.starts, strict=False)])
        ridge[w], moments[w] = _ridge(rows, np.concatenate(own) if len(own) > 1 else own[0], at, centred)
    return _View({w: _joined([part[w] for part in parts]) for w in scales}, moments, ridge, centred)


def _joined(parts: Sequence[Means]) -> Means:
    if len(parts) == 1:
        return parts[0]
    quarters = [p.quarter for p in parts if p.quarter is not None]
    return Means(
        np.concatenate([p.now for p in parts]), np.concatenate(quarters) if quarters else None,
        np.concatenate([p.before for p in parts]),
    )  # fmt: skip


def _ridge(rows: _Rows, x: Array, at: Array, centred: bool) -> tuple[float, list[WindowSums]]:
    """The ridge with the smallest held-out errors of levels, and the moments of each block; x (R, 2 n) of the rows at (R,)."""
    whole = np.isfinite(x).all(axis=1)
    x, block = x[whole], rows.of[at[whole]]
    moments = [WindowSums.of(x[block == b]) for b in range(rows.blocks)]
    worth = np.zeros(len(RIDGES))
    for b in range(rows.blocks):
        own = x[block == b]
        if not len(own):
            continue
        total = WindowSums.together([moments[c] for c in rows.others(b)])
        if centred:
            own = own - total.mean
        for k, ridge in enumerate(RIDGES):
            e = errors(precision_of(total.covariance(centred), ridge), own, rows.sensors)
            worth[k] += np.nansum(np.log(e.level**2 + 1e-12))
    return RIDGES[int(np.argmin(worth))], moments


def _family(rows: _Rows, view: _View, tests: tuple[Test, ...], rate: Asked, each: Each) -> Family:
    """The model of all blocks, and limits by models that have not seen a block."""
    stats, used, levels = [], [], []
    for b in each(range(rows.blocks), "learning"):
        own = np.flatnonzero(rows.of == b)
        others = rows.others(b)
        sides = [c for c in others if c < b], [c for c in others if c > b]
        one = view.model(rows, others if rows.are_runs else max(sides, key=len))
        inside = _inside(one, view.every, own)
        if np.mean(inside) <= 0.5 and not rows.are_runs:
            one = view.model(rows, others)
            inside = _inside(one, view.every, own)
        if np.mean(inside) < MOST_OUTSIDE:
            inside = np.ones(own.size, bool)
        stats.append(_statistics(one, tests, rows, view, own))
        used.append(inside)
        levels.append({s.w: level_errors(s, view.every[s.w].at(own)._replace(quarter=None), rows.sensors).level for s in one})
    final = view.model(rows, range(rows.blocks))
    explained, partner = _explained(final, view.every, levels, rows.sensors)
    deviation = np.full((len(tests), rows.sensors), np.nan)
    for k, test in enumerate(tests):
        if test.kind == "level":
            deviation[k] = np.sqrt(_median(np.array([_variance(level[test.scale]) for level in levels]), 0))
    trend = np.zeros(rows.sensors, bool)
    if WITNESSED[0] in view.every and not rows.are_runs:
        trend = _trend([level[WITNESSED[0]] for level in levels])
    limits = _limits(tests, stats, used, rate, len(rows.of) / rows.blocks)
    return Family(final, replace(limits, explained=explained, partner=partner, deviation=deviation, trend=trend))


def _explained(model: Model, every: dict[int, Means], levels: list[dict[int, Array]], count: int) -> tuple[Array, Array]:
    """Which share of the slow motion of each sensor others explain (N,), and which one alone does, -1 for none (N,).

    R2 = 1 - (v - q) / (V - q), v the held-out variance of its error, V that of its means, q that of its own noise; the best of
    the windows `WITNESSED`.
    """
    best = np.full(count, -np.inf)
    steps = _variance(np.diff(every[1].now[:, :count], axis=0)) / 2
    own = np.fmin(_median(np.array([_variance(level[1]) for level in levels]), 0), steps)
    for scale in model:
        if scale.w in WITNESSED:
            v = _median(np.array([_variance(level[scale.w]) for level in levels]), 0)
            total = _variance(every[scale.w].now[:, :count])
            q = np.where(own / scale.w > MOSTLY_NOISE * total, 0.0, own / scale.w)
            best = np.fmax(best, 1 - (v - q) / (total - q))
    if not np.isfinite(best).any():
        best = np.ones(count)
    partner = np.full(count, -1)
    for scale in model:
        if scale.w == WITNESSED[0]:
            partner = _partners(scale, best, count)
    return best, partner


def _partners(scale: Scale, explained: Array, count: int) -> Array:
    """The one sensor (N,) without which a sensor is not explained, where that holds for both; -1 for none."""
    covariance = np.linalg.inv(scale.precision)
    n = len(covariance) // 2
    without = np.zeros((count, count))
    for i in range(count):
        others = np.array([k for k in range(2 * n) if k not in (i, i + n)])
        inverse = np.linalg.inv(covariance[np.ix_(others, others)])
        c = covariance[others, i]
        g = inverse @ c
        for j in range(count):
            if j != i:
                m = np.flatnonzero((others == j) | (others == j + n))  # leaving these out as well
                less = g[m] @ np.linalg.solve(inverse[np.ix_(m, m)], g[m])
                without[i, j] = (c @ g - less) / (covariance[i, i] - scale.ridge)
    needs = (without < WITNESS) & (explained[:, None] >= WITNESS)
    both = needs & needs.T
    np.fill_diagonal(both, False)
    return np.where(both.any(axis=1), np.argmax(both, axis=1), -1)


def _variance(a: Array) -> Array:
    return np.where(np.sum(np.isfinite(a), axis=0) > 1, _of_known(np.nanvar, a, axis=0), np.nan)


def _trend(levels: list[Array]) -> Array:
    """Sensors (N,) whose errors moved to one side while they were learnt, by the means of the blocks (von Neumann 1941)."""
    m = np.stack([_of_known(np.nanmean, level, axis=0) for level in levels])
    within = _of_known(np.nanmean, np.array([_of_known(np.nanstd, level, axis=0) for level in levels]), axis=0)
    about = np.sum((m - m.mean(axis=0)) ** 2, axis=0)
    d = np.sum(np.diff(m, axis=0) ** 2, axis=0) / np.maximum(about, 1e-300)
    return np.asarray((d < STEADY) & (m.std(axis=0, ddof=1) > MOVES * within))


def _inside(model: Model, every: dict[int, Means], rows: Array) -> Array:
    """Whether operation in these rows (K,) is as learnt."""
    found = np.ones(rows.size, bool)
    for scale in model:
        found &= ~(novelty(scale, every[scale.w].now[rows]) > scale.limit)
    return found


def _statistics(model: Model, tests: Sequence[Test], rows: _Rows, view: _View, own: Array) -> Array:
    """Magnitudes (T, K, N) of the tests at these rows, which follow each other."""
    by_w = {scale.w: scale for scale in model}
    found: dict[Test, Array] = {}
    for w in {t.scale for t in tests if t.kind == "level"}:
        e = level_errors(by_w[w], view.every[w].at(own), rows.sensors)
        found[Test("level", w)], found[Test("change", w)] = e.level, e.change
        if Test("same", w) in tests:
            found[Test("same", w)] = rows.stated.disagreement(view.every[w].at(own), w)
    ahead = np.arange(max(own[0] - max(NOISE), 0), own[0])
    if any(t.kind == "noise" for t in tests):
        early = level_errors(by_w[1], view.every[1].at(ahead), rows.sensors).change
        change = np.concatenate([early, found[Test("change", 1)]])
        for w in NOISE:
            found[Test("noise", w)] = noise(change, w)[len(early) :]
    for kind, name in (("spike", "spikes"), ("repeats", "repeats"), ("missing", "missing")):
        if Test(kind, 1) in tests:
            found[Test(kind, 1)] = np.concatenate([getattr(p, name) for p in rows.pieces])[own]
    return np.stack([np.abs(found[t]) for t in tests]).astype(np.float32)


def tolerance(values: Array, p: Array | float, pooled: bool) -> Array:
    """Upper limit of the next of values (B, ...) along the first axis, log-normal, with probability p.

    pooled: the variance is half that of the values and half the median over the last axis. inf where fewer than two are known.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(values)
        known = np.isfinite(logs)
        count = np.sum(known, axis=0)
        mean = np.sum(np.where(known, logs, 0.0), axis=0) / count
        variance = np.sum(np.where(known, (logs - mean) ** 2, 0.0), axis=0) / (count - 1)
        freedom = count - 1.0
        if pooled:
            middle = _median(np.where(count > 1, variance, np.nan), -1)[..., None]
            variance, freedom = 0.5 * variance + 0.5 * middle, 2 * freedom
        found = np.exp(mean + student.ppf(p, np.maximum(freedom, 1)) * np.sqrt(variance * (1 + 1 / count)))
    return np.where(count > 1, found, np.inf)


def _limits(tests: tuple[Test, ...], stats: list[Array], used: list[Array], rate: Asked, length: float) -> Limits:
    blocks, a = len(stats), rate.rows
    with np.errstate(invalid="ignore"):
        q = np.stack([_quantile(s, u, 1 - OF_TESTS * a) for s, u in zip(stats, used, strict=True)])  # (B, T, N)
        longest = np.stack([np.nan_to_num(_of_known(np.nanmax, s, axis=1)) for s in stats])
    q = np.where(q > 0, q, np.nan)
    p = np.array([[max(SURE, 1 - a * length / t.scale)] for t in tests])
    p = np.minimum(p, 1 - 1e-6)
    rows = np.array([t.kind in ("repeats", "missing") for t in tests])

    def limits(which: Array) -> Array:
        found = tolerance(q[which], p, pooled=True)
        least = np.maximum(2 * np.max(longest[which], axis=0), LEAST_ROWS)
        found = np.where(rows[:, None], np.maximum(np.where(np.isfinite(found), found, 0.0), least), found)
        return np.asarray(found)

    others = [np.arange(blocks) != b for b in range(blocks)]
    of_others = [limits(o) for o in others]
    ratios = [_worst(s[~rows], limit[~rows]) for s, limit in zip(stats, of_others, strict=True)]  # (K, N) each
    stops = [np.any(s[rows] > limit[rows][:, None], axis=(0, 2)) for s, limit in zip(stats, of_others, strict=True)]
    of_sensor = np.stack([_quantile(r[None], u, 1 - OF_SENSORS * a)[0] for r, u in zip(ratios, used, strict=True)])
    factor = np.maximum(LEAST_FACTOR, np.nan_to_num(tolerance(of_sensor, SURE, pooled=True), posinf=1.0))
    top = [np.max(np.nan_to_num(r) / factor, axis=1) for r in ratios]
    common = _common([r[u] for r, u in zip(top, used, strict=True)], rate)
    share, begun = np.zeros(blocks), np.zeros(blocks)
    for b, (r, u, stop) in enumerate(zip(top, used, stops, strict=True)):
        of_rest = _common([top[c][used[c]] for c in range(blocks) if c != b], rate.of(1 - 1 / blocks))
        alarm = ((r > of_rest) | stop) & u
        share[b], begun[b] = np.sum(alarm) / max(np.sum(u), 1), len(spans(alarm, JOINED)) / max(np.sum(u), 1)
    unlike = tuple(UnlikeBlock(b, i, float(of_sensor[b, i])) for b, i in np.argwhere(of_sensor > UNLIKE).tolist())
    middle = _median(q, 0)
    wild = []
    for b, k, i in np.argwhere(q > WILD * middle).tolist():
        if tests[k].has_scale:
            wild.append(UnlikeBlock(b, i, float(q[b, k, i] / middle[k, i])))
    n = q.shape[-1]
    full = limits(np.ones(blocks, bool))
    unknown = np.zeros(n, bool), np.ones(n), np.full(n, -1), np.full((len(tests), n), np.nan)
    full[~rows] *= factor * common  # of repeats and gaps twice the longest is wide already
    asked = 0.0 if rate.alarms is None else rate.alarms / (length * blocks)
    return Limits(tests, full, _interval(share, a), _interval(begun, asked), tuple(wild), unlike, *unknown)


def _interval(of_blocks: Array, least: float) -> tuple[float, float, float]:
    """The mean over blocks (B,), and an interval for one to come, whose upper end is not below the least."""
    mean = float(np.mean(of_blocks))
    half = student.ppf(0.9, of_blocks.size - 1) * float(np.std(of_blocks, ddof=1)) * np.sqrt(1 + 1 / of_blocks.size)
    return mean, max(mean - half, 0.0), max(mean + half, least)


def _common(ratios: Sequence[Array], rate: Asked) -> float:
    """The factor of all sensors together, by the largest held-out ratios of rows (K,) of each block."""
    if rate.alarms is None or rate.alarms < 1:
        of_blocks = np.array([np.quantile(r, 1 - rate.rows) for r in ratios])[:, None]
        found = float(tolerance(of_blocks, SURE_OF_ALL, pooled=False)[0])
        return found if rate.alarms is None else max(found, max(float(np.max(r)) for r in ratios))
    top = np.concatenate(ratios)
    place = np.concatenate([np.arange(r.size) + k * JOINED for k, r in enumerate(ratios)])
    place = place + np.repeat(np.cumsum([0, *(r.size for r in ratios[:-1])]), [r.size for r in ratios])
    above: list[int] = []
    peaks = 0
    for row in np.argsort(-top, kind="stable").tolist():
        at = bisect(above, place[row])
        near = (at > 0 and place[row] - above[at - 1] <= JOINED) + (at < len(above) and above[at] - place[row] <= JOINED)
        peaks += 1 - near
        if peaks >= rate.alarms:
            break
        insort(above, int(place[row]))
    return float(top[row])


def _quantile(s: Array, used: Array, p: float) -> Array:
    """Quantile (T, N) of s (T, K, N) over the rows used (K,), NaN where none is known."""
    return _of_known(np.nanquantile, s[:, used], p, axis=1)


def _of_known(what: Any, a: Array, *args: Any, **kwargs: Any) -> Array:
    """A statistic of what is known in a, NaN where nothing is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(what(a, *args, **kwargs))


def _median(a: Array, axis: int) -> Array:
    return _of_known(np.nanmedian, a, axis=axis)


def _worst(s: Array, limit: Array) -> Array:
    """The largest ratio (K, N) of the statistics (T, K, N) to their limits (T, N)."""
    found = np.zeros(s.shape[1:], np.float32)
    for k in range(len(s)):
        np.fmax(found, s[k] / limit[k], out=found)
    return found
