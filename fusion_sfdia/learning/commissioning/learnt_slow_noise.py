"""Slow noise of sensors, from the leave-one-out innovations of a healthy log.

Of white noise with a slow part of the share s and the correlation q from sample to sample the spectrum is

    f(w) = v ((1 - s) + s (1 - q^2) / (1 - 2 q cos w + q^2))

s and q are those of greatest likelihood of the periodogram I, -sum (ln f + I / f) (Whittle 1953), v its mean of I / f. Whatever
makes the innovations slow, the noise, the equations or a parameter that wanders, makes sums over them vary as much.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.slow_noise import SlowNoise

Array = NDArray[Any]

SHARES = np.linspace(0.05, 0.95, 19)
SLOWEST = 8.0  # time constants in the log, at least, of what can be learnt
RATIO = 13.8  # of likelihoods, twice its logarithm: chance exceeds it in 1 of 1000 logs (chi-square, 2 degrees of freedom)
LEAST = 64  # samples


def slow_noise(single: Array, dt: float) -> SlowNoise | None:
    """The slow part of a sensor's noise, from innovations (K, B) of runs, NaN where missing; None where it shows none."""
    length = single.shape[0]
    runs = int(np.sum(np.isfinite(single).any(axis=0)))
    if length < LEAST or not runs:
        return None
    e = np.nan_to_num(single - np.nanmean(single))
    periodogram = np.mean(np.abs(np.fft.rfft(e, axis=0)[1:]) ** 2, axis=-1) / length
    angle = 2 * np.pi * np.arange(1, periodogram.size + 1) / length
    times = np.geomspace(0.5, length / SLOWEST, 40)  # time constants, in samples
    q, s = np.exp(-1 / times)[:, None, None], SHARES[:, None]
    f = (1 - s) + s * (1 - q**2) / (1 - 2 * q * np.cos(angle) + q**2)
    deviance = np.sum(np.log(f), axis=-1) + angle.size * np.log(np.mean(periodogram / f, axis=-1))
    white = angle.size * float(np.log(np.mean(periodogram)))
    if not 2 * runs * (white - np.min(deviance)) > RATIO:
        return None
    j, i = np.unravel_index(np.argmin(deviance), deviance.shape)
    return SlowNoise(float(SHARES[i]), float(times[j] * dt))


def with_slow_noise(plant: Plant, single: Array) -> Plant:
    """The plant with the slow noise that innovations (K, B, N) of its sensors show; of one that shows none as it is stated."""
    with np.errstate(invalid="ignore"):
        found = [slow_noise(single[..., i], plant.dt) for i in range(single.shape[-1])]
    return replace(plant, sensors=tuple(replace(s, noise=n or s.noise) for s, n in zip(plant.sensors, found, strict=True)))
