"""Sensors that repeat their value until a new one comes, found while rows arrive: their repeats count as missing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.regularity import FEWEST, of_lengths, repeats

Array = NDArray[Any]

KEPT = 40  # runs of equal readings of each sensor, and changes between them
UNDECIDED = 40  # readings that are repeats at most, as long as a sensor has not had FEWEST runs
CURE = "its repeats are taken as missing"


class SlowSensors:
    """Takes the readings of one row after another and returns them without repeats; `say` is called once for a slow sensor.

    The last KEPT runs of equal readings of a sensor decide whether it is slow, as `regularity.repeat` decides it for a log.
    Before it has had FEWEST of them, equal readings are repeats, at most UNDECIDED in a row: of a sensor that reads anew in
    each row none are equal, and it has had them after as many rows. A frozen sensor is not slow: what is equal for longer is
    kept.
    """

    def __init__(self, plant: Plant, say: Callable[[str], None]) -> None:
        count = len(plant.sensors)
        self.names, self.say = plant.sensor_names, say
        self.last, self.age, self.seen = np.full(count, np.nan), np.zeros(count, int), np.zeros(count, int)
        self.lengths = np.zeros((count, KEPT), int)
        self.changes, self.values = np.zeros((count, KEPT)), np.zeros((count, KEPT))
        self.longest = np.full(count, UNDECIDED)  # repeats have a lower age
        self.announced = np.zeros(count, bool)

    def take(self, y: Array) -> Array:
        """The readings (N,) with NaN for repeats; the same array where none is."""
        equal = y == self.last
        self.age[equal] += 1
        new = np.isfinite(y) & ~equal
        for i in np.flatnonzero(new & np.isfinite(self.last)).tolist():
            self._ended(i, abs(float(y[i] - self.last[i])))
        self.last, self.age = np.where(new, y, self.last), np.where(new, 0, self.age)
        repeated = equal & (self.age < self.longest)
        return np.where(repeated, np.nan, y) if repeated.any() else y

    def _ended(self, i: int, change: float) -> None:
        """A run of equal readings of sensor i has ended with such a change; the first may have begun before."""
        k = int(self.seen[i])
        self.seen[i] += 1
        if k == 0:
            return
        of_run = self.lengths, self.changes, self.values
        for kept, value in zip(of_run, (self.age[i] + 1, change, self.last[i]), strict=True):
            kept[i, (k - 1) % KEPT] = value
        if k < FEWEST:
            return
        lengths, changes, values = (kept[i, : min(k, KEPT)] for kept in of_run)
        self.longest[i] = 1
        if not repeats(lengths, values, changes):
            return
        found = of_lengths(lengths)
        self.longest[i] = found.longest
        if not self.announced[i]:
            self.announced[i] = True
            self.say(f"{self.names[i]} repeats its value, {found.words}: {CURE}")

    def arrays(self) -> dict[str, Array]:
        """What `restore` goes on from."""
        return {name: getattr(self, name) for name in ARRAYS}

    def restore(self, arrays: dict[str, Array]) -> None:
        """Go on from `arrays`; KeyError or ValueError for those of other sensors."""
        for name in ARRAYS:
            now: Array = getattr(self, name)
            if arrays[name].shape != now.shape or arrays[name].dtype != now.dtype:
                raise ValueError(f"{name} of slow sensors has shape {arrays[name].shape}; expected {now.shape}")
            setattr(self, name, arrays[name].copy())


ARRAYS = ("last", "age", "seen", "lengths", "changes", "values", "longest", "announced")
