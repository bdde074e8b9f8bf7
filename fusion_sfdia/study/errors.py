"""Errors that real plants have: noise and readings unlike those that the plant states, as functions of a seed.

Noise is drawn in units of each sensor's sigma, with variance 1 unless its name states another size, so that only its shape
differs from what the plant states. Readings are made of the signal, which has no noise, and that noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
Generator = np.random.Generator

OUTLIERS, OUTLIER_SIZE = 0.01, 10.0  # share of the readings; sigma
CROSS_TALK = 0.02
SLOW_SENSOR = 10  # rows from one reading of a slow sensor to the next
JITTER = 0.3  # of a step: largest error of a stamp


def white(rng: Generator, shape: tuple[int, int], size: float = 1.0) -> Array:
    """Gaussian noise (K, N) of `size` times the stated standard deviation."""
    return size * rng.standard_normal(shape)


def autoregressive(rng: Generator, shape: tuple[int, int], rho: tuple[float, ...]) -> Array:
    """Stationary noise e_k = rho_1 e_k-1 + rho_2 e_k-2 + ... + w_k, scaled to variance 1.

    It starts so long before the first row that its beginning no longer matters (to 1e-6).
    """
    denominator = [1.0, *(-r for r in rho)]
    lead = int(np.ceil(np.log(1e-6) / np.log(np.max(np.abs(np.roots(denominator))))))
    e = lfilter([1.0], denominator, rng.standard_normal((lead + shape[0], shape[1])), axis=0)[lead:]
    response = lfilter([1.0], denominator, np.eye(1, lead)[0])
    return np.asarray(e / np.sqrt(np.sum(response**2)))


def moving_average(rng: Generator, shape: tuple[int, int], length: int) -> Array:
    """The mean of `length` white values, scaled to variance 1."""
    w = rng.standard_normal((shape[0] + length - 1, shape[1]))
    return np.asarray(np.lib.stride_tricks.sliding_window_view(w, length, axis=0).sum(axis=-1) / np.sqrt(length))


def heavy_tailed(rng: Generator, shape: tuple[int, int], degrees: float = 3.0) -> Array:
    """Student's t of variance 1."""
    return np.asarray(rng.standard_t(degrees, shape) * np.sqrt((degrees - 2) / degrees))


def uniform(rng: Generator, shape: tuple[int, int]) -> Array:
    """Uniform noise of variance 1."""
    return rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), shape)


def with_outliers(rng: Generator, shape: tuple[int, int]) -> Array:
    """White noise, and in `OUTLIERS` of the readings +-`OUTLIER_SIZE` besides."""
    hit = rng.random(shape) < OUTLIERS
    return np.asarray(rng.standard_normal(shape) + hit * OUTLIER_SIZE * rng.choice([-1.0, 1.0], shape))


def with_offsets(rng: Generator, shape: tuple[int, int], size: float = 1.0) -> Array:
    """White noise, and a constant of each sensor from -size to size."""
    return np.asarray(rng.standard_normal(shape) + rng.uniform(-size, size, shape[1]))


def of_changing_size(rng: Generator, shape: tuple[int, int]) -> Array:
    """White noise whose standard deviation goes from the stated one to three times that and back."""
    size = 2.0 - np.cos(2 * np.pi * np.arange(shape[0]) / shape[0])
    return rng.standard_normal(shape) * size[:, None]


Noise = Callable[[Generator, tuple[int, int]], Array]
Reading = Callable[[Generator, Plant, Array, Array], Array]


def added(rng: Generator, plant: Plant, signal: Array, noise: Array) -> Array:
    """Readings y = signal + sigma e (K, N)."""
    return np.asarray(signal + plant.sensor_sigma * noise)


def in_steps(rng: Generator, plant: Plant, signal: Array, noise: Array, size: float) -> Array:
    """Readings in steps of `size` sigma, as of a converter with few bits."""
    step = size * plant.sensor_sigma
    return np.asarray(np.round((signal + plant.sensor_sigma * noise) / step) * step)


def with_cross_talk(rng: Generator, plant: Plant, signal: Array, noise: Array) -> Array:
    """Each reading with `CROSS_TALK` of what the next sensor has changed since the start, in units of their sigmas."""
    sigma = plant.sensor_sigma
    moved = (signal - signal[:1]) / sigma
    return np.asarray(signal + sigma * (noise + CROSS_TALK * np.roll(moved, -1, axis=-1)))


def with_a_late_sensor(rng: Generator, plant: Plant, signal: Array, noise: Array, rows: int = 1) -> Array:
    """A drawn sensor reads what was there `rows` rows before."""
    i, late = int(rng.integers(signal.shape[1])), signal.copy()
    late[rows:, i] = signal[:-rows, i]
    return added(rng, plant, late, noise)


def with_a_slow_sensor(rng: Generator, plant: Plant, signal: Array, noise: Array) -> Array:
    """A drawn sensor has a reading in every `SLOW_SENSOR`-th row alone."""
    i, y = int(rng.integers(signal.shape[1])), added(rng, plant, signal, noise)
    y[np.arange(len(y)) % SLOW_SENSOR != 0, i] = np.nan
    return y


def with_jitter(rng: Generator, plant: Plant, signal: Array, noise: Array) -> Array:
    """Rows that were read up to `JITTER` of a step before or after their stamps."""
    shift = rng.uniform(-JITTER, JITTER, (len(signal), 1))
    before, after = np.concatenate([signal[:1], signal[:-1]]), np.concatenate([signal[1:], signal[-1:]])
    return added(rng, plant, signal + np.where(shift > 0, shift * (after - signal), -shift * (before - signal)), noise)


@dataclass(frozen=True)
class ReadingError:
    """How readings differ from what the plant states: a name, in words, the noise and what is made of it and the signal."""

    name: str
    about: str
    noise: Noise = white
    reading: Reading = added


READING_ERRORS = (
    ReadingError("as-stated", "noise as the plant states it"),
    ReadingError("size-0.3", "standard deviation of 0.3 times the stated one", partial(white, size=0.3)),
    ReadingError("size-3", "standard deviation of 3 times the stated one", partial(white, size=3.0)),
    ReadingError("variance-3", "variance of 3 times the stated one", partial(white, size=3.0**0.5)),
    ReadingError("changing-size", "standard deviation that goes to 3 times the stated one and back", of_changing_size),
    ReadingError("ar-0.5", "first-order autoregressive, 0.5 from row to row", partial(autoregressive, rho=(0.5,))),
    ReadingError("ar-0.8", "first-order autoregressive, 0.8 from row to row", partial(autoregressive, rho=(0.8,))),
    ReadingError("ar-0.95", "first-order autoregressive, 0.95 from row to row", partial(autoregressive, rho=(0.95,))),
    ReadingError("ar-2", "second-order autoregressive, 1.2 and -0.4", partial(autoregressive, rho=(1.2, -0.4))),
    ReadingError("average-5", "moving average of 5 rows", partial(moving_average, length=5)),
    ReadingError("student-3", "Student's t with 3 degrees of freedom", heavy_tailed),
    ReadingError("uniform", "uniform", uniform),
    ReadingError("outliers", "1 % outliers of 10 sigma", with_outliers),
    ReadingError("steps-1", "readings in steps of 1 sigma", reading=partial(in_steps, size=1.0)),
    ReadingError("steps-3", "readings in steps of 3 sigma", reading=partial(in_steps, size=3.0)),
    ReadingError("offsets", "constant offsets within +-1 sigma on all sensors", with_offsets),
    ReadingError("cross-talk", "2 % of the next sensor's changes", reading=with_cross_talk),
    ReadingError("late-sensor", "a sensor a row late", reading=with_a_late_sensor),
    ReadingError("jitter", "stamps up to 0.3 steps off", reading=with_jitter),
    ReadingError("slow-sensor", "a sensor with a reading in every tenth row", reading=with_a_slow_sensor),
)
