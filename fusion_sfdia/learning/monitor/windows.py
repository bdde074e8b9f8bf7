"""Means of readings over windows of several lengths, and errors of readings given all others, by one covariance a length.

Of the means zbar_w(t) over the last w rows, x = [zbar_w(t), zbar_w(t - w)] has a covariance C over healthy rows. With
K = C^-1 and r = K x, the errors of all n channels given all others follow at once (leave-one-out residuals of a Gaussian
vector; Dempster 1972, Covariance selection): with j the same channel one window earlier,

    change: e1_i = r_i / K_ii,                                variance 1 / K_ii      (its own past is used)
    level:  e0_i = (K_jj r_i - K_ij r_j) / D,                 variance K_jj / D      (its own past is not used)

D = K_ii K_jj - K_ij^2. Where entries M are missing, or are to be left out, K becomes K - K_:M K_MM^-1 K_M:, and r the same with
x_M = -K_MM^-1 (K x)_M, their conditional mean.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

KNOWN = 0.5  # least share of the rows of a window that have readings
ROUNDS = 2  # of conditional means in place of missing entries


class Errors(NamedTuple):
    """Errors of readings given all others (K, N), NaN where missing, in units of x.

    Where other readings are missing they are larger: they stand here in proportion to their standard deviation as if none was.
    wider (K, N): by which factor the deviation of a level is larger.
    """

    change: Array
    level: Array
    wider: Array


def window_sums(a: Array, w: int) -> Array:
    """Sums over the last w rows, a power of 4, of a (K, n); rows before the first count as 0.

    Sums of 4 w rows are of four sums of w, so that their bits do not depend on where a log is cut.
    """
    step = 1
    while step < w:
        a = sum((earlier(a, k * step) for k in (1, 2, 3)), start=a)
        step *= 4
    return a


def window_largest(a: Array, w: int) -> Array:
    """The largest over the last w rows, a power of 4, of a (K, n) >= 0."""
    step = 1
    while step < w:
        a = np.maximum.reduce([a, *(earlier(a, k * step) for k in (1, 2, 3))])
        step *= 4
    return a


def earlier(a: Array, rows: int, fill: float = 0.0) -> Array:
    """What a (K, n) was so many rows earlier."""
    found = np.full_like(a, fill)
    if rows < len(a):
        found[rows:] = a[: len(a) - rows]
    return found


def window_means(z: Array, w: int) -> Array:
    """Means over the last w rows of z (K, n), NaN where fewer than half of them have a reading, and in the first w - 1 rows."""
    if w == 1:
        return z
    known = np.isfinite(z)
    count = window_sums(known.astype(float), w)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.where(count >= KNOWN * w, window_sums(np.where(known, z, 0.0), w) / count, np.nan)
    found[: w - 1] = np.nan
    return found


def with_lag(means: Array, w: int) -> Array:
    """Means of a window and those of the window before, x (K, 2 n)."""
    return np.concatenate([means, earlier(means, w, np.nan)], axis=1)


def patterns(missing: Array) -> Iterator[tuple[Array, Array]]:
    """The sets of entries that are missing (K, q): rows of each, and its entries; none missing is left out."""
    some = np.flatnonzero(missing.any(axis=1))
    if not some.size:
        return
    packed = np.packbits(missing[some], axis=1)
    _, first, which = np.unique(packed, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(which.ravel()[order])) + 1)
    for at, rows in zip(first, parts, strict=True):
        yield some[rows], np.flatnonzero(missing[some[at]])


def completed(precision: Array, x: Array) -> Array:
    """Rows x (K, q) with the conditional means of what is missing."""
    missing = ~np.isfinite(x)
    x = np.where(missing, 0.0, x)
    for rows, m in patterns(missing):
        x[np.ix_(rows, m)] = -np.linalg.solve(precision[np.ix_(m, m)], precision[m] @ x[rows].T).T
    return x


def errors(precision: Array, x: Array, count: int) -> Errors:
    """The errors of the first `count` channels of x (K, 2 n), NaN where missing."""
    n = len(precision) // 2
    missing = ~np.isfinite(x)
    r = np.where(missing, 0.0, x) @ precision
    i, j = np.arange(count), n + np.arange(count)
    ii, jj, ij = (np.tile(precision[a, b], (len(x), 1)) for a, b in ((i, i), (j, j), (i, j)))
    for rows, m in patterns(missing):
        g = np.linalg.solve(precision[np.ix_(m, m)], precision[m])
        r[rows] -= r[np.ix_(rows, m)] @ g
        for of, (a, b) in zip((ii, jj, ij), ((i, i), (j, j), (i, j)), strict=True):
            of[rows] -= np.sum(precision[np.ix_(m, a)] * g[:, b], axis=0)
    k_ii, k_jj, k_ij = precision[i, i], precision[j, j], precision[i, j]
    whole = np.sqrt(1 / k_ii), np.sqrt(k_jj / (k_ii * k_jj - k_ij**2))  # deviations where nothing is missing
    ri, rj, past = r[:, i], r[:, j], ~missing[:, j]
    with np.errstate(invalid="ignore", divide="ignore"):
        own = np.where(past, jj, 1.0)
        d = np.where(past, ii * jj - ij**2, ii)
        change = np.where(missing[:, i], np.nan, ri / np.sqrt(ii))
        level = np.where(missing[:, i], np.nan, (own * ri - np.where(past, ij * rj, 0.0)) / np.sqrt(d * own))
        return Errors(change * whole[0], level * whole[1], np.sqrt(own / d) / whole[1])


class WindowSums(NamedTuple):
    """Of rows of x (K, q): how many, their total (q,) and the sum of their squares (q, q)."""

    rows: float
    total: Array
    square: Array

    @classmethod
    def of(cls, x: Array) -> WindowSums:
        return cls(float(len(x)), np.sum(x, axis=0), x.T @ x)

    @classmethod
    def together(cls, parts: Sequence[WindowSums]) -> WindowSums:
        """Of the rows of all parts."""
        first, *others = parts
        for m in others:
            first = cls(first.rows + m.rows, first.total + m.total, first.square + m.square)
        return first

    def covariance(self, centred: bool = False) -> Array:
        """About 0, or about their mean."""
        found = self.square / max(self.rows, 1.0)
        return np.asarray(found - np.outer(self.mean, self.mean) if centred else found)

    @property
    def mean(self) -> Array:
        """The mean (q,)."""
        return self.total / max(self.rows, 1.0)


def precision_of(covariance: Array, ridge: float) -> Array:
    """(C + ridge I)^-1."""
    return np.asarray(np.linalg.inv(covariance + ridge * np.eye(len(covariance))))


def filled(x: Array, ridge: float) -> Array:
    """Rows of x without a missing entry where at least half of them are such, else all, with conditional means."""
    whole = np.asarray(np.isfinite(x).all(axis=1))
    if np.mean(whole) >= KNOWN:
        return np.where(whole[:, None], x, np.nan)
    some = np.isfinite(x).mean(axis=1) >= KNOWN
    x = np.where(some[:, None], x, np.nan)
    full = np.where(np.isfinite(x), x, 0.0)
    for _ in range(ROUNDS):
        full[some] = completed(precision_of(WindowSums.of(full[some]).covariance(), ridge), x[some])
    return np.where(some[:, None], full, np.nan)
