"""Detector: combined Shewhart and EWMA charts of each reading, learned from healthy data, and a limit on its change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, probability
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.data_driven.fixed_limits import FixedLimits, largest
from fusion_sfdia.detectors.data_driven.healthy_limits import (
    LearntFromReadings,
    healthy_readings,
    per_sensor,
    stuck,
    upper_limit,
    without_model,
)
from fusion_sfdia.detectors.detector import Decision, require_no_cycles
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


class EwmaLimitsMemory(NamedTuple):
    """For each sensor (..., N): the last reading, NaN where missing, and the last within its limits, at first the centre; the
    average z of its level, and the number n of readings in it.
    """

    last: Array
    trusted: Array
    average: Array
    samples: Array


@dataclass(frozen=True, eq=False)
class EwmaLimits(LearntFromReadings):
    """Three checks of each sensor: its level e = y - centre, its change from one reading to the next, and, for small faults
    that last, an exponentially weighted moving average of its level (Lucas and Saccucci 1990):

        z_n = (1 - weight) z_(n-1) + weight e_n    z_0 = 0    |z_n| <= average sqrt(1 - (1 - weight)^(2n))

    n counts the readings of the sensor; missing ones leave z as it was. The last factor is the growth of the deviation of z
    for white noise; for levels that vary slowly it is conservative. A level beyond its limit enters the average as that
    limit: the check of the level detects it, and the average returns quickly after it ends.

    Parameters
    ----------
    centre : array (N,)
        In sensor units, as the limits.
    level : array (N,)
        Limit of |y - centre|.
    change : array (N,)
        Limit of the change from one reading to the next.
    average : array (N,)
        Limit of the average once it has settled.
    weight : float, default 0.2
        Of the present reading in the average.

    Notes
    -----
    The residual is that of the check with the largest ratio to its limit, with its sign. Every sensor beyond a limit is
    isolated. reconstruction: the last reading within the limits, at first the centre, in place of missing and violating ones.
    fault_size: reading less reconstruction. No state is estimated: estimate is the plant's x0.

    Examples
    --------
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.detectors import EwmaLimits
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> limits = EwmaLimits.fit(plant, simulate(plant, 400, seeds=range(4), process_noise=True), false_alarm=0.01)
    >>> limits.average.shape, bool((limits.average < limits.level).all())
    ((4,), True)
    """

    estimates: ClassVar[bool] = False

    centre: Array
    level: Array
    change: Array
    average: Array
    weight: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        require_no_cycles(self.plant, "limits of readings and of their changes")
        for what in ("centre", "level", "change", "average"):
            value = per_sensor(self.plant, what, getattr(self, what))
            if what != "centre" and not np.all(value > 0):
                raise ValueError(f"{what} has limits of {value.min():g} and more; expected positive ones; use EwmaLimits.fit")
            object.__setattr__(self, what, value)
        object.__setattr__(self, "weight", smoothing(self.weight))

    @classmethod
    def fit(cls, plant: Plant, healthy: Any, false_alarm: float = 1e-3, *, weight: float = 0.2, **settings: Any) -> Self:
        """Limits from healthy readings, at a rate of false alarms per step over all sensors.

        Centre, level and change are those of `FixedLimits.fit` at two thirds of the rate. The limit of the average has the last
        third, in the same way: a unit of the sensor, its largest average in every other sample in time, times the order
        statistic of the largest average of all sensors in their units in the other samples.

        Parameters
        ----------
        plant : Plant
            The model, for the names, noise and resolutions of its sensors.
        healthy : Recording, Log, frame or tuple
            See `healthy_readings`.
        false_alarm : float, default 1e-3
            The rate.
        weight : float, default 0.2
            Of the present reading in the average.
        **settings
            Of the detector, by name.

        Returns
        -------
        Self
            The fitted detector.

        Raises
        ------
        ValueError
            As of `FixedLimits.fit`.
        """
        probability("false_alarm", false_alarm)
        weight = smoothing(weight)
        y = healthy_readings(plant, healthy)
        fixed = FixedLimits.fit(plant, y, false_alarm * 2 / 3)
        z, n, averages = np.zeros(y.shape[1:]), np.zeros(y.shape[1:]), np.empty_like(y)
        for k, now in enumerate(y):
            z, n = averaged(z, n, np.clip(now - fixed.centre, -fixed.level, fixed.level), weight)
            averages[k] = np.where(np.isfinite(now), np.abs(z) / growth(n, weight), np.nan)
        still = stuck(y[::2])
        unit = largest(averages[::2], fixed.level * np.sqrt(weight / (2 - weight)), still)  # of a limit of white noise
        worst = np.max(np.nan_to_num(averages[1::2] / unit, nan=-1.0), axis=-1)
        factor = upper_limit(worst[worst >= 0], false_alarm / 3)
        average = np.where(still, max(factor, 1.0), factor) * unit
        return cls(plant, fixed.centre, fixed.level, fixed.change, average, weight, fitted_rate=false_alarm, **settings)

    def _start(self, batch: tuple[int, ...], seed: int) -> EwmaLimitsMemory:
        shape = (*batch, len(self.centre))
        trusted = np.broadcast_to(self.centre, shape).copy()
        return EwmaLimitsMemory(np.full(shape, np.nan), trusted, np.zeros(shape), np.zeros(shape))

    def _judge(self, memory: EwmaLimitsMemory, now: TimeStep, y: Array, u: Array) -> tuple[EwmaLimitsMemory, Decision]:
        known = np.isfinite(y)
        level = np.clip(y - self.centre, -self.level, self.level)
        z, n = averaged(memory.average, memory.samples, level, self.weight)
        residuals = np.stack([y - self.centre, y - memory.last, np.where(known, z, np.nan)])
        limits = np.stack(np.broadcast_arrays(self.level, self.change, self.average * growth(n, self.weight)))
        largest = np.argmax(np.nan_to_num(np.abs(residuals) / limits, nan=-1.0), axis=0)[None]
        residual, limit = (np.take_along_axis(a, largest, axis=0)[0] for a in (residuals, limits))
        threshold = limit * self.threshold_scale
        isolated = np.abs(residual) > threshold
        reconstruction = np.where(known & ~isolated, y, memory.trusted)
        decision = without_model(self.plant, y, reconstruction, residual, threshold, isolated)
        return EwmaLimitsMemory(y.copy(), reconstruction, z, n), decision


def smoothing(weight: float) -> float:
    """Return the weight of a present reading; ValueError unless it is above 0 and below 1."""
    if not 0 < (value := number("weight", weight)) < 1:
        raise ValueError(f"weight is {weight}; expected the share of the present reading, above 0 and below 1")
    return value


def averaged(z: Array, n: Array, level: Array, weight: float) -> tuple[Array, Array]:
    """Z and n after levels, NaN where missing."""
    known = np.isfinite(level)
    return np.where(known, (1 - weight) * z + weight * np.nan_to_num(level), z), n + known


def growth(n: Array, weight: float) -> Array:
    """The standard deviation of z after n readings of white noise, over that after many; 1 before any."""
    return np.where(n > 0, np.sqrt(1 - (1 - weight) ** (2 * n)), 1.0)
