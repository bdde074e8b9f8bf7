"""What is tested of every sensor at every row: errors given all other channels over windows of 1 to 1 024 rows, noise, spikes,
repeated and missing readings; and whether operation is as it was learnt.

All statistics are causal, and of one row the same wherever a log is cut. Those of a window of w rows are at scale w.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.monitor.channels import BEFORE, Channels, Read, firsts, read
from fusion_sfdia.learning.monitor.windows import (
    Errors,
    WindowSums,
    completed,
    earlier,
    errors,
    filled,
    precision_of,
    window_largest,
    window_means,
    window_sums,
    with_lag,
)

Array = NDArray[Any]

SCALES = (1, 4, 16, 64, 256, 1024)  # rows
NOISE = (16, 64)  # rows over which the size of noise is judged
NOISE_CLIP = 1.5  # limits of one reading, up to which its error counts as noise
LEADING = 0.05  # of the mean eigenvalue: smaller directions of the readings are noise to novelty
RARE = 0.998  # quantile of the leading scores in learning
NOVEL = 1.5  # of that quantile: beyond it operation is outside what was learnt
AT_ONCE = 2048  # rows: of more, the errors are computed in parts
SPIKE = 3  # rows before a row, by which a spike is known
LATE = 16  # rows: a level over at least as many needs half of its size from the last quarter of its window


class Test(NamedTuple):
    """A test of each sensor: kind (level, change, same, noise, spike, repeats, missing) and scale in rows."""

    kind: str
    scale: int

    @property
    def has_scale(self) -> bool:
        """Whether it is of windows, and graded: not a count of rows."""
        return self.kind in ("level", "change", "same", "noise")

    def __str__(self) -> str:
        return f"{self.kind} over {self.scale} rows" if self.has_scale else self.kind


class Means(NamedTuple):
    """Of one scale: means of windows (K, n), of their last quarters where they count, and of the windows before."""

    now: Array
    quarter: Array | None
    before: Array

    def at(self, rows: Array | slice) -> Means:
        """At these rows."""
        return Means(self.now[rows], None if self.quarter is None else self.quarter[rows], self.before[rows])

    def less(self, centre: Array) -> Means:
        """About a centre, (n,) or of each row (K, n)."""
        return Means(self.now - centre, None if self.quarter is None else self.quarter - centre, self.before - centre)

    def without(self, channel: int) -> Means:
        """Without the readings of a channel."""
        quarter = None if self.quarter is None else blank(self.quarter, channel)
        return Means(blank(self.now, channel), quarter, blank(self.before, channel))


def blank(a: Array, channel: int) -> Array:
    """What a (K, n) is without the readings of a channel."""
    a = a.copy()
    a[:, channel] = np.nan
    return a


class Scale(NamedTuple):
    """Of one length of window: the ridge, its inverse covariance of x (2 n, 2 n), and its leading directions.

    centre (n,): of the means. level (n, n): inverse covariance of the means alone. lead (n, k): directions over their standard
    deviations. limit: of the root mean square of the leading scores.
    """

    w: int
    ridge: float
    centre: Array
    precision: Array
    level: Array
    lead: Array
    limit: float


Model = tuple[Scale, ...]


class ScaledRows(NamedTuple):
    """Scaled readings of a piece, z (K, n), with what needs no model: repeats, missing (K, N) in rows, spikes (K, N), and jumps
    (K, n), NaN where there is no reading in the `SPIKE` rows before.
    """

    z: Array
    repeats: Array
    missing: Array
    spikes: Array
    jumps: Array


class Ahead(NamedTuple):
    """What of the rows ahead of a piece belongs to its rows: what was read, the last three scaled readings (3, n), and the last
    readings of all columns (`BEFORE` + 2, n).
    """

    read: Read
    z: Array
    v: Array

    @classmethod
    def none(cls, channels: Channels) -> Ahead:
        """At the beginning."""
        columns = channels.hold.size
        return cls(Read.none(columns), np.full((SPIKE, len(channels.used)), np.nan), np.full((BEFORE + 2, columns), np.nan))


def rows_of(channels: Channels, v: Array, ahead: Ahead | None = None) -> tuple[ScaledRows, Ahead]:
    """The rows of readings v (K, n) of all columns, scaled, with what needs no model; and what is ahead of the next ones."""
    ahead, n = ahead or Ahead.none(channels), channels.count
    own, every = channels.used[:n], read(v, ahead.read)
    z = channels.scaled(every.held(channels.hold))
    with_last = np.concatenate([ahead.z, z])
    all_v = np.concatenate([ahead.v, v])
    if np.isfinite(channels.far).any():
        z = np.where(firsts(all_v, channels.far)[BEFORE + 2 :, channels.used], np.nan, z)
    jumps = jumps_of(with_last)[SPIKE:]
    rows = ScaledRows(z, every.equal[:, own], every.age[:, own], spikes(with_last[:, :n])[SPIKE:], jumps)
    return rows, Ahead(Read(*(a[-1] for a in every)), with_last[-SPIKE:], all_v[-BEFORE - 2 :])


def jumps_of(z: Array) -> Array:
    """Each row of z (K, n) less the last reading in the `SPIKE` rows before."""
    last = earlier(z, 1, np.nan)
    for k in range(2, SPIKE + 1):
        last = np.where(np.isfinite(last), last, earlier(z, k, np.nan))
    return np.asarray(z - last)


def spikes(z: Array) -> Array:
    """By how much the reading before each row of z (K, N), or the mean of the two before, was off both its neighbours.

    To the same side, the nearer of them counted; the sign is that of the spike.
    """
    one = _off(earlier(z, 1, np.nan), earlier(z, 2, np.nan), z)
    two = _off((earlier(z, 1, np.nan) + earlier(z, 2, np.nan)) / 2, earlier(z, 3, np.nan), z)
    return np.where(np.abs(one) >= np.abs(two), one, two)


def _off(middle: Array, before: Array, after: Array) -> Array:
    a, b = middle - before, middle - after
    with np.errstate(invalid="ignore"):
        return np.where(a * b > 0, np.sign(a) * np.minimum(np.abs(a), np.abs(b)), 0.0)


def learn_scale(w: int, moments: WindowSums, ridge: float, centred: bool, means: Array) -> Scale:
    """The scale of these moments of x; means (K, n): of windows in learning, for the limit of novelty."""
    covariance = moments.covariance(centred)
    n = len(covariance) // 2
    centre = moments.mean[:n] if centred else np.zeros(n)
    values, vectors = np.linalg.eigh(covariance[:n, :n])
    kept = values > LEADING * np.mean(values)
    lead = vectors[:, kept] / np.sqrt(values[kept] + ridge)
    level = precision_of(covariance[:n, :n], ridge)
    found = Scale(w, ridge, centre, precision_of(covariance, ridge), level, lead, np.inf)
    scores = novelty(found, means)
    scores = scores[np.isfinite(scores)]
    return found._replace(limit=NOVEL * float(np.quantile(scores, RARE)) if scores.size else np.inf)


def novelty(scale: Scale, means: Array) -> Array:
    """Root mean square (K,) of the leading scores of means of windows (K, n), NaN where fewer than half are known."""
    known = np.isfinite(means).mean(axis=1) >= 0.5
    found = np.full(len(means), np.nan)
    if known.any() and scale.lead.shape[1]:
        scores = completed(scale.level, means[known] - scale.centre) @ scale.lead
        found[known] = np.sqrt(np.mean(scores**2, axis=1))
    return found


def level_errors(scale: Scale, means: Means, count: int) -> Errors:
    """Errors (K, N) of the means of windows with those of the windows before.

    A level over at least `LATE` rows counts as at most twice what the last quarter of its window shows.
    """
    if len(means.now) > AT_ONCE:
        parts = [level_errors(scale, means.at(slice(k, k + AT_ONCE)), count) for k in range(0, len(means.now), AT_ONCE)]
        return Errors(*(np.concatenate(one) for one in zip(*parts, strict=True)))
    now, quarter, before = means.less(scale.centre)
    found = errors(scale.precision, np.concatenate([now, before], axis=1), count)
    if quarter is None or scale.w < LATE:
        return found
    late = errors(scale.precision, np.concatenate([quarter, before], axis=1), count).level
    with np.errstate(invalid="ignore"):
        agree = np.where(found.level * late > 0, np.minimum(np.abs(found.level), 2 * np.abs(late)), 0.0)
    level = np.where(np.isfinite(late), np.sign(found.level) * agree, found.level)
    return found._replace(level=level)


def noise(change: Array, w: int, most: Array | float = np.inf) -> Array:
    """Root mean square (K, N) over the last w rows of the errors of single readings (K, N), each up to `most` (N,).

    The largest is left out: a step or a spike is no noise.
    """
    known = np.isfinite(change)
    squares = np.where(known, np.minimum(np.abs(np.where(known, change, 0.0)), most), 0.0) ** 2
    count = window_sums(known.astype(float), w)
    with np.errstate(invalid="ignore", divide="ignore"):
        rest = np.maximum(window_sums(squares, w) - window_largest(squares, w), 0.0) / (count - 1)
        return np.where(count >= w / 2, np.sqrt(rest), np.nan)


def tests_of(scales: Sequence[int], longest: int, slow: Sequence[str] = ("level", "change")) -> tuple[Test, ...]:
    """The tests at these scales, those of means `slow`; noise where `longest` rows allow it."""
    kinds = [Test(kind, w) for w in scales for kind in slow]
    lasting = Test("spike", 1), Test("repeats", 1), Test("missing", 1)
    return (*kinds, *(Test("noise", w) for w in NOISE if w <= longest), *lasting)


def stacked(z: Array, scales: Sequence[int]) -> dict[int, Means]:
    """The means of windows of z (K, n) at these scales."""
    means = {w: window_means(z, w) for w in SCALES if w <= max(scales)}
    return {w: Means(means[w], means[w // 4] if w >= LATE else None, earlier(means[w], w, np.nan)) for w in scales}


def moments_of(z: Array, w: int, ridge: float) -> tuple[Array, Array]:
    """Means x (R, 2 n) at every w/4-th row, what is missing completed, and which rows these are."""
    every = np.arange(0, len(z), max(w // 4, 1))
    x = with_lag(window_means(z, w), w)[every]
    return filled(x, ridge), every


def settled(w: int) -> tuple[int, int]:
    """The rows of an operation whose mean is the reference of the scale w: from the first to before the second."""
    v = max(w, 16)
    return 2 * v, 6 * v


def about_reference(means: dict[int, Means], starts: Sequence[int], scales: Sequence[int]) -> dict[int, Means]:
    """Means about those of the beginning of each operation, which start at these rows; NaN until these are known."""
    found = {}
    for w in scales:
        now = means[w].now
        reference = np.full(now.shape, np.nan)
        for start, end in zip(starts, [*starts[1:], len(now)], strict=True):
            first, last = (start + k for k in settled(w))
            if last <= end:
                known = np.isfinite(now[first:last])
                count = known.sum(axis=0)
                total = np.where(known, now[first:last], 0.0).sum(axis=0)
                reference[last:end] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        found[w] = means[w].less(reference)
    return found
