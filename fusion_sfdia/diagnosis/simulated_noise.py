"""Simulated noise of sensors and processes: Gaussian, uniform or truncated, one stream of random numbers a seed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import ndtr, ndtri

from fusion_sfdia.common.covariance import diagonal
from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor

Array = NDArray[Any]


def square_root(cov: Array) -> Array:
    """L with L L' = cov, for a positive semi-definite matrix."""
    scale = np.sqrt(np.where(np.diagonal(cov) > 0, np.diagonal(cov), 1.0))
    values, vectors = np.linalg.eigh(cov / np.outer(scale, scale))
    half: Array = scale[:, None] * vectors * np.sqrt(np.clip(values, 0.0, None))
    return half


def _unit(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Uniform numbers inside (0, 1), so that any quantile of them is finite."""
    return (rng.integers(0, 2**52, shape) + 0.5) / 2**52


def _quantile(uniform: Array, sigma: Array, bound: Array) -> Array:
    """Noise (..., N) by inversion: Gaussian, truncated to the bound; uniform within it where sigma is inf."""
    gaussian = np.isfinite(sigma)
    scale = np.where(gaussian & (sigma > 0), sigma, 1.0)
    beyond = ndtr(-bound / scale)  # each tail's share
    truncated = np.where(gaussian, sigma, 0.0) * ndtri(beyond + uniform * (1 - 2 * beyond))
    even = np.where(gaussian, 0.0, bound) * (2 * uniform - 1)
    return np.asarray(np.where(gaussian, np.clip(truncated, -bound, bound), even))


def sensor_noise(sensors: tuple[Sensor, ...], seeds: tuple[int, ...], steps: int, dt: float) -> Array:
    """Noise (K, B, N) of readings every dt seconds."""
    uniform = np.stack([_unit(stream(s, "measurement noise"), (steps, len(sensors))) for s in seeds], axis=1)
    for i, slow in enumerate(s.noise for s in sensors):
        if slow is not None:
            q = np.exp(-dt / slow.time_constant)
            own = ndtri(np.stack([_unit(stream(s, f"slow noise of {sensors[i].name}"), (steps,)) for s in seeds], axis=1))
            own[1:] *= np.sqrt(1 - q**2)
            wandering = lfilter([1.0], [1.0, -q], own, axis=0)
            uniform[..., i] = ndtr(np.sqrt(1 - slow.share) * ndtri(uniform[..., i]) + np.sqrt(slow.share) * wandering)
    sigma = np.array([np.inf if s.sigma is None else s.sigma for s in sensors])
    return _quantile(uniform, sigma, np.array([np.inf if s.bound is None else s.bound for s in sensors]))


class ProcessNoise:
    """Process noise of a plant, one stream a seed; each step takes the next numbers of every stream."""

    def __init__(self, plant: Plant, seeds: tuple[int, ...]) -> None:
        self.plant = plant
        self.streams = [stream(s, "process noise") for s in seeds]
        if plant.process_bound is not None and plant.process_cov.ndim == 2:
            raise ValueError(f"plant {plant.name!r} has a process bound and a full process_cov; give variances or no bound")

    def over(self, dt: float) -> Array:
        """Noise (B, 1, n) of a step of dt seconds: its covariance and its bound grow in proportion to dt."""
        plant = self.plant
        uniform = np.stack([_unit(r, (1, plant.x0.size)) for r in self.streams])
        cov = plant.process_cov_over(dt)
        if cov.ndim == 2:
            return np.asarray(ndtri(uniform) @ square_root(cov).T)
        sigma = np.sqrt(diagonal(cov))
        if plant.process_bound is None:
            return np.asarray(sigma * ndtri(uniform))
        bound = np.broadcast_to(plant.process_bound, sigma.shape) * (dt / plant.dt)
        return _quantile(uniform, np.where((sigma == 0) & (bound > 0), np.inf, sigma), bound)
