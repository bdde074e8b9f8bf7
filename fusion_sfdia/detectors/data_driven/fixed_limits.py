"""Detector: fixed limits on readings and their rates of change, learned from healthy data, as usual in plants without a
model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.common.arguments import floats, probability
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.data_driven.healthy_limits import (
    LearntFromReadings,
    healthy_readings,
    noise_floor,
    per_sensor,
    stuck,
    upper_limit,
    without_model,
)
from fusion_sfdia.detectors.detector import Decision, check_reading, require_no_cycles
from fusion_sfdia.detectors.state import State
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

BLOCK = 10_000  # samples: what is computed in between takes as much memory again


class FixedLimitsMemory(NamedTuple):
    """For each sensor (..., N): the last reading, NaN where missing, and the last within its limits, at first the centre."""

    last: Array
    trusted: Array


@dataclass(frozen=True, eq=False)
class FixedLimits(LearntFromReadings):
    """Two checks of each sensor, with the limits of `fit`: its level |y - centre|, and its change |y - y_before| from one
    reading to the next, whatever the time between them (not checked after a missing reading).

    Parameters
    ----------
    centre : array (N,)
        In sensor units, as the limits.
    level : array (N,)
        Limit of |y - centre|.
    change : array (N,)
        Limit of |y - y_before|.

    Notes
    -----
    The residual is that of the check with the larger ratio to its limit, with its sign. Every sensor beyond a limit is isolated
    in that step: a fault that stays within the level limit shows only at its onset and its end. reconstruction: the last good
    reading, at first the centre, in place of missing and violating ones. fault_size: reading less reconstruction. No state is
    estimated: estimate is the plant's x0.

    Limits do not depend on the operating point: they contain all healthy readings of a varying operation, and faults smaller
    than that variation are not detected.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.detectors import FixedLimits
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> limits = FixedLimits(plant, centre=np.ones(4), level=np.full(4, 0.1), change=np.full(4, 0.05))
    >>> state, decision = limits.step(limits.init(), 5.0, np.array([1.0, 1.2, 1.0, np.nan]), plant.input_at(0.0))
    >>> decision.isolated, decision.reconstruction
    (array([False,  True, False, False]), array([1., 1., 1., 1.]))
    """

    estimates: ClassVar[bool] = False

    centre: Array
    level: Array
    change: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        require_no_cycles(self.plant, "limits of readings and of their changes")
        for what in ("centre", "level", "change"):
            value = per_sensor(self.plant, what, getattr(self, what))
            if what != "centre" and not np.all(value > 0):
                raise ValueError(f"{what} has limits of {value.min():g} and more; expected positive ones; use FixedLimits.fit")
            object.__setattr__(self, what, value)

    @classmethod
    def fit(cls, plant: Plant, healthy: Any, false_alarm: float = 1e-3, **settings: Any) -> Self:
        """Limits from healthy readings, at a rate of false alarms per step over all sensors.

        The centre is the mean. A limit is a unit of the sensor and the check times a common factor. The unit is the largest
        deviation in every other sample in time. A sensor that never moved there gets that of as many readings with its stated
        noise (its bound, or a quantile of its sigma), at least its resolution. The factor is the order statistic, at that rate,
        of the largest deviation of all sensors and both checks in these units, over the other samples. So 2 / false_alarm
        samples set limits for any number of sensors.

        Parameters
        ----------
        plant : Plant
            The model, for the names, noise and resolutions of its sensors.
        healthy : Recording, Log, frame or tuple
            See `healthy_readings`.
        false_alarm : float, default 1e-3
            The rate.
        **settings
            Of the detector, by name.

        Returns
        -------
        Self
            The fitted detector.

        Raises
        ------
        ValueError
            Where the data are fewer, or a sensor was never read.
        """
        probability("false_alarm", false_alarm)
        y = healthy_readings(plant, healthy)
        centre = np.nanmean(y[::2], axis=(0, 1))
        level, change = np.abs(y - centre), np.abs(np.diff(y, axis=0))
        # a change belongs to the sample at which it ends: even samples train, odd ones judge
        still, sigma = stuck(y[::2]), plant.sensor_sigma
        extreme = -ndtri(0.5 / y[::2, :, 0].size) * sigma
        bound = np.array([s.noise_bound for s in plant.sensors])
        floors = [noise_floor(plant, y, np.minimum(n * extreme, m * bound)) for n, m in ((1.0, 1.0), (np.sqrt(2.0), 2.0))]
        unit = [largest(d, f, still) for d, f in zip((level[::2], change[1::2]), floors, strict=True)]
        worst = np.maximum(
            np.max(np.nan_to_num(level[1::2] / unit[0], nan=-1.0), axis=-1),
            np.max(np.nan_to_num(change[::2] / unit[1], nan=-1.0), axis=-1),
        )
        factor = upper_limit(worst[worst >= 0], false_alarm)
        factors = np.where(still, max(factor, 1.0), factor)
        return cls(plant, centre, factors * unit[0], factors * unit[1], fitted_rate=false_alarm, **settings)

    def _start(self, batch: tuple[int, ...], seed: int) -> FixedLimitsMemory:
        shape = (*batch, len(self.centre))
        return FixedLimitsMemory(np.full(shape, np.nan), np.broadcast_to(self.centre, shape).copy())

    def _judge(self, memory: FixedLimitsMemory, now: TimeStep, y: Array, u: Array) -> tuple[FixedLimitsMemory, Decision]:
        residual, threshold, isolated = self._checked(memory.last, y)
        reconstruction = np.where(np.isfinite(y) & ~isolated, y, memory.trusted)
        decision = without_model(self.plant, y, reconstruction, residual, threshold, isolated)
        return FixedLimitsMemory(y.copy(), reconstruction), decision

    def _checked(self, last: Array, y: Array) -> tuple[Array, Array, Array]:
        """Residual, threshold and whether it is exceeded, of readings y (..., N) after the `last` ones (..., N)."""
        level, change = y - self.centre, y - last
        faster = np.abs(change) / self.change > np.abs(level) / self.level  # not so where NaN
        residual = np.where(faster, change, level)
        threshold = np.where(faster, self.change, self.level) * self.threshold_scale
        return residual, threshold, np.abs(residual) > threshold

    def steps(self, state: State, t: Array, y: Array, u: Array) -> tuple[State, Decision]:
        """The steps through all rows of one run at once: the same bits as `step` for each.

        A check needs the reading before, a reconstruction the last good one, whatever lies between.

        Parameters
        ----------
        state : State
            Before the first row.
        t : array (K,)
            Times in s.
        y : array (K, N)
            Readings, NaN where missing.
        u : array (K, m)
            Inputs that acted until then.

        Returns
        -------
        state : State
            After the last row.
        decisions : Decision
            Its arrays have the time as first axis.

        Raises
        ------
        ValueError
            As of `step`.
        """
        if self._batch_of(state) != () or not len(t):
            raise ValueError("steps takes one run of at least one time; use step for a batch of runs")
        times = np.concatenate([[float(state.t)], floats("t", t)])
        gaps = np.diff(times)
        for gap in (gaps.min(), gaps.max()) if np.isfinite(gaps).all() else (np.nan,):
            self.plant.check_dt(float(gap))
        given = floats("y", y)
        y, applied = check_reading(self.plant, given, u, (len(t),))
        memory, limits = state.memory, self._input_limits
        u = applied.copy()
        for k in np.flatnonzero(np.any((u < limits.low) | (u > limits.high), axis=-1)):
            u[k] = limits.applied(float(times[k]), float(gaps[k]), applied[k])
        residual, threshold, reconstruction, isolated = (np.empty(y.shape, kind) for kind in (float, float, float, bool))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for begin in range(0, len(t), BLOCK):
                part = slice(begin, begin + BLOCK)
                now = y[part]
                before = np.concatenate([memory.last[None], now[:-1]])
                residual[part], threshold[part], isolated[part] = self._checked(before, now)
                good = np.isfinite(now) & ~isolated[part]
                latest = np.maximum.accumulate(np.where(good, np.arange(len(now))[:, None], -1), axis=0)
                known = np.take_along_axis(now, np.maximum(latest, 0), axis=0)
                reconstruction[part] = np.where(latest >= 0, known, memory.trusted)
                memory = FixedLimitsMemory(now[-1], reconstruction[part][-1])
            decision = without_model(self.plant, y, reconstruction, residual, threshold, isolated)
        found = replace(
            decision, capped=np.zeros(len(t), bool), absurd=np.isnan(y) & ~np.isnan(given), absurd_input=u != applied
        )
        after = FixedLimitsMemory(memory.last.copy(), memory.trusted.copy())
        return State(state.seed, np.array(state.steps + len(t)), np.array(times[-1]), state.diverged, state.far, after), found


def largest(deviation: Array, floor: Array, still: Array) -> Array:
    """The largest deviation (K, B, N) of each sensor, its floor where it never moved or is not known."""
    found = np.max(np.where(np.isfinite(deviation), deviation, 0.0), axis=(0, 1), initial=0.0)
    return np.asarray(np.where(still | (found == 0), floor, found))
