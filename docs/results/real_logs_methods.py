"""What is compared on the page real-logs.md: the monitor, and the usual ways to watch a plant without a model.

A baseline is fitted to the healthy rows without one of BLOCKS consecutive blocks of them and judges that block, in turn for
each. The limits are order statistics of what it finds there, so that the stated share of those rows is in alarm; its own
settings are those with the smallest errors there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from real_logs_scores import Found
from scipy.stats import skew

from fusion_sfdia import Log, Monitor, Sensor, linear_plant, run
from fusion_sfdia.common.order_statistics import order_statistic
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.silent import silent, silent_scores
from fusion_sfdia.learning.monitor.causes import OK, OUTSIDE

if TYPE_CHECKING:
    from real_logs_data import Recorded

Array = NDArray[Any]

BLOCKS = 8
LACKING, COMPLETE = 0.7, 0.3  # share of readings that a column may lack; and where only complete rows are learnt
SKEWED = 2.0  # as for the monitor: a column as skewed whose logarithm is half as skewed is taken as that
WEIGHT = 0.2  # of the present residual in its moving average
RIDGES, LAGS = (1e-3, 1e-2, 1e-1), (1, 2, 3)
HELD = 4  # rows for which a predictor takes the last reading for a missing one
NEEDED = 8  # healthy rows over the inverse of the rate to which a library detector is fitted, before its limits are scaled
FEWEST_EQUAL = 8  # readings, from which on a sensor that repeats one may be stuck


Judge = Callable[[Sequence[Log]], list[Found]]
Learn = Callable[["Recorded", float], Judge]
Statistics = Callable[[Array], Array]  # of scaled readings (K, q): one or more charts of each column (K, c, q), NaN for none
Fit = Callable[[Sequence[Array]], Statistics]


def monitor(recorded: Recorded, rate: float) -> Judge:
    """`Monitor`, as it is; "outside what was learnt" is no alarm."""
    learnt = Monitor.of_logs(recorded.sensors, recorded.healthy, inputs=recorded.inputs, false_alarm=rate)
    count, used = len(recorded.sensors), learnt.channels.used[: learnt.channels.count]

    def judge(logs: Sequence[Log]) -> list[Found]:
        found = []
        for log in logs:
            (piece,) = learnt.judge(log)
            named = np.zeros((len(log.t), count), bool)
            named[:, used] = piece.causes.named[:, : len(used)]
            found.append(Found(piece.causes.alarm, named, piece.causes.kind == OUTSIDE))
            assert np.all((piece.causes.kind != OK) == (found[-1].alarm | found[-1].outside))
        return found

    judge.learnt = learnt  # type: ignore[attr-defined]
    return judge


@dataclass(frozen=True, eq=False)
class Scale:
    """Which columns (q,) of sensors and inputs are used, in standard deviations, with logarithms where floor is a number."""

    used: Array
    floor: Array
    mean: Array
    sd: Array

    @classmethod
    def of(cls, v: Array, lacking: float) -> Scale:
        """Learnt from healthy readings v (K, n): columns that move and lack at most this share."""
        used = np.flatnonzero((np.mean(np.isnan(v), axis=0) <= lacking) & (np.nanmax(v, axis=0) > np.nanmin(v, axis=0)))
        floor = np.array([_floor(v[:, i]) for i in used])
        z = cls(used, floor, np.zeros(len(used)), np.ones(len(used))).scaled(v)
        return cls(used, floor, np.nanmean(z, axis=0), np.nanstd(z, axis=0))

    def scaled(self, v: Array) -> Array:
        """Readings (K, n) of all columns as z (K, q)."""
        z = v[:, self.used].copy()
        logs = np.isfinite(self.floor)
        z[:, logs] = np.log(np.maximum(z[:, logs], self.floor[logs]))
        return np.asarray((z - self.mean) / self.sd)


def _floor(v: Array) -> float:
    known = v[np.isfinite(v)]
    if known.min() < 0 or abs(before := skew(known)) <= SKEWED:
        return np.nan
    floor = 0.5 * float(np.quantile(known[known > 0], 0.01))
    return floor if abs(skew(np.log(np.maximum(known, floor)))) <= abs(before) / 2 else np.nan


def columns(log: Log) -> Array:
    """Sensors and inputs side by side (K, N + m)."""
    return np.hstack([log.y, log.u])


def blocks_of(logs: Sequence[Log], scale: Scale) -> list[list[Array]]:
    """The scaled rows of healthy logs in BLOCKS consecutive blocks, each in runs without gaps."""
    z = scale.scaled(np.concatenate([columns(log) for log in logs]))
    run_of = np.cumsum(np.concatenate([[1, *(np.diff(log.t) > 1.5 * (log.t[1] - log.t[0]))] for log in logs]))
    return [
        [z[list(rows)] for _, rows in groupby(part.tolist(), key=lambda k: run_of[k])]
        for part in np.array_split(np.arange(len(z)), BLOCKS)
    ]


def without(blocks: Sequence[Sequence[Array]], b: int) -> list[Array]:
    """The runs of all blocks but one."""
    return [z for c, block in enumerate(blocks) if c != b for z in block]


def by_statistics(*candidates: Callable[[int, Recorded, Scale], Fit], names: bool = True) -> Learn:
    """A baseline that watches statistics of each column, and names the sensor of the largest; candidates: of its settings."""

    def learn(recorded: Recorded, rate: float) -> Judge:
        count = len(recorded.sensors)
        scale = Scale.of(np.concatenate([columns(log) for log in recorded.healthy]), LACKING)
        own = int(np.sum(scale.used < count))
        blocks = blocks_of(recorded.healthy, scale)
        tried = []
        for candidate in candidates:
            fit = candidate(own, recorded, scale)
            found = np.concatenate([judge(z) for b in range(BLOCKS) for judge in [fit(without(blocks, b))] for z in blocks[b]])
            watched = ~np.all(np.isnan(found[:, 0]), axis=0)
            tried.append((np.mean(np.log(np.nanmean(found[:, 0, watched] ** 2, axis=0))), fit, found))
        _, fit, found = min(tried, key=lambda one: one[0])
        unit = np.array([[_quantile(found[:, c, i], rate) for i in range(found.shape[2])] for c in range(found.shape[1])])
        limit = float(order_statistic(_ratio(found, unit).max(axis=1), rate))
        statistics = fit([z for block in blocks for z in block])

        def judge(logs: Sequence[Log]) -> list[Found]:
            answers = []
            for log in logs:
                ratio = _ratio(statistics(scale.scaled(columns(log))), unit) / limit
                alarm, largest = ratio.max(axis=1) > 1, np.argmax(ratio, axis=1)
                named = np.zeros((len(alarm), count), bool)
                rows = np.flatnonzero(alarm & (largest < own)) if names else []
                named[rows, scale.used[largest[rows]]] = True
                answers.append(Found(alarm, named, np.zeros(len(alarm), bool)))
            return answers

        return judge

    return learn


def _quantile(values: Array, rate: float) -> float:
    known = values[np.isfinite(values)]
    return max(float(order_statistic(known, rate)), 1e-9) if known.size else np.inf


def _ratio(found: Array, unit: Array) -> Array:
    """The largest chart of each column over its unit (K, q)."""
    return np.asarray(np.nan_to_num(found / unit).max(axis=1))


def charts(e: Array) -> Array:
    """Residuals (K, q) as a Shewhart and an EWMA chart (K, 2, q): |e|, and the modulus of its moving average."""
    average, averages = np.zeros(e.shape[1]), np.empty_like(e)
    for k, now in enumerate(e):
        average = np.where(np.isfinite(now), (1 - WEIGHT) * average + WEIGHT * now, average)
        averages[k] = average
    return np.abs(np.stack([e, np.where(np.isfinite(e), averages, np.nan)], axis=1))


def ridge_on_others(ridge: float) -> Callable[[int, Recorded, Scale], Fit]:
    """Each sensor less its ridge regression on all other columns of the row, those that are missing left out."""

    def of(own: int, recorded: Recorded, scale: Scale) -> Fit:
        def fit(runs: Sequence[Array]) -> Statistics:
            z = np.concatenate(runs)
            x = np.nan_to_num(z)
            for _ in range(3):  # missing readings as expected from the others
                cov = x.T @ x / len(x) + ridge * np.eye(x.shape[1])
                x = _conditional(cov, z)[0]

            def statistics(z: Array) -> Array:
                e = _conditional(cov, z)[1]
                e[:, own:] = np.nan
                return charts(e)

            return statistics

        return fit

    return of


def _conditional(cov: Array, z: Array) -> tuple[Array, Array]:
    """Readings z (K, q) with the expected values of missing ones, and each less what all others of its row expect."""
    filled, error = np.nan_to_num(z), np.full(z.shape, np.nan)
    patterns, which = np.unique(np.isfinite(z), axis=0, return_inverse=True)
    for k, known in enumerate(patterns):
        rows = which.ravel() == k
        if known.any():
            precision = np.linalg.inv(cov[np.ix_(known, known)])
            weighted = z[np.ix_(rows, known)] @ precision
            error[np.ix_(rows, known)] = weighted / np.diag(precision)
            filled[np.ix_(rows, ~known)] = weighted @ cov[np.ix_(known, ~known)]
    return filled, error


def median_of_others(own: int, recorded: Recorded, scale: Scale) -> Fit:
    """Each sensor less the median of the others that measure alike, where at least two do."""
    place = {int(column): i for i, column in enumerate(scale.used)}
    groups = [[place[i] for i in group if i in place] for group in recorded.groups]

    def statistics(z: Array) -> Array:
        e = np.full(z.shape, np.nan)
        for group in groups:
            for i in group:
                others = z[:, [j for j in group if j != i]]
                enough = np.sum(np.isfinite(others), axis=1) >= 2
                e[enough, i] = z[enough, i] - np.nanmedian(others[enough], axis=1)
        return charts(e)

    return lambda runs: statistics


def vector_autoregression(lags: int, ridge: float) -> Callable[[int, Recorded, Scale], Fit]:
    """Each sensor less its one-step prediction from all columns of the last rows, and from the inputs of its own."""

    def of(own: int, recorded: Recorded, scale: Scale) -> Fit:
        def regressors(z: Array) -> Array:
            x = _held(z)
            past = [x[lags - k : len(x) - k] for k in range(1, lags + 1)]
            return np.hstack([*past, x[lags:, own:], np.ones((len(x) - lags, 1))])

        def fit(runs: Sequence[Array]) -> Statistics:
            some = [z for z in runs if len(z) > lags]
            x, y = np.concatenate([regressors(z) for z in some]), np.concatenate([z[lags:, :own] for z in some])
            weights = np.zeros((x.shape[1], own))
            penalty = ridge * np.eye(x.shape[1])
            patterns, which = np.unique(np.isfinite(y), axis=1, return_inverse=True)
            for k, rows in enumerate(patterns.T):  # sensors that miss the same readings are fitted together
                same, a = np.flatnonzero(which.ravel() == k), x[rows]
                weights[:, same] = np.linalg.solve(a.T @ a / len(a) + penalty, a.T @ y[np.ix_(rows, same)] / len(a))

            def statistics(z: Array) -> Array:
                e = np.full(z.shape, np.nan)
                if len(z) > lags:
                    e[lags:, :own] = z[lags:, :own] - regressors(z) @ weights
                return charts(e)

            return statistics

        return fit

    return of


def _held(z: Array) -> Array:
    """Readings with the last one in place of missing ones for HELD rows, after that the mean, 0."""
    rows = np.arange(len(z))[:, None]
    last = np.maximum.accumulate(np.where(np.isfinite(z), rows, -1), axis=0)
    kept = np.take_along_axis(z, np.maximum(last, 0), axis=0)
    return np.nan_to_num(np.where((last >= 0) & (rows - last <= HELD), kept, 0.0))


def isolation_forest(own: int, recorded: Recorded, scale: Scale) -> Fit:
    """scikit-learn's isolation forest on readings and their changes, missing ones at their mean; names no sensor."""
    from sklearn.ensemble import IsolationForest  # slow to import

    def features(z: Array) -> Array:
        x = np.nan_to_num(z)
        return np.hstack([x, np.diff(x, axis=0, prepend=x[:1])])

    def fit(runs: Sequence[Array]) -> Statistics:
        forest = IsolationForest(n_estimators=200, random_state=0).fit(np.concatenate([features(z) for z in runs]))
        return lambda z: -forest.score_samples(features(z))[:, None, None]

    return fit


def by_detector(name: str, lacking: float, inputs: bool, stuck: bool = False) -> Learn:
    """A detector of the library on the scaled columns, its limits scaled to the rate; stuck: with a test of repetitions."""

    def learn(recorded: Recorded, rate: float) -> Judge:
        count = len(recorded.sensors)
        healthy = np.concatenate([columns(log) for log in recorded.healthy])
        scale = Scale.of(healthy if inputs else healthy[:, :count], lacking)
        q, own = len(scale.used), int(np.sum(scale.used < count))
        blocks = blocks_of(recorded.healthy, scale)
        noise = _noise([z for block in blocks for z in block])
        sensors = [Sensor(f"z{i}", f"z{i}", "1", sigma=sd) for i, sd in zip(scale.used, noise.tolist(), strict=True)]
        plant = linear_plant(
            recorded.name, np.eye(1), np.zeros((q, 1)), sensors,
            dt=recorded.dt, x0=np.zeros(1), initial_cov=np.ones(1), process_cov=np.ones(1),
        )  # fmt: skip
        build = registry.find_detector(name).build

        def fitted(runs: Sequence[Array]) -> Any:
            rows = sum(map(len, runs))
            between = np.concatenate([np.pad(z, ((0, 1), (0, 0)), constant_values=np.nan) for z in runs])
            return build(plant, healthy=between, false_alarm=max(rate, NEEDED / rows))

        scores = []
        for b, block in enumerate(blocks):
            detector = silent(fitted(without(blocks, b)))
            scores += [silent_scores(detector, plant.dt * np.arange(len(z)), z, np.zeros((len(z), 0)))[1] for z in block]
        whole = fitted([z for block in blocks for z in block])
        detector = replace(whole, threshold_scale=float(order_statistic(np.nan_to_num(np.concatenate(scores)), rate)))
        longest = np.max([equal(log.y).max(axis=0) for log in recorded.healthy], axis=0)

        def judge(logs: Sequence[Log]) -> list[Found]:
            found: dict[int, Found] = {}
            for rows in {len(log.t) for log in logs}:
                which = [k for k, log in enumerate(logs) if len(log.t) == rows]
                z = np.stack([scale.scaled(columns(logs[k])) for k in which], axis=1)
                t = plant.dt * np.arange(rows)
                decided = run(detector, detector.init((len(which),), -plant.dt), t, z, np.zeros((rows, len(which), 0)))[1]
                for b, k in enumerate(which):
                    named = np.zeros((rows, count), bool)
                    named[:, scale.used[:own]] = decided.isolated[:, b, :own]
                    alarm = np.asarray(decided.alarm[:, b])
                    if stuck:
                        flat = equal(logs[k].y) > np.maximum(2 * longest, FEWEST_EQUAL)
                        alarm, named = alarm | flat.any(axis=1), named | flat
                    found[k] = Found(alarm, named, np.zeros(rows, bool))
            return [found[k] for k in range(len(logs))]

        return judge

    return learn


def _noise(runs: Sequence[Array]) -> Array:
    """The noise of each column (q,), from its steps between rows, repeated readings left out."""
    steps = np.concatenate([np.diff(z, axis=0) for z in runs])
    return np.asarray(np.nanstd(np.where(steps == 0, np.nan, steps), axis=0) / np.sqrt(2))


def equal(y: Array) -> Array:
    """How many readings in a row up to each one are equal to it (K, N), 0 where it is missing."""
    count, found = np.zeros(y.shape[1]), np.zeros(y.shape)
    for k, now in enumerate(y):
        same = now == y[k - 1] if k else np.zeros(len(now), bool)
        count = np.where(np.isfinite(now), np.where(same, count + 1, 1), 0)
        found[k] = count
    return found


METHODS: dict[str, Learn] = {
    "monitor": monitor,
    "pca": by_detector("pca", COMPLETE, inputs=True),
    "dynamic-pca": by_detector("dynamic-pca", COMPLETE, inputs=True),
    "isolation forest": by_statistics(isolation_forest, names=False),
    "median of others": by_statistics(median_of_others),
    "ridge on others": by_statistics(*map(ridge_on_others, RIDGES)),
    "limits-ewma": by_detector("limits-ewma", LACKING, inputs=False, stuck=True),
    "vector autoregression": by_statistics(*(vector_autoregression(p, r) for p in LAGS for r in RIDGES[1:])),
}
ALIKE = "median of others"  # only where sensors measure alike


def methods_of(recorded: Recorded) -> dict[str, Learn]:
    """The methods that a set has."""
    return {name: learn for name, learn in METHODS.items() if name != ALIKE or recorded.groups}
