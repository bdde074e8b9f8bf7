"""Common to detectors that learn from healthy readings: checked data, limits at a rate, a Decision without an estimate."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats
from fusion_sfdia.common.order_statistics import order_statistic
from fusion_sfdia.detectors.batch_detector import BatchDetector
from fusion_sfdia.detectors.detector import Decision, require_no_cycles
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.plant.border import possible
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


class LearntFromReadings(BatchDetector):
    """A detector whose limits are learnt from readings: what a plant states of its sensors does not change them."""

    def with_sensors_of(self, plant: Plant) -> Self:
        """The detector itself: what it learnt from healthy readings stays.

        Parameters
        ----------
        plant : Plant
            With other noise, resolutions or periods of its sensors.

        Returns
        -------
        Self
            With the same limits.

        Raises
        ------
        NotApplicableError
            For cyclic sensors.
        """
        require_no_cycles(plant, "limits and relations that are learnt from readings")
        return self


def without_model(
    plant: Plant, y: Array, reconstruction: Array, residual: Array, threshold: Array, isolated: Array
) -> Decision:
    """The Decision of a detector without a model: its estimate is the plant's x0.

    The size of a fault is the reading less its reconstruction.
    """
    batch = y.shape[:-1]
    return Decision(
        estimate=np.broadcast_to(plant.x0, (*batch, plant.x0.size)),
        reconstruction=reconstruction,
        residual=residual,
        threshold=threshold,
        isolated=isolated,
        fault_size=np.where(isolated, y - reconstruction, np.nan),
        diverged=np.zeros(batch, bool),
        guarded=np.zeros(batch, bool),
        nis=np.broadcast_to(np.nan, batch),
    )


def per_sensor(plant: Plant, what: str, value: Array) -> Array:
    """Return finite numbers (N,), one a sensor; ValueError for anything else."""
    value = floats(what, value)
    if value.shape != plant.sensor_sigma.shape or not np.all(np.isfinite(value)):
        raise ValueError(
            f"{what} has shape {value.shape}; expected {len(plant.sensors)} finite numbers, one a sensor of "
            f"plant {plant.name!r}"
        )
    return value


def healthy_readings(plant: Plant, healthy: Any) -> Array:
    """Return healthy readings as (K, B, N), absurd ones as NaN.

    healthy: as `as_log` takes it, or the readings y (K, ..., N) alone, as an array: these detectors use nothing else.
    ValueError for other shapes, infinities, and sensors without a reading in every other sample. A sensor that never moves is
    accepted: a quantised reading at rest is healthy, too. See `noise_floor`.
    """
    y = floats("y", healthy if isinstance(healthy, np.ndarray) else as_log(plant, healthy).y)
    count = len(plant.sensors)
    if y.ndim < 2 or y.shape[-1] != count or y.shape[0] < 4 or not y.size:
        raise ValueError(f"y has shape {y.shape}; expected healthy readings (K, ..., {count}) of at least 4 times")
    if np.isinf(y).any():
        raise ValueError("y has infinite readings; pass NaN for a missing one")
    y = possible(plant, y).reshape(len(y), -1, count)
    read = np.any(np.isfinite(y[::2]), axis=(0, 1)) & np.any(np.isfinite(y[1::2]), axis=(0, 1))
    if not np.all(read):
        names = ", ".join(s.name for s, m in zip(plant.sensors, read, strict=True) if not m)
        raise ValueError(f"the healthy readings of {names} are missing; leave the sensor out or record more")
    return y


def stuck(y: Array) -> Array:
    """Whether the readings y (K, B, N) of each sensor are all the same (N,)."""
    low, high = (f(y, axis=(0, 1)) for f in (np.nanmin, np.nanmax))
    return np.asarray(low == high)


def noise_floor(plant: Plant, y: Array, declared: Array) -> Array:
    """The assumed spread (N,) of sensors that never moved in training: as declared, at least their resolution.

    declared: (N,), of the stated noise of the sensors. The resolution is the smallest step between readings y (K, B, N).
    """
    step = np.abs(np.diff(y, axis=0))
    resolution = np.min(np.where(step > 0, step, np.inf), axis=(0, 1))
    return np.maximum(declared, np.where(np.isfinite(resolution), resolution, 0.0))


def upper_limit(values: Array, rate: float) -> float:
    """The `order_statistic` of healthy values (M,); ValueError where less than one of them is expected above it."""
    if values.size * rate < 1:
        raise ValueError(
            f"{values.size} healthy samples cannot set a limit that one in {1 / rate:.0f} exceeds; give at least that many to "
            "set limits (every other one is used for that), or choose a higher false-alarm rate"
        )
    return float(order_statistic(values, rate))
