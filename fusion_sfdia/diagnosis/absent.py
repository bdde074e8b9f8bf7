"""Sensors that no residual shows: readings that are missing, or that repeat their value, for a long time or throughout."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from fusion_sfdia.diagnosis.events import spans
from fusion_sfdia.plant.regularity import equal_readings

Array = NDArray[Any]

DUE = 20  # readings in a row that are due: where half of them are missing, the sensor has dropped out
COMPLETE = 0.9  # share of the readings due, and of those at a multiple of the period, below which some miss at random
HEALTHY = 0.75  # quantile of the readings of windows, half of which are usual: a quarter of a log is enough to know
BY_CHANCE = 1e-6  # probability that so few readings come in a window
REPEATED = 16  # equal readings in a row: with 8 pairs a test of quiet readings has power, see `detectors.kalman_banks.quiet`
LONGER = 10  # times the usual number of equal readings in a row
TWICE = 2  # times the largest number that healthy logs show
CONTRADICTED, SHARE = 3.0, 0.1  # standard deviations; share of equal readings of a coarse sensor that are so far off


def dropouts(y: Array) -> list[list[tuple[int, int]]]:
    """Return, for each sensor of y (K, N), the first and last index of each stretch in which at least half of the readings due
    are missing.

    A sensor is due every p samples, p the median distance of its readings (of those that differ); of `DUE` readings due in a
    row half are missing, and the stretch goes from the first sample that is overdue to the last. Of a sensor that misses a
    tenth of its readings at random half of 20 are missing with a probability of 7e-6; of one that misses more, so many have to
    be missing that `BY_CHANCE` is not exceeded. Samples without any reading are a gap of the log and do not count.
    """
    known = np.isfinite(y)
    rows = np.flatnonzero(np.any(known, axis=1))
    found: list[list[tuple[int, int]]] = []
    for readings, column in zip(y[rows].T, known[rows].T, strict=True):
        at = np.flatnonzero(column)
        if at.size < 2:
            found.append([(0, len(y) - 1)] if at.size < column.size else [])
            continue
        period = _usual_distance(readings[at], at)
        width = min(DUE * period, column.size)
        read = np.concatenate([[0], np.cumsum(column)])
        count = read[width:] - read[:-width]  # of the window that begins here
        few = count <= _fewest(count, width, period, _regular(at, period))
        if width < DUE * period:
            few &= column.size >= DUE * period // 2
        missing = np.zeros(column.size, bool)
        for k in np.flatnonzero(few):
            missing[k : k + width] = True
        overdue = read[1:] == read[np.maximum(np.arange(1, column.size + 1) - period, 0)]
        stretches = []
        for a, b in spans(missing):
            absent = np.flatnonzero(overdue[a : b + 1]) + a
            if absent.size >= DUE * period / 2:
                stretches.append((int(rows[absent[0]]), int(rows[absent[-1]])))
        found.append(stretches)
    return found


def _fewest(count: Array, width: int, period: int, regular: bool) -> float:
    """The readings of a window up to which its sensor has dropped out, of the counts (W,) of all windows; regular: whether its
    readings come at multiples of the period.
    """
    usual = count[count >= np.quantile(count, HEALTHY) / 2]
    share, half = float(np.median(usual)) / width, width / period / 2
    return half if regular and share * period >= COMPLETE else min(half, float(binom.ppf(BY_CHANCE, width, share)) - 1)


def due(column: Array, silent: Sequence[tuple[int, int]]) -> Array:
    """Where a reading of a sensor (K,), NaN where missing, is or should be, with p and its stretches `silent` as in `dropouts`:
    of one that reads every p-th sample not in between, of one that misses some at random in those stretches.
    """
    known = np.isfinite(column)
    at = np.flatnonzero(known)
    period, within = _usual_distance(column[at], at), np.zeros(column.size, bool)
    for a, b in silent:
        within[a : b + 1] = True
    if period == 1 and (within.all() or np.mean(known[~within]) >= COMPLETE):
        return np.ones(column.size, bool)
    if period == 1 or not _regular(at, period):
        return known | within
    last = np.maximum.accumulate(np.where(known, np.arange(column.size), -1))
    return np.asarray(known | (np.arange(column.size) - last >= 2 * period))


def repeats(y: Array, healthy: Sequence[int] | None = None) -> list[list[tuple[int, int]]]:
    """Return, for each sensor of y (K, N), the first and last index of each long run of equal readings.

    A run is long with `REPEATED` readings and `LONGER` times as many as the median run of the sensor has, so that a log that
    holds slow readings is not frozen. Where healthy logs show how long a sensor repeats a reading, healthy (N,) samples at
    most, it is long with `REPEATED` readings and `TWICE` as many as that. Missing readings are passed over.
    """
    found: list[list[tuple[int, int]]] = []
    for i, column in enumerate(y.T):
        at, starts, lengths = equal_readings(column)
        usual = LONGER * float(np.median(lengths)) if lengths.size > 1 else 0.0
        least = max(REPEATED, usual if healthy is None else TWICE * healthy[i])
        first, count = starts[lengths >= least], lengths[lengths >= least]
        found.append(list(zip(at[first].tolist(), at[first + count - 1].tolist(), strict=True)))
    return found


def beyond_resolution(frozen: Sequence[list[tuple[int, int]]], z: Array, resolution: Array) -> list[list[tuple[int, int]]]:
    """The stretches of equal readings that are no coarse sensor's: those of a sensor with a resolution (N,) only where what the
    other sensors predict contradicts them; z (K, N): residuals without these readings, over their standard deviations.
    """
    with np.errstate(invalid="ignore"):
        off = np.abs(z) > CONTRADICTED
    return [
        [(a, b) for a, b in stretches if not step or np.mean(off[a : b + 1, i]) > SHARE]
        for i, (stretches, step) in enumerate(zip(frozen, resolution, strict=True))
    ]


def _regular(at: Array, period: int) -> bool:
    """Whether readings at these positions come at multiples of the period."""
    return bool(np.mean(np.diff(at) % period == 0) >= COMPLETE)


def _usual_distance(readings: Array, at: Array) -> int:
    """The median distance of readings at these positions that differ from the one before, of all where none does."""
    apart = np.diff(at)
    moved = np.diff(readings) != 0
    return max(1, int(np.median(apart[moved] if moved.any() else apart))) if apart.size else 1
