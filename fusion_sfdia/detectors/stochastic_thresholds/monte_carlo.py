"""Moments of a nonlinear model by random draws, as B18 suggests (Assumption 4: "Monte Carlo methods")."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fusion_sfdia.common.arguments import Array, whole
from fusion_sfdia.filters import gaussian
from fusion_sfdia.filters.estimators import Conditioned, Core, GaussianState, Moments, Prior
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.filters.guarded_steps import guarded_points, readings_of_points
from fusion_sfdia.filters.sums import symmetric_sum
from fusion_sfdia.plant.plant import Plant


@dataclass(frozen=True)
class MonteCarlo(Conditioned, Moments):
    """Mean and covariance of `draws` Gaussian points; a standard deviation has a relative error of about 1 / sqrt(2 draws).

    The draws of a step depend on seed and time, and are the same for all runs of a batch.
    """

    is_random: ClassVar[bool] = True
    draws: int = 1000

    def __post_init__(self) -> None:
        whole("draws", self.draws, least=2)

    @property
    def consistent(self) -> bool:
        return True

    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        start, moved = plant.guard(core.x)
        points = self._points(start, core.P, rng.standard_normal((self.draws, start.shape[-1])))
        _, ahead, any_moved, stuck, lost = guarded_points(plant, t_start, points, u, dt)
        mean, spread = _centred(ahead)
        p = symmetric_sum(np.swapaxes(spread, -1, -2) @ spread, plant.process_cov_over(dt))
        further = rng.standard_normal((self.draws, start.shape[-1]))  # for `joint`, which has no generator
        return Prior(GaussianState(mean, p), moved | any_moved | stuck, lost, propagated=further)

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        x, p = prior.core
        assert prior.propagated is not None
        points = self._points(x, p, prior.propagated)
        mean, spread = _centred(readings_of_points(plant, t, points, u))
        S = symmetric_sum(np.swapaxes(spread, -1, -2) @ spread, plant.sensor_cov)
        return Joint(x, p, mean, S, np.swapaxes(_centred(points)[1], -1, -2) @ spread)

    def _points(self, x: Array, p: Array, normal: Array) -> Array:
        points: Array = x[..., None, :] + normal @ np.swapaxes(gaussian.square_root(p), -1, -2)
        return points


def _centred(points: Array) -> tuple[Array, Array]:
    """Mean (..., k) of points (..., M, k), and D (..., M, k) with D' D their covariance."""
    mean = np.mean(points, axis=-2)
    return mean, (points - mean[..., None, :]) / np.sqrt(points.shape[-2] - 1)
