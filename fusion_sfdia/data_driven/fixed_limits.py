"""Detector: fixed limits on readings and their rates of change, learnt from healthy data: what plants have without a model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import probability
from fusion_sfdia.core.batch_detector import BatchDetector, Moment
from fusion_sfdia.core.detector import Decision, State
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.data_driven.healthy_limits import healthy_readings, per_sensor, upper_limit, without_model

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class FixedLimits(BatchDetector):
    """Two checks of each sensor, with the limits of `fit`: its level |y - centre|, and its change |y - y_before| from one
    reading to the next, whatever the time between them (not checked after a missing reading).

    centre, level, change: (N,) in sensor units. The residual is that of the check with the larger ratio to its limit, with
    its sign. Every sensor beyond a limit is named, in that step: a fault that stays within the level limit shows by its
    onset and its end alone. measured: the last good reading, at first the centre, in place of missing and violating ones.
    fault_size: reading less measured. No state is estimated: estimate is the plant's x0.

    Limits do not know the operating point: they hold all healthy readings of an operation that moves, and hide every fault
    smaller than that movement.
    """

    centre: Array
    level: Array
    change: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        for what in ("centre", "level", "change"):
            value = per_sensor(self.plant, what, getattr(self, what))
            if what != "centre" and not np.all(value > 0):
                raise ValueError(f"{what} has limits of {value.min():g} and more; wanted positive ones, as of FixedLimits.fit")
            object.__setattr__(self, what, value)

    @classmethod
    def fit(cls, plant: Plant, y: Array, false_alarm: float = 1e-3) -> FixedLimits:
        """Limits from healthy readings y (K, ..., N), NaN where missing, at a rate of false alarms per step over all sensors.

        The centre is the mean. A limit is a unit of the sensor times a factor of its quantity. Of every other sample in time:
        the sensor's largest deviation is its unit. Of the rest: the factor is an order statistic of the largest deviation of
        the quantity's sensors in their units. The two checks of each quantity share the rate equally (Bonferroni). ValueError
        where the data are too few for the rate, or a sensor was never read or never moved.
        """
        probability("false_alarm", false_alarm)
        y = healthy_readings(plant, y)
        share = false_alarm / (2 * len(plant.quantities))
        centre = np.nanmean(y[::2], axis=(0, 1))
        level, change = (_limits(plant, np.abs(d), share) for d in (y - centre, np.diff(y, axis=0)))
        return cls(plant, centre, level, change)

    def _start(self, batch: tuple[int, ...], seed: int) -> State:
        shape = (*batch, len(self.centre))
        return np.full(shape, np.nan), np.broadcast_to(self.centre, shape).copy()

    def _judge(self, core: State, now: Moment, y: Array, u: Array) -> tuple[State, Decision]:
        before, good = core
        level, change = y - self.centre, y - before
        faster = np.abs(change) / self.change > np.abs(level) / self.level  # not so where NaN
        residual = np.where(faster, change, level)
        threshold = np.where(faster, self.change, self.level) * self.threshold_scale
        isolated = np.abs(residual) > threshold
        measured = np.where(np.isfinite(y) & ~isolated, y, good)
        return (y.copy(), measured), without_model(self.plant, y, measured, residual, threshold, isolated)


def _limits(plant: Plant, deviation: Array, share: float) -> Array:
    unit = np.nanmax(deviation[::2], axis=(0, 1))
    ratio = np.where(np.isfinite(deviation[1::2]), deviation[1::2] / unit, -np.inf).reshape(-1, unit.size)
    limits = np.empty(unit.size)
    for members in plant.quantities.values():
        largest = np.max(ratio[:, members], axis=1)
        limits[members] = unit[members] * upper_limit(largest[largest >= 0], share)
    return limits
