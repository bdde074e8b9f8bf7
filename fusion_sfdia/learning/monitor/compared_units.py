"""Units of one kind, each with a log of its own: one that differs from its siblings, by what these would read in its place.

Of each unit the means over `ROWS` rows of its healthy readings count. Those of all other units give a covariance, and from it
the error of every sensor given all other channels (see `windows`), of which the unit has a level and a spread. With m and s the
mean and standard deviation of one of them over the B - 1 other units, that of a unit like them, x, has

    (x - m) / (s sqrt(1 + 1 / (B - 1)))  t-distributed with B - 2 degrees of freedom

(Thompson 1935). The unit furthest from the others is left out, the rest compared again, up to a quarter of them: those differ
up to the last one that is further than chance gives, so that two do not hide each other (Rosner 1983).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fusion_sfdia.diagnosis.events import with_unit
from fusion_sfdia.learning.monitor.windows import WindowSums, completed, precision_of, window_means
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

ROWS = 64
EVERY = 16  # rows between two means
FEWEST = 5  # units, of fewer the spread among them is not known
MOST = 4  # one in so many units may differ
LEAST = 8  # means of a unit
RIDGE = 0.01
CHANCE = 0.05  # of at least one unit, of all sensors, that differs by chance


class Different(NamedTuple):
    """A sensor of a unit that differs: by so much in its unit, or, where spread, by a factor of how much it moves against what
    others make expected. excess: how many times as far as by chance.
    """

    unit: str
    sensor: str
    size: float
    spread: bool
    excess: float
    in_unit: str = ""

    def __str__(self) -> str:
        if self.spread:
            how = f"moves {self.size:.2g} times as much about what its other channels make expected"
        else:
            side = "above" if self.size > 0 else "below"
            how = f"reads {with_unit(f'{abs(self.size):.3g}', self.in_unit)} {side} what other units would read there"
        return f"{self.unit}: {self.sensor} {how}"


def means_of(v: Array) -> Array:
    """The means (R, n) of readings on a grid, v (K, n), that `differing` takes."""
    return window_means(v, ROWS)[ROWS - 1 :: EVERY]


def differing(sensors: Sequence[Signal], units: dict[str, Array]) -> list[Different]:
    """The units that differ, each by the sensor that does so most; units: of each the means (R, n), sensors first.

    Nothing of fewer than `FEWEST` units with `LEAST` means.
    """
    units = {name: m for name, m in units.items() if np.isfinite(m).all(axis=1).sum() >= LEAST}
    left_out: list[Different] = []
    for _ in range(len(units) // MOST):
        if len(units) < FEWEST or (worst := _most_different(sensors, units)) is None:
            break
        left_out.append(worst)
        del units[worst.unit]
    beyond = [k for k, d in enumerate(left_out, start=1) if d.excess > 1]
    return left_out[: max(beyond, default=0)]


def _most_different(sensors: Sequence[Signal], units: dict[str, Array]) -> Different | None:
    """The unit furthest from the others, with its distance over the limit; None where nothing can be compared."""
    every = np.concatenate(list(units.values()))
    used = np.flatnonzero((np.isfinite(every).mean(axis=0) >= 0.5) & (np.nanstd(every, axis=0) > 0))
    count = int(np.sum(used < len(sensors)))
    if not count or len(used) < 2:
        return None
    mean, sd = np.nanmean(every[:, used], axis=0), np.nanstd(every[:, used], axis=0)
    z = [(m[:, used] - mean) / sd for m in units.values()]
    moments = [WindowSums.of(np.nan_to_num(x)) for x in z]
    of_units = np.empty((2, len(z), count))  # levels, and logarithms of spreads
    for k, x in enumerate(z):
        others = WindowSums.together([m for j, m in enumerate(moments) if j != k])
        precision = precision_of(others.covariance(centred=True), RIDGE)
        e = (completed(precision, x - others.mean) @ precision / np.diagonal(precision))[:, :count]
        of_units[:, k] = np.median(e, axis=0), np.log(np.maximum(np.std(e, axis=0), 1e-12))
    off, deviation = np.empty_like(of_units), np.empty_like(of_units)
    for k in range(len(z)):
        rest = np.delete(of_units, k, axis=1)
        off[:, k] = of_units[:, k] - rest.mean(axis=1)
        deviation[:, k] = rest.std(axis=1, ddof=1) * np.sqrt(1 + 1 / rest.shape[1])
    limit = student.isf(CHANCE / (2 * of_units.size), len(z) - 2)
    excess = np.abs(off) / np.maximum(limit * deviation, 1e-12)
    spread, k, i = (int(a) for a in np.unravel_index(np.argmax(excess), excess.shape))
    size, sensor = (np.exp(off[1, k, i]) if spread else off[0, k, i] * sd[i]), sensors[int(used[i])]
    return Different(list(units)[k], sensor.name, float(size), bool(spread), float(excess[spread, k, i]), sensor.unit)
