"""Sensors of a log that are slower than its rows, coarse or cyclic, and what a diagnosis makes of their readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.logs.loaded_log import Finding
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.regularity import Repeat, equal_readings, period, repeat, repeated, resolution
from fusion_sfdia.plant.signals import Sensor

Array = NDArray[Any]

COARSE = 1.0  # noise sigma of a sensor: a finer step adds less than a tenth to the variance of its noise
STAYS = 2.0  # equal readings in a row on average, above which rounding errors add up also where the resolution is stated
CORRELATED = 15  # readings: over so many a rounding error that stays is taken to add up


@dataclass(frozen=True)
class Regularities:
    """Of some sensors of a plant, by position: how they repeat their value, their step of resolution with the mean number of
    equal readings, their period. taken: how many readings of the first are repeats. step: usual time between rows, s.
    """

    repeats: Mapping[int, Repeat]
    coarse: Mapping[int, tuple[float, float]]
    periods: Mapping[int, float]
    taken: Mapping[int, int]
    step: float

    def findings(self, plant: Plant) -> list[Finding]:
        """A finding for each, with what is made of it."""
        found = [
            Finding(
                "repeat", plant.sensor_names[i], self.taken[i],
                f"{plant.sensor_names[i]} repeats its value, {one.words}"
                f"{f' ({one.usual * self.step:.6g} s)' * (one.usual > 1)}: {self.taken[i]} repeats are taken as missing",
            )
            for i, one in self.repeats.items()
        ]  # fmt: skip
        for i, (q, _) in self.coarse.items():
            s = plant.sensors[i]
            cure = f"; state Sensor(resolution={q:.4g})" if q > s.resolution * 1.01 else ""
            text = (
                f"{s.name} reads in steps of {q:.4g} {s.unit}, {q / s.noise_sigma:.2g} times its noise: a resolution, whose "
                f"rounding counts as noise unless the thresholds were fitted to such readings{cure}"
            )
            found.append(Finding("resolution", s.name, 0, text))
        for i, p in self.periods.items():
            s = plant.sensors[i]
            text = (
                f"{s.name} jumps by {p:.6g} {s.unit} as a cyclic reading does, such as an angle after a full turn: its "
                f"residuals are wrapped by this period; state Signal(period={p:.6g}) of {s.measures}"
            )
            found.append(Finding("period", s.name, 0, text))
        return found

    def without_repeats(self, log: Log) -> Log:
        """The log with the readings missing that repeat the one before; itself where none does."""
        if not self.repeats:
            return log
        y = log.y.copy()
        for i, one in self.repeats.items():
            y[repeated(y[:, i], one), i] = np.nan
        return log._replace(y=y)

    def of(self, plant: Plant, *, noise: bool = True) -> Plant:
        """The plant with these periods and, unless its noise was learnt from such readings, resolutions; itself without any."""
        changed: dict[int, Sensor] = {i: replace(plant.sensors[i], period=p) for i, p in self.periods.items()}
        for i, (q, length) in self.coarse.items() if noise else ():
            s = changed.get(i, plant.sensors[i])
            lasting = (min(length, CORRELATED) - 1) * q**2 / 12  # a rounding error that stays as long as the reading does
            own = s.noise_sigma**2 - s.resolution**2 / 12 + lasting
            changed[i] = replace(s, sigma=float(np.sqrt(own)), resolution=q)
        return replace(plant, sensors=tuple(changed.get(i, s) for i, s in enumerate(plant.sensors))) if changed else plant


def regularities(plant: Plant, log: Log) -> Regularities:
    """Find the sensors of a log of one run, y (K, N), that repeat their value, are coarse, or jump by a period that the plant
    does not state, of those that read a variable of the model.
    """
    known = () if plant.cyclic_sensors is None else plant.cyclic_sensors.at.tolist()
    step = float(np.median(np.diff(log.t))) if log.t.size > 1 else plant.dt
    repeats: dict[int, Repeat] = {}
    coarse: dict[int, tuple[float, float]] = {}
    periods: dict[int, float] = {}
    taken: dict[int, int] = {}
    for i, (sensor, column) in enumerate(zip(plant.sensors[: plant.modelled], log.y.T, strict=False)):
        _, _, lengths = equal_readings(column)
        q = resolution(column) if lengths.size < np.sum(lengths) else 0.0  # only where readings are repeated
        if (one := repeat(column, q)) is not None:
            repeats[i], taken[i] = one, int(np.sum(repeated(column, one)))
        lasting = float(np.mean(lengths)) if one is None and lengths.size else 1.0
        own = np.sqrt(sensor.noise_sigma**2 - sensor.resolution**2 / 12)
        if q >= COARSE * own and (q > sensor.resolution * 1.01 or lasting > STAYS):
            coarse[i] = (q, lasting)
        if i not in known and (p := period(column, sensor.unit)) is not None:
            periods[i] = p
    return Regularities(repeats, coarse, periods, taken, step)
