"""Logs on one grid of time, and which of their channels can be learnt, in which form.

Rows go to the nearest multiple of the median step; rows that are not there have no readings. A gap of more than 60 rows begins
a new piece.

Isolated outliers. The jump of a reading is its distance from the median of the five rows before. A channel has outliers if
two healthy readings of a thousand, or more, jump by more than 6 standard deviations (by the median of jumps) and no other
does so within five rows. When learning and when judging the first two readings of such a jump do not count, and what follows
to the same side does. One percent of outliers of 10 deviations else widens limits until a bias of 2 is found in a quarter of
the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import skew

from fusion_sfdia.common.arguments import require_unique
from fusion_sfdia.learning.monitor.windows import earlier
from fusion_sfdia.plant.gaps import LONG
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

SKEWED = 2.0  # of readings that are not negative: their logarithm is used where it halves their skewness
FLOOR = 0.5  # of the 1 % quantile of the positive ones, below which the logarithm takes them as equal
SPARSE = 0.5  # share of the rows in which most columns have readings, below which each tag has times of its own
KEPT = 0.8  # of the distances of a tag's readings, which the grid keeps then
SELDOM = 2.0  # steps: a column whose readings are further apart is written on change, and keeps its last reading
FAR = 6.0  # standard deviations of jumps, beyond which one is an outlier, or the begin of a step
OUTLIERS = 0.002  # least share of the healthy readings
BEFORE, LEAST_BEFORE = 5, 3  # rows before a reading from which it jumps, and of these with readings
MISSING = 0.3  # share of readings that a channel may lack
PARTS = 8  # parts of the healthy rows, in at least half of which a channel must have readings, and move


class GridRows(NamedTuple):
    """Rows on a grid: times t (K,), readings of all columns v (K, n) in their own units, NaN where there is none.

    rows (K,): the row of the log that each was, the last one where it was several, -1 where none was.
    """

    t: Array
    v: Array
    rows: Array


def usual_step(logs: Sequence[Log]) -> float:
    """The step (s) of the grid that healthy logs support; ValueError where there is none.

    The median distance of rows; where most columns have readings in less than `SPARSE` of the rows, as of tags that are written
    each at its own time, the distance that four fifths of the readings of the median column keep.
    """
    for k, log in enumerate(logs, start=1):
        _require_rising(log.t, f"healthy log {k}")
    steps = np.concatenate([np.diff(log.t) for log in logs]) if logs else np.empty(0)
    if not steps.size:
        raise ValueError("there are no two healthy rows in one log; expected logs of some hundred rows")
    known = [np.isfinite(np.concatenate([log.y, log.u], axis=1)) for log in logs]
    share = np.mean(np.concatenate(known), axis=0)
    if np.median(share) >= SPARSE:
        return float(np.median(steps))
    of_column = []
    for i in np.flatnonzero(share > 0):
        apart = [np.diff(log.t[k[:, i]]) for log, k in zip(logs, known, strict=True)]
        if (distances := np.concatenate(apart)).size:
            of_column.append(float(np.quantile(distances, KEPT)))
    return float(np.median(of_column)) if of_column else float(np.median(steps))


def _require_rising(t: Array, which: str) -> None:
    if not (np.isfinite(t).all() and np.all(np.diff(t) > 0)):
        raise ValueError(f"the times of {which} do not rise; sort its rows and drop duplicates")


def pieces_of(log: Log, dt: float) -> list[GridRows]:
    """The pieces of a log of one run, t (K,), y (K, N), u (K, m), on a grid of step dt (s) from its first row on.

    Of several rows at one step the mean counts.
    """
    t, y, u = log
    _require_rising(t, "the log")
    step = np.rint((t - t[0]) / dt).astype(np.int64)
    v = np.concatenate([y, u], axis=1)
    found = []
    for part in np.split(np.arange(t.size), np.flatnonzero(np.diff(step) > LONG) + 1):
        at = step[part] - step[part[0]]
        rows = np.full(at[-1] + 1, -1)
        rows[at] = part
        found.append(GridRows(t[0] + dt * (step[part[0]] + np.arange(rows.size)), _means(v[part], at, rows.size), rows))
    return found


def _means(v: Array, at: Array, steps: int) -> Array:
    """Means (steps, n) of readings v (K, n) at these steps (K,), to the bit the reading where all are equal."""
    known = np.isfinite(v)
    shape = (steps, v.shape[1])
    count, total, least, most = np.zeros(shape), np.zeros(shape), np.full(shape, np.inf), np.full(shape, -np.inf)
    np.add.at(count, at, known)
    np.add.at(total, at, np.where(known, v, 0.0))
    np.minimum.at(least, at, np.where(known, v, np.inf))
    np.maximum.at(most, at, np.where(known, v, -np.inf))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count == 0, np.nan, np.where(least == most, least, total / count))


class Read(NamedTuple):
    """Up to each row: the last reading of each column, NaN before the first; the rows since then, before the first those since
    the beginning; and how many readings in a row were equal, (K, n), or (n,) of one row.
    """

    value: Array
    age: Array
    equal: Array

    @classmethod
    def none(cls, columns: int) -> Read:
        """Before the first row."""
        return cls(np.full(columns, np.nan), np.zeros(columns), np.zeros(columns))

    def held(self, hold: Array) -> Array:
        """The last readings for so many rows (n,), 0 for those of the row alone; NaN after that."""
        return np.where((self.age <= hold) | (self.age == 0), self.value, np.nan)


def read(v: Array, before: Read | None = None) -> Read:
    """What was read up to each row of v (K, n), NaN where missing; before: up to the row before the first."""
    before = before or Read.none(v.shape[1])
    k, known = np.arange(len(v))[:, None], np.isfinite(v)
    last = np.maximum.accumulate(np.where(known, k, -1), axis=0)
    own = last >= 0
    value = np.where(own, np.take_along_axis(v, np.maximum(last, 0), axis=0), before.value)
    count = np.cumsum(known, axis=0)
    new = known & (v != np.concatenate([before.value[None], value[:-1]]))
    began = np.maximum.accumulate(np.where(new, count, 0), axis=0)
    equal = np.where(began > 0, count - began + 1, before.equal + count)
    return Read(value, np.where(own, k - last, before.age + k + 1).astype(float), equal.astype(float))


def _in_logs(v: Array, floor: Array) -> Array:
    """Readings v (K, q), of channels with a floor (q,) log(max(v, floor))."""
    found, logs = v.copy(), np.isfinite(floor)
    found[:, logs] = np.log(np.maximum(found[:, logs], floor[logs]))
    return found


@dataclass(frozen=True, eq=False)
class Channels:
    """Columns of logs, sensors first, and what is used of them.

    used: indices of the columns that are used, sensors first. hold (n,): rows for which a column of all keeps its last reading,
    as one that is written on change, 0 for none. far (n,): jump of a column of all whose first two readings do not count, inf
    where there are no outliers. floor, mean, sd (q,) of these: z = (v - mean) / sd, where floor
    is a number of log(max(v, floor)). left_out: why the others are not. still: sensors that never moved, and their reading.
    """

    sensors: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    used: Array
    hold: Array
    far: Array
    floor: Array
    mean: Array
    sd: Array
    left_out: dict[str, str]
    still: dict[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the channels that are used."""
        every = [s.name for s in (*self.sensors, *self.inputs)]
        return tuple(every[i] for i in self.used)

    @property
    def count(self) -> int:
        """How many of the channels that are used are sensors."""
        return int(np.sum(self.used < len(self.sensors)))

    def scaled(self, v: Array) -> Array:
        """Scaled readings z (K, q) of what was read of all columns (K, n), those that are written on change held."""
        return np.asarray((_in_logs(v[:, self.used], self.floor) - self.mean) / self.sd)

    def size(self, i: int, v: float, z: float) -> float:
        """By how much a reading v of the channel i is off in its unit, where it is off by z standard deviations."""
        if np.isfinite(self.floor[i]):
            return float(v * -np.expm1(-z * self.sd[i]))
        return float(z * self.sd[i])


def jumps(v: Array) -> Array:
    """The distance of each reading of v (K, n) from the median of the rows before, NaN where few of these have one."""
    before = np.sort(np.stack([earlier(v, k, np.nan) for k in range(1, BEFORE + 1)]), axis=0)  # NaN last
    count = np.sum(np.isfinite(before), axis=0)
    middle = np.take_along_axis(before, np.maximum(count - 1, 0)[None] // 2, axis=0)[0]
    return np.where(count >= LEAST_BEFORE, v - middle, np.nan)


def _sides(jump: Array, far: Array) -> Array:
    """To which side readings are far off (K, n), 0 for none."""
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(jump) > far, np.sign(jump), 0.0)


def firsts(v: Array, far: Array) -> Array:
    """Which readings of v (K, n) are the first two of a jump by more than `far` (n,), isolated or the begin of a step."""
    side = _sides(jumps(v), far)
    return np.asarray((side != 0) & ((side != earlier(side, 1)) | (side != earlier(side, 2))))


def _far(logs: Sequence[Sequence[GridRows]], columns: int) -> Array:
    """The jump (n,) beyond which a column has isolated outliers in healthy logs, inf where it has none."""
    found = [jumps(piece.v) for log in logs for piece in log]
    every = np.abs(np.concatenate(found))
    far = np.full(columns, np.inf)
    for i in range(columns):
        known = every[np.isfinite(every[:, i]), i]
        scale = FAR * 1.4826 * float(np.median(known)) if known.size else 0.0
        count = 0
        for jump in found if scale > 0 else ():
            at = np.flatnonzero(np.abs(jump[:, i]) > scale)
            apart = np.diff(at, prepend=-BEFORE - 1, append=len(jump) + BEFORE)
            count += int(np.sum((apart[:-1] > BEFORE) & (apart[1:] > BEFORE)))
        if count and count >= OUTLIERS * known.size:
            far[i] = scale
    return far


def deviations(channels: Channels) -> Array:
    """The deviation of the readings of each column (n,) when healthy, in its unit; 1 of those without one."""
    found, plain = np.ones(channels.hold.size), ~np.isfinite(channels.floor)
    found[channels.used[plain]] = channels.sd[plain]
    return found


def learn_channels(sensors: Sequence[Signal], inputs: Sequence[Signal], logs: Sequence[Sequence[GridRows]]) -> Channels:
    """Which columns of healthy logs, each in pieces, can be learnt; ValueError where fewer than two can."""
    signals = (*sensors, *inputs)
    require_unique("signals of a log", [s.name for s in signals])
    hold = _hold(logs, len(signals))
    v = np.concatenate([read(piece.v).held(hold) for log in logs for piece in log])
    far = _far(logs, len(signals))
    outliers = np.concatenate([firsts(piece.v, far) for log in logs for piece in log])
    there = np.concatenate([piece.rows >= 0 for log in logs for piece in log])
    left_out: dict[str, str] = {}
    still: dict[str, float] = {}
    used, floors = [], []
    for i, signal in enumerate(signals):
        why = _unusable(v[:, i], there)
        if why == STILL:
            if i < len(sensors):
                still[signal.name] = float(np.nanmedian(v[:, i]))
            else:
                left_out[signal.name] = why
        elif why:
            left_out[signal.name] = why
        else:
            used.append(i)
            v[outliers[:, i], i] = np.nan
            floors.append(_floor(v[:, i]))
    count = sum(i < len(sensors) for i in used)
    if count < 1 or len(used) < 2:
        raise ValueError(
            f"{count} sensors and {len(used) - count} inputs of the healthy logs can be learnt; expected two channels or more, "
            f"one of them a sensor: {'; '.join(f'{n} {why}' for n, why in left_out.items()) or 'none moves'}"
        )
    of, floor = np.array(used), np.array(floors)
    z = _in_logs(v[:, of], floor)
    mean, sd = np.nanmean(z, axis=0), np.nanstd(z, axis=0)
    return Channels(tuple(sensors), tuple(inputs), of, hold, far, floor, mean, sd, left_out, still)


def _hold(logs: Sequence[Sequence[GridRows]], columns: int) -> Array:
    """The longest distance (n,) in rows of the readings of each column whose readings are usually further apart than SELDOM."""
    found = np.zeros(columns)
    for i in range(columns):
        apart = [np.diff(np.flatnonzero(np.isfinite(piece.v[:, i]))) for log in logs for piece in log]
        distances = np.concatenate(apart)
        if distances.size and np.median(distances) > SELDOM:
            found[i] = np.max(distances)
    return found


STILL = "never moves in the healthy logs"


def _unusable(v: Array, there: Array) -> str:
    """Why a channel (K,) cannot be learnt, "" where it can."""
    known = np.isfinite(v)
    if not known.any():
        return "has no reading in the healthy logs"
    if np.nanmin(v) == np.nanmax(v):
        return STILL
    if (missing := 1 - np.sum(known) / np.sum(there)) > MISSING:
        return f"misses {missing:.0%} of its readings in the healthy logs"
    values, counts = np.unique(v[known], return_counts=True)
    common = values[np.argmax(counts)]
    parts = np.array_split(np.arange(len(v)), PARTS)
    if sum(bool(known[p].any()) for p in parts) <= PARTS / 2:
        return "has readings in less than half of the healthy time"
    if sum(bool(np.any(known[p] & (v[p] != common))) for p in parts) <= PARTS / 2:
        return f"differs from {common:.6g} in less than half of the healthy time"
    return ""


def _floor(v: Array) -> float:
    """The floor of the logarithm of a channel (K,), NaN where its readings are used as they are."""
    known = v[np.isfinite(v)]
    if known.min() < 0 or not (known > 0).any() or abs(before := float(skew(known))) <= SKEWED:
        return np.nan
    floor = FLOOR * float(np.quantile(known[known > 0], 0.01))
    after = float(skew(np.log(np.maximum(known, floor))))
    return floor if abs(after) <= abs(before) / 2 else np.nan
