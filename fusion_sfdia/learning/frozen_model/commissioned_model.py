"""From healthy rows to the frozen model: unknowns, what the equations still miss, and limits of means over windows.

1. The unknowns by Gauss and Newton on means over `MEAN_OF` rows of the innovations, whose covariance is what these means have:
   what the equations miss counts as noise. A filter that estimates the unknowns over the log trusts its equations instead, and
   moves them as far as it takes to excuse these.
2. The errors e = v - B phi(x, u): phi = [1], or [1, z] of the standardised states and inputs where blocks of the log that B was
   not learnt from gain by it; by ridge regression on means over `FIT_OF` rows, as the noise of single rows in z biases B.
3. Of each window the covariance of the means of e over blocks that were left out, and the limit of T (`window_means`): of the
   largest T of each block, with B and covariance from other blocks, the bound that that of another one stays below with
   probability `SURE`, from a normal distribution of its logarithm.

The lengths of windows, `RIDGES`, `KAPPAS`, `GAIN`, `STEP` and `LOOSE` were chosen on one simulated air-handling unit, `BEYOND`,
argued as it says, while a heated room with a wrong valve was looked at; the other numbers are our choice.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fusion_sfdia.common.steps import Each, in_silence
from fusion_sfdia.filters.gaussian import half_inverse
from fusion_sfdia.learning.commissioning.parameters import declared
from fusion_sfdia.learning.frozen_model.frozen_filter import FrozenFilter
from fusion_sfdia.learning.frozen_model.window_means import KNOWN, WINDOWS, Spread, enough, explained
from fusion_sfdia.learning.innovations import settling
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.regularity import equal_readings

Array = NDArray[Any]

ROUNDS = 3  # of Gauss and Newton
STEP, FARTHEST = 1.5, 4.0  # prior standard deviations: of a round, and in all
MEAN_OF, FIT_OF = 60, 10  # rows
LEFT_OUT = 4.0  # times the limit of T: a block beyond it is not learnt from
UNSURE = 4.0  # times its usual variance, from which on an innovation is not used
OUTLYING = 5.0  # robust standard deviations of such a logarithm, from which on a block is unlike the others
RIDGES = (0.001, 0.01, 0.1, 1.0)
GAIN = 0.3  # by which the logarithm of the held-out covariance's determinant must fall for each sensor
KAPPAS = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3)
SURE, LEAST_SD = 0.975, 0.2  # quantile of the largest T of another block, and least sd of its logarithm
LOOSE, LOOSE_MEANS = 0.02, 0.01  # of the diagonal of a covariance, added
PRIOR = 2  # windows for each sensor, that the covariance of independent rows counts for
BLOCK, FEWEST, MOST = 500, 4, 16  # rows of a block, and how many
BEYOND = 12.0  # by which deviations may grow a range of the log beyond it: twice as what a straight line misses of a parabola
FOLDS = 8  # neighbouring blocks are left out together: operation changes slowly
STRETCHES, LONG = 16, 960  # that are filtered side by side, and rows of each at least
SETTLED = 1.5  # times the rows in which an error of the first estimate falls to a twentieth
AT_LEAST = 30  # rows after the filter has settled


class Frozen(NamedTuple):
    """What was learnt, of N sensors, n states, m inputs and p unknowns, with q = 1 + n + m regressors.

    values (p,). coef B (N, q); mean, scale (q,) of the regressors; whiten W (q, q), W W' the inverse of their second moment;
    low, high (q,): their range, infinite where no error depends on them.
    cov (W, N, N), kappa (W,), limit (W,) of each window, inf where the log is too short for it. share (N,): of the rows in
    which a sensor has a reading. variance (N,): of its innovation, the median. repeats (N,): the longest run of equal readings.
    settle: rows without a verdict.
    """

    values: Array
    coef: Array
    mean: Array
    scale: Array
    whiten: Array
    low: Array
    high: Array
    cov: Array
    kappa: Array
    limit: Array
    share: Array
    variance: Array
    repeats: Array
    settle: int

    def regressors(self, x: Array, u: Array) -> Array:
        """The regressors phi (..., q) of states x (..., n) and inputs u (..., m)."""
        z = np.concatenate([np.ones((*x.shape[:-1], 1)), x, u], axis=-1)
        return np.asarray((z - self.mean) / self.scale)

    def along_states(self, n: int) -> Array:
        """B dphi / dx (N, n)."""
        return np.asarray(self.coef[:, 1 : 1 + n] / self.scale[1 : 1 + n])

    def growth(self, phi: Array) -> Array:
        """The growth g (W, ...) of the first windows, of their mean regressors phi (W, ..., q) within their range."""
        kappa = self.kappa[: len(phi)].reshape(-1, *(1 for _ in phi.shape[1:-1]))
        return np.asarray(1.0 + kappa * np.sum((phi @ self.whiten) ** 2, axis=-1))


def beyond(phi: Array, low: Array, high: Array) -> Array:
    """The square of 1 + BEYOND times what phi (..., q) is off a range in all, over its width."""
    off = np.maximum(np.maximum(low - phi, phi - high), 0.0) / (high - low)
    return np.asarray((1.0 + BEYOND * np.sum(np.nan_to_num(off), axis=-1)) ** 2)


class Unlike(NamedTuple):
    """Rows of a run, from first to last, in which a window is so many times its limit: they are unlike all others."""

    run: int
    first: int
    last: int
    times: float


class Learnt(NamedTuple):
    """What was learnt, of each row that was left out the largest T of its windows over their limits (R,), and which blocks
    are unlike the others, and did not set the limits.
    """

    frozen: Frozen
    held_out: Array
    unlike: tuple[Unlike, ...]


class Stretches(NamedTuple):
    """Rows of T of each of S stretches, side by side: t (T,), y (T, S, N), u (T, S, m). follows (S,): the one before, or -1."""

    t: Array
    y: Array
    u: Array
    follows: Array


class Pass(NamedTuple):
    """Of a filter over stretches: innovations (T, S, N), predicted states (T, S, n); means over MEAN_OF rows of innovations
    (M, N), and of their derivatives with respect to the unknowns (M, N, p); the last estimates before each row (T, S, a).
    """

    innovation: Array
    variance: Array
    x: Array
    means: Array
    by_unknown: Array
    after: Array


def spread_of(cov: Array) -> Spread:
    """A covariance (N, N) with its inverse root."""
    return Spread(half_inverse(cov, np.ones((len(cov),), bool)), cov)


def commissioned(plant: Plant, log: Log, each: Each = in_silence) -> Learnt:
    """Learn from healthy rows t (K,), y (K, B, N), u (K, B, m) of runs; ValueError where they are too few.

    each: wraps the steps of each pass, with what it is, to show progress.
    """
    _, values, sd = declared(plant)
    begun = FrozenFilter(plant, values, of_sensors=False)
    steps, runs = log.y.shape[:2]
    settle = min(int(np.ceil(SETTLED * settling(begun.model, log))), steps // 3)
    if steps - settle < AT_LEAST or runs * (steps - settle) < 2 * AT_LEAST:
        raise ValueError(
            f"the healthy log has {steps} samples; the filter on plant {plant.name!r} forgets its start within {settle}, and "
            f"after that at least {AT_LEAST} are needed, {2 * AT_LEAST} over all runs: give a longer log"
        )
    parts = stretches(plant, log, settle)
    start, prior = None, values
    passes = 1 + (ROUNDS if values.size else 0)
    for k in range(1, passes):
        rows = each(range(len(parts.t)), f"learning, pass {k} of {passes}")
        found = _filtered(FrozenFilter(plant, values, of_sensors=False), parts, settle, start, rows)
        change = _newton(found, (values - prior) / sd, sd)
        values = prior + sd * np.clip((values - prior) / sd + np.clip(change, -STEP, STEP), -FARTHEST, FARTHEST)
        start = _starts(found, parts, settle)
    rows = each(range(len(parts.t)), f"learning, pass {passes} of {passes}")
    found = _filtered(FrozenFilter(plant, values, of_sensors=False), parts, settle, start, rows)
    variance = np.median(found.variance[settle:], axis=(0, 1))
    sure = np.where(unsure(found.variance, variance), np.nan, found.innovation)
    blocks = _blocks(found._replace(innovation=sure), parts, settle)
    if len(blocks) < 2:
        raise ValueError(f"the healthy log of plant {plant.name!r} has readings in {len(blocks)} part of it; give a longer log")
    return _learnt(parts, blocks, values, variance, settle)


def unsure(now: Array, usual: Array) -> Array:
    """Whether variances (..., N) of innovations are so large that these say little, as after a gap."""
    return np.asarray(now > UNSURE * usual)


def commissioned_without_faults(plant: Plant, log: Log, each: Each = in_silence) -> tuple[Learnt, tuple[Unlike, ...], Log]:
    """The same, again without the blocks that are `LEFT_OUT` times beyond the limits of all others, which follow, and the log
    without them.
    """
    found = commissioned(plant, log, each)
    out = tuple(part for part in found.unlike if part.times > LEFT_OUT)
    if not out:
        return found, (), log
    y = log.y.copy()
    for part in out:
        y[part.first : part.last + 1, part.run] = np.nan
    log = log._replace(y=y)
    return commissioned(plant, log, lambda rows, what: each(rows, f"{what}, without what is unlike the rest")), out, log


def stretches(plant: Plant, log: Log, settle: int) -> Stretches:
    """Cut runs at equal steps into stretches, each of which begins `settle` rows early; others stay whole."""
    steps, runs, _ = log.y.shape
    even = np.allclose(np.diff(log.t), plant.dt, rtol=1e-6, atol=0)
    many = int(np.clip((steps - settle) // max(LONG, 2 * settle), 1, max(STRETCHES // runs, 1))) if even else 1
    if many > 1 and _depends_on_time(plant, log):
        many = 1
    long = (steps - settle) // many
    rows = np.arange(long + settle)[:, None] + long * np.arange(many)
    y, u = (np.moveaxis(a[rows], 2, 1).reshape(len(rows), runs * many, -1) for a in (log.y, log.u))
    follows = np.arange(-1, many - 1) + many * np.arange(runs)[:, None]
    follows[:, 0] = -1
    return Stretches(log.t[: len(rows)], y, u, follows.ravel())


def _depends_on_time(plant: Plant, log: Log) -> bool:
    u, x, last = log.u[0, 0], plant.x0, float(log.t[-1])
    steps = [plant.step(t, x, u, plant.dt) for t in (float(log.t[0]), last / 3, last)]
    outputs = [plant.output(t, x, u) for t in (float(log.t[0]), last / 3, last)]
    return any(not np.array_equal(a, each[0]) for each in (steps, outputs) for a in each)


def _filtered(filter_: FrozenFilter, parts: Stretches, settle: int, start: Array | None, rows: Iterable[int]) -> Pass:
    long, count = parts.y.shape[:2]
    n, (sensors, _, p) = len(filter_.plant.states), filter_.counts
    now = filter_.start((count,))
    if start is not None:
        x = now.core.x.copy()
        x[:, :n] = np.where(np.isfinite(start), start, x[:, :n])
        now = now._replace(core=now.core._replace(x=x))
    innovation, variance, x, after = (np.empty((long, count, k)) for k in (sensors, sensors, n, n))
    each = min(MEAN_OF, long - settle)
    windows = (long - settle) // each
    seen = np.zeros((2, windows, count, sensors))
    by_unknown = np.zeros((windows, count, sensors, p))
    before = float(parts.t[0]) - filter_.plant.dt
    for k in rows:
        t = float(parts.t[k])
        after[k] = now.core.x[:, :n]
        now, row = filter_.step(now, before, t - before, parts.y[k], parts.u[k])
        if row.lost.any():
            raise ValueError(
                f"the filter on plant {filter_.plant.name!r} diverges {t - float(parts.t[0]):g} s after the beginning of the "
                "healthy log; check its inputs and units, and that it starts near the plant's x0"
            )
        innovation[k], variance[k], x[k], before = row.innovation, row.variance, row.x, t
        w = (k - settle) // each
        if 0 <= w < windows:
            known = np.isfinite(row.innovation)
            seen[0, w] += np.where(known, row.innovation, 0.0)
            seen[1, w] += known
            by_unknown[w] += np.where(known[..., None], row.by_cause, 0.0)
    total, known = seen.reshape(2, -1, sensors)
    means = np.where(known > 0, total / np.maximum(known, 1), np.nan)
    return Pass(
        innovation, variance, x, means, by_unknown.reshape(windows * count, sensors, p) / np.maximum(known, 1)[..., None], after
    )


def _newton(found: Pass, moved: Array, sd: Array) -> Array:
    """The change of the unknowns (p,) in prior standard deviations; moved (p,): what they are off their prior."""
    means = np.nan_to_num(found.means)
    cov = _loose(means.T @ means / len(means), LOOSE_MEANS)
    effect = found.by_unknown * sd
    white = np.linalg.solve(cov, effect)  # (M, N, p)
    info = np.einsum("mip,miq->pq", effect, white) + np.eye(sd.size)
    return np.linalg.solve(info, np.einsum("mip,mi->p", white, means) - moved)


def _loose(cov: Array, share: float) -> Array:
    return np.asarray(cov + np.diag(share * np.diag(cov) + np.finfo(float).tiny))


def _starts(found: Pass, parts: Stretches, settle: int) -> Array:
    """Where stretches begin (S, n): the estimate of the one before there, NaN for the first of a run."""
    long = len(parts.t) - settle
    start = np.full(found.after[0].shape, np.nan)
    some = parts.follows >= 0
    if long < len(parts.t):
        start[some] = found.after[long, parts.follows[some]]
    return start


class Block(NamedTuple):
    """Successive rows of a run, from first to last: innovations (R, N) and z = (x, u) (R, n + m)."""

    innovation: Array
    z: Array
    run: int
    first: int
    last: int


def _blocks(found: Pass, parts: Stretches, settle: int) -> list[Block]:
    z = np.concatenate([found.x, parts.u], axis=-1)[settle:]
    v = found.innovation[settle:]
    rows, many = v.shape[:2]
    wanted = int(np.clip(rows * many // BLOCK, FEWEST, MOST))
    each = max(1, min(-(-wanted // many), rows // (AT_LEAST // 2)))
    pieces = [(a, b) for one in np.array_split(np.arange(rows), each) for a, b in [(int(one[0]), int(one[-1]) + 1)]]
    of_run = np.cumsum(parts.follows < 0) - 1
    first = [settle + rows * (s - int(np.argmax(of_run == of_run[s]))) for s in range(many)]
    blocks = [
        Block(v[a:b, s], z[a:b, s], int(of_run[s]), first[s] + a, first[s] + b - 1)
        for s in range(many)
        for a, b in pieces
        if np.isfinite(v[a:b, s]).any(axis=1).mean() >= KNOWN
    ]
    while len(blocks) > 2 * MOST:
        blocks = [_joined(blocks[k : k + 2]) for k in range(0, len(blocks), 2)]
    return blocks


def _joined(blocks: Sequence[Block]) -> Block:
    """Blocks of several runs as one, which has the place of the first."""
    innovation, z = (np.concatenate([b[k] for b in blocks]) for k in range(2))
    return blocks[0]._replace(innovation=innovation, z=z)


def _means(a: Array, w: int) -> tuple[Array, Array]:
    """Means (R - w + 1, k) over w rows of a (R, k), NaN where none is known, and how many are known."""
    known = np.isfinite(a)
    total, count = (np.concatenate([np.zeros((1, a.shape[1])), np.cumsum(np.where(known, x, 0.0), axis=0)]) for x in (a, known))
    total, count = total[w:] - total[:-w], count[w:] - count[:-w]
    return np.where(count > 0.5, total / np.maximum(count, 1.0), np.nan), count


def _learnt(parts: Stretches, blocks: list[Block], values: Array, variance: Array, settle: int) -> Learnt:
    z = np.concatenate([b.z for b in blocks])
    spread = np.std(z, axis=0)
    moving = spread > 1e-9 * np.maximum(np.abs(np.mean(z, axis=0)), 1e-30)
    mean = np.concatenate([[0.0], np.mean(z, axis=0)])
    scale = np.concatenate([[1.0], np.where(moving, spread, np.inf)])
    phis = [(np.column_stack([np.ones(len(b.z)), b.z]) - mean) / scale for b in blocks]
    fits = [_sums(b.innovation, phi) for b, phi in zip(blocks, phis, strict=True)]
    fold = np.arange(len(blocks)) * min(FOLDS, len(blocks)) // len(blocks)
    coefs, coef = _chosen(fits, fold)
    ranges = np.array([[phi.min(axis=0), phi.max(axis=0)] for _, phi in fits])
    bounded = (coef[:, 1:] != 0).any() & (scale < np.inf)
    bounded[0] = False
    low = np.where(bounded, ranges[:, 0].min(axis=0), -np.inf)
    high = np.where(bounded, ranges[:, 1].max(axis=0), np.inf)
    errors = [b.innovation - phi @ c.T for b, phi, c in zip(blocks, phis, coefs, strict=True)]
    moment = sum(phi.T @ phi for phi in phis) / len(z)
    whiten = half_inverse(moment + np.diag(np.r_[0.0, np.full(len(moment) - 1, 1e-3)]), np.ones(len(moment), bool))
    readings = parts.y[settle:]
    share = np.maximum(np.mean(np.isfinite(readings), axis=(0, 1)), 1e-9)
    count, many = variance.size, sum(len(e) for e in errors)
    cov, kappa, limit = np.zeros((len(WINDOWS), count, count)), np.zeros(len(WINDOWS)), np.full(len(WINDOWS), np.inf)
    cov[:] = np.eye(count)
    ratios = [np.zeros(len(e)) for e in errors]
    for i, w in enumerate(WINDOWS):
        if min(len(e) for e in errors) < 1.5 * w:
            continue
        own = [_means(e, w) for e in errors]
        means = [np.where(enough(k, share, w), m, np.nan) for m, k in own]
        moments = [_moment(m) for m in means]
        cov[i] = _shrunk(moments, cov[0], w, many / w)
        phi_means = [_means(phi, w)[0] for phi in phis]
        away = [np.sum((phi @ whiten) ** 2, axis=-1) for phi in phi_means]
        t = [_statistic(spread_of(cov[i]), m) for m in means]
        kappa[i] = _kappa(np.concatenate(t), np.concatenate(away), count)
        held = []
        for b, m in enumerate(means):
            others = _shrunk([x for k, x in enumerate(moments) if fold[k] != fold[b]], cov[0], w, many / w)
            held.append(_statistic(spread_of(others), m) / (1 + kappa[i] * away[b]))
        logs = np.log([max(float(np.max(one)), 1e-9) for one in held])
        logs = logs[~_outlying(logs)]
        sd = max(float(np.std(logs, ddof=1)), LEAST_SD) * np.sqrt(1 + 1 / len(logs))
        limit[i] = np.exp(np.mean(logs) + student.ppf(SURE, len(logs) - 1) * sd)
        for ratio, one in zip(ratios, held, strict=True):
            ratio[w - 1 :] = np.maximum(ratio[w - 1 :], one / limit[i])
    frozen = Frozen(
        values, coef, mean, scale, whiten, low, high, cov, kappa, limit, share, variance, _repeats(readings), settle
    )
    times = [float(np.max(r)) for r in ratios]
    unlike = [Unlike(b.run, b.first, b.last, t) for b, t in zip(blocks, times, strict=True) if t > 1]
    return Learnt(frozen, np.concatenate(ratios), tuple(unlike))


def _outlying(logs: Array) -> Array:
    """Which logarithms (B,) of blocks' largest T are far above the others, at most a quarter: a fault is in there."""
    middle = float(np.median(logs))
    scale = max(1.4826 * float(np.median(np.abs(logs - middle))), LEAST_SD)
    found = logs > middle + OUTLYING * scale
    return found if 4 * np.sum(found) <= len(logs) else np.zeros(len(logs), bool)


def _sums(v: Array, phi: Array) -> tuple[Array, Array]:
    """Means over FIT_OF rows of innovations (M, N), NaN where none is known, and regressors (M, q)."""
    many = len(v) // FIT_OF
    v, phi = (a[: many * FIT_OF].reshape(many, FIT_OF, -1) for a in (v, phi))
    known = np.isfinite(v).sum(axis=1)
    means = np.where(known > 0, np.nansum(v, axis=1) / np.maximum(known, 1), np.nan)
    return means, phi.mean(axis=1)


def _fit(fits: Sequence[tuple[Array, Array]], degree: int, ridge: float) -> Array:
    """B (N, q) by ridge regression, the constant without."""
    count, q = fits[0][0].shape[1], fits[0][1].shape[1]
    use = q if degree else 1
    gram, cross = np.zeros((count, use, use)), np.zeros((count, use))
    for means, phi in fits:
        known, phi = np.isfinite(means), phi[:, :use]
        if known.all():
            gram += phi.T @ phi
        else:
            gram += np.einsum("mi,mj,mn->nij", phi, phi, known.astype(float))
        cross += np.where(known, means, 0.0).T @ phi
    penalty = ridge * np.maximum(gram[:, :1, :1], 1.0) * np.diag(np.r_[0.0, np.ones(use - 1)])
    found = np.zeros((count, q))
    found[:, :use] = np.linalg.solve(gram + penalty + 1e-12 * np.eye(use), cross[..., None])[..., 0]
    return found


def _chosen(fits: Sequence[tuple[Array, Array]], fold: Array) -> tuple[list[Array], Array]:
    """The regression of the least held-out errors: B for each block from the others, and from all."""

    def left_out(degree: int, ridge: float) -> list[Array]:
        each = [_fit([f for f, k in zip(fits, fold, strict=True) if k != out], degree, ridge) for out in range(fold[-1] + 1)]
        return [each[k] for k in fold]

    best, least = (0, 0.0), np.inf
    for degree, ridges in ((0, (0.0,)), (1, RIDGES)):
        for ridge in ridges:
            held = zip(fits, left_out(degree, ridge), strict=True)
            errors = np.concatenate([np.nan_to_num(m - phi @ c.T) for (m, phi), c in held])
            cov = _loose(errors.T @ errors / len(errors), 1e-9)
            found = float(np.linalg.slogdet(cov)[1]) + (GAIN * len(cov) if degree else 0.0)
            if found < least:
                best, least = (degree, ridge), found
    return left_out(*best), _fit(fits, *best)


def _moment(means: Array) -> tuple[Array, Array]:
    """Sums of the products of known means (N, N), and how many."""
    known = np.isfinite(means)
    values = np.where(known, means, 0.0)
    k = known.astype(float)
    return values.T @ values, k.T @ k


def _shrunk(moments: Sequence[tuple[Array, Array]], single: Array, w: int, windows: float) -> Array:
    """The covariance of means over w rows, shrunk towards that of independent rows, as few windows are in the log."""
    square, many = (np.sum(one, axis=0) for one in zip(*moments, strict=True))
    cov = square / np.maximum(many, 1.0)
    count = len(cov)
    unseen = np.diag(many) < 1
    cov[unseen] = cov[:, unseen] = 0.0
    if w > 1:
        cov = (windows * cov + PRIOR * count * single / w) / (windows + PRIOR * count)
    scale = np.sqrt(np.maximum(np.diag(cov), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(cov / np.outer(scale, scale))  # of correlations, whatever the units
    cov = (vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(scale, scale)
    return np.asarray(_loose(cov, LOOSE) + np.diag(np.where(unseen, 1e30, 0.0)))


def _statistic(spread: Spread, means: Array) -> Array:
    """The statistic m' S^-1 m (R,) of means (R, N), of the readings that are known."""
    known = np.isfinite(means)
    whole = known.all(axis=1)
    found = np.zeros(len(means))
    found[whole] = np.sum((means[whole] @ spread.half) ** 2, axis=-1)
    if not whole.all():
        some = ~whole
        none = np.zeros((int(some.sum()), means.shape[1], 0))
        found[some] = explained(spread, means[some], known[some], none, np.ones(int(some.sum())))[0]
    return found


def _kappa(t: Array, away: Array, count: int) -> float:
    """The growth of greatest likelihood, of statistics T (R,) at squared distances (R,)."""
    g = 1 + np.array(KAPPAS)[:, None] * away
    return KAPPAS[int(np.argmin(np.mean(count * np.log(g) + t / g, axis=1)))]


def _repeats(y: Array) -> Array:
    """The longest run of rows (N,) in which a reading of y (T, S, N) is as the one before; missing ones do not count."""
    columns = y.reshape(len(y), -1).T
    longest = [int(np.max(equal_readings(column)[2], initial=1)) - 1 for column in columns]
    return np.asarray(np.max(np.reshape(longest, y.shape[1:]), axis=0), dtype=float)
