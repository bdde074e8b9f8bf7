"""Healthy logs for identification: cut at long gaps, checked, repeated readings left out, in units of each signal's standard
deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, require_unique
from fusion_sfdia.plant.gaps import parted, stretches
from fusion_sfdia.plant.log import Log, one_run
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

JITTER = 0.1  # of a time step that a run may contain
EVEN = 0.5  # least share of the steps that must be even
BETWEEN = 30  # missing samples between runs that are joined: a filter forgets the run before


class Runs(NamedTuple):
    """Runs of even steps. logs: t (K,), y (K, N) with NaN where missing, u (K, m); of: the log that each was cut from; dt in s.

    moves (N,): whether a sensor has at least two different readings. mean and standard deviation of y (N,) and u (m,), the
    latter 1 where a signal never moves.
    """

    logs: tuple[Log, ...]
    of: tuple[int, ...]
    dt: float
    moves: Array
    y_mean: Array
    y_sd: Array
    u_mean: Array
    u_sd: Array

    @property
    def samples(self) -> int:
        return sum(len(log.t) for log in self.logs)

    def scaled(self, logs: Sequence[Log]) -> list[tuple[Array, Array]]:
        """Readings and inputs of logs in units of the standard deviation about the mean."""
        return [((y - self.y_mean) / self.y_sd, (u - self.u_mean) / self.u_sd) for _, y, u in logs]

    def joined(self, logs: Sequence[Log]) -> Scaled:
        """Logs as one scaled recording, with BETWEEN missing samples and mean inputs after each."""
        parts = [
            np.pad(a, ((0, BETWEEN), (0, 0)), constant_values=v)
            for pair in self.scaled(logs)
            for a, v in zip(pair, (np.nan, 0.0), strict=True)
        ]
        y, u = np.concatenate(parts[::2]), np.concatenate(parts[1::2])
        return Scaled(y[:-BETWEEN], u[:-BETWEEN], self.dt, self.y_mean, self.y_sd, self.u_mean, self.u_sd)


def runs_of(sensors: Sequence[Signal], inputs: Sequence[Signal], logs: Sequence[Log]) -> Runs:
    """Return healthy logs of these sensors and inputs as runs of even steps; ValueError where they do not fit.

    Rows that are skipped are rows without readings; a long gap begins a new run, as do a step that differs from the median by
    more than JITTER and an input that is not known.
    """
    require_unique("signals of a log", [s.name for s in (*sensors, *inputs)])
    if not logs:
        raise ValueError("there are no healthy logs; expected at least one")
    checked = [_checked(k, log, len(sensors), len(inputs)) for k, log in enumerate(logs, start=1)]
    steps = np.concatenate([np.diff(t) for t, _, _ in checked])
    if not steps.size:
        raise ValueError("the healthy logs have one sample each; expected runs")
    dt = float(np.median(steps))
    if np.mean(np.abs(steps / dt - 1) <= JITTER) < EVEN:
        raise ValueError(
            f"fewer than half of the time steps are within {JITTER:.0%} of the median, {dt:g} s; resample the logs"
        )
    cut = [(k, part) for k, log in enumerate(checked) for part in _parts(log, dt)]
    if not cut:
        raise ValueError("no two samples in a row have all inputs; leave out the inputs that are often missing")
    y = np.concatenate([part.y for _, part in cut])
    u = np.concatenate([part.u for _, part in cut])
    for sensor, column in zip(sensors, y.T, strict=True):
        if not np.isfinite(column).any():
            raise ValueError(f"sensor {sensor.name!r} has no reading; leave it out")
    moves = np.nanmin(y, axis=0) < np.nanmax(y, axis=0)
    y_sd, u_sd = np.nanstd(y, axis=0), u.std(axis=0)
    return Runs(
        tuple(part for _, part in cut), tuple(k for k, _ in cut), dt, moves,
        np.nanmean(y, axis=0), np.where(moves, y_sd, 1.0), u.mean(axis=0), np.where(np.ptp(u, axis=0) > 0, u_sd, 1.0),
    )  # fmt: skip


def _checked(k: int, log: Log, count: int, inputs: int) -> Log:
    if len(log) != 3:
        raise ValueError(f"healthy log {k} has {len(log)} parts; expected a Log: t (K,), y (K, N), u (K, m)")
    t, y, u = one_run(Log(*(floats(what, value) for what, value in zip(("t", "y", "u"), log, strict=True))))
    if t.ndim != 1 or not t.size or y.shape != (t.size, count) or u.shape != (t.size, inputs) or not count:
        raise ValueError(
            f"healthy log {k}: t {t.shape}, y {y.shape}, u {u.shape} do not fit {count} sensors and {inputs} inputs; expected "
            f"(K,), (K, {count}), (K, {inputs}), with at least one sensor and one sample"
        )
    if not np.isfinite(t).all() or not np.all(np.diff(t) > 0):
        raise ValueError(f"healthy log {k}: the times do not rise; sort the rows and drop duplicates")
    if np.isinf(y).any() or np.isinf(u).any():
        raise ValueError(f"healthy log {k} has infinite values; expected NaN for missing ones")
    return Log(t, y, u)


def _parts(log: Log, dt: float) -> list[Log]:
    """The stretches of even steps and known inputs of at least two samples, with rows without readings for skipped ones."""
    found = []
    for part in stretches(log, dt):
        known = np.asarray(np.isfinite(part.u).all(axis=1))
        even = np.asarray(np.abs(np.diff(part.t) / dt - 1) <= JITTER)
        found += [p for p in parted(part, ~even | ~known[1:] | ~known[:-1]) if len(p.t) > 1]
    return found


def groups_of(runs: Runs, folds: int) -> tuple[str, list[list[Log]]]:
    """Return what is left out in turn, "logs" or "stretches", and the groups of runs: of three logs and more, whole logs;
    else stretches of about equal length.
    """
    logs = len(set(runs.of))
    if logs >= 3:
        groups: list[list[Log]] = [[] for _ in range(min(folds, logs))]
        for k, log in zip(runs.of, runs.logs, strict=True):
            groups[k % len(groups)].append(log)
        return "logs", [g for g in groups if g]
    ends = np.cumsum([len(log.t) for log in runs.logs])
    bounds = np.round(np.linspace(0, ends[-1], folds + 1)).astype(int)
    stretches: list[list[Log]] = []
    for a, b in pairwise(bounds):
        rows = [
            (max(a - (e - len(log.t)), 0), min(b - (e - len(log.t)), len(log.t)), log)
            for e, log in zip(ends, runs.logs, strict=True)
        ]
        stretches.append([log.rows(slice(i, j)) for i, j, log in rows if j - i > 1])
    return "stretches", [s for s in stretches if s]


class Scaled(NamedTuple):
    """y (K, N) and u (K, m), centred and of variance 1; dt in s; mean and standard deviation of each (N,), (m,)."""

    y: Array
    u: Array
    dt: float
    y_mean: Array
    y_sd: Array
    u_mean: Array
    u_sd: Array


def scaled(sensors: Sequence[Signal], inputs: Sequence[Signal], log: Log) -> Scaled:
    """Return the recording of these sensors and inputs scaled; ValueError where it does not fit or cannot be identified."""
    if len(log) != 3:
        raise ValueError(f"the recording has {len(log)} parts; expected a Log: t (K,), y (K, N), u (K, m)")
    t, y, u = one_run(Log(*(floats(what, value) for what, value in zip(("t", "y", "u"), log, strict=True))))
    require_unique("signals of a recording", [s.name for s in (*sensors, *inputs)])
    if t.ndim != 1 or y.shape != (t.size, len(sensors)) or u.shape != (t.size, len(inputs)) or not sensors:
        raise ValueError(
            f"t {t.shape}, y {y.shape}, u {u.shape} do not fit {len(sensors)} sensors and {len(inputs)} inputs; expected (K,), "
            f"(K, {len(sensors)}), (K, {len(inputs)}), with at least one sensor"
        )
    if t.size < 2 or not np.allclose(steps := np.diff(t), steps[0], rtol=1e-6, atol=0.0) or not steps[0] > 0:
        raise ValueError("the times of the recording do not rise in equal steps; add rows of NaN where readings are missing")
    if np.isinf(y).any() or not np.isfinite(u).all():
        raise ValueError(
            "the recording has infinite readings or inputs that are missing; expected NaN for missing readings alone"
        )
    for what, signals, values in (("sensor", sensors, y), ("input", inputs, u)):
        for signal, column in zip(signals, values.T, strict=True):
            known = column[np.isfinite(column)]
            if known.size < 2 or known.min() == known.max():
                raise ValueError(
                    f"{what} {signal.name!r} has {known.size} readings of {np.unique(known).size} values; expected one that "
                    "moves: leave it out"
                )
    y_mean, y_sd, u_mean, u_sd = np.nanmean(y, axis=0), np.nanstd(y, axis=0), u.mean(axis=0), u.std(axis=0)
    return Scaled((y - y_mean) / y_sd, (u - u_mean) / u_sd, float(steps[0]), y_mean, y_sd, u_mean, u_sd)


def without_repeats(y: Array, repeating: Array) -> Array:
    """Return y with NaN where a sensor has the same reading as in the sample before.

    A sampled analyser repeats its last value until the next analysis: repetitions are no new readings, and their errors are
    the same. An analysis that gives the very same value is left out too, which costs a reading and no more.

    Parameters
    ----------
    y : array (K, N)
        Readings.
    repeating : array (N,) of bool
        Sensors that repeat their readings.

    Returns
    -------
    array (K, N)
        y without the repetitions.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.learning import without_repeats
    >>> without_repeats(np.array([[5.0], [5.0], [7.0]]), np.array([True])).ravel()
    array([ 5., nan,  7.])
    """
    y = floats("y", y)
    repeated = np.zeros(y.shape, bool)
    repeated[1:] = (y[1:] == y[:-1]) & repeating
    return np.where(repeated, np.nan, y)
