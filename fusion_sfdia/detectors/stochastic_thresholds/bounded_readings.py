"""The effect of bounded errors on readings that are predicted from the present readings: adaptive thresholds for any plant.

Kougiatsos and Reppa 2024 bound the residual of each module of a plant that states its scalar equations (adaptive_threshold).
Here the prediction of `present_readings` has a bound e of the error of each state instead of its variance,

    e+ = |F| e + w,   |y - y_hat| <= |H| e+ + d,   e = |1 - W H| e+ + |W| d        with W the gain, d and w the bounds of noise

This is exact for linear physics. For nonlinear physics it is of first order in the errors and not a guaranteed bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.covariance import diagonal
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.stochastic_thresholds.present_readings import (
    PredictedReadings,
    PresentMemory,
    PresentReadings,
    Taken,
)

Array = NDArray[Any]

ROUNDING = 1e-12  # relative widening of bounds: far more than the rounding of a step
WITHIN = 3.0  # standard deviations, the bound of a noise without a stated bound; chosen here, not published


@dataclass(frozen=True)
class BoundedReadings(PresentReadings):
    """The diagnoser of a plant with the bounds e in its memory; `deviation` is a bound of the residual."""

    @cached_property
    def _noise(self) -> Array:
        """The bounds d (N,)."""
        stated = np.array([s.noise_bound for s in self.plant.sensors])
        return np.where(np.isfinite(stated), stated, WITHIN * self.plant.sensor_sigma)

    def _disturbance(self, dt: float) -> Array:
        """The bounds w (n,) over dt."""
        plant = self.plant
        if plant.process_bound is not None:
            return np.broadcast_to(plant.process_bound, (len(plant.states),)) * (dt / plant.dt)
        return np.asarray(WITHIN * np.sqrt(diagonal(plant.process_cov_over(dt))))

    def start(self, batch: tuple[int, ...], seed: int) -> PresentMemory:
        """As of PresentReadings, with the bound of x0's error."""
        error = WITHIN * np.sqrt(diagonal(self.plant.initial_cov))
        whole = np.broadcast_to(error, (*batch, len(self.plant.states))).copy()
        return super().start(batch, seed)._replace(error=whole)

    def predict(self, memory: PresentMemory, now: TimeStep, u: Array) -> PredictedReadings:
        predicted = super().predict(memory, now, u)
        every = np.ones(predicted.lost.shape, bool)
        F = self._tangent(memory, predicted, now, u, every)
        error = _bounded(F, memory.error) + self._disturbance(now.dt)
        return self._widened(memory, predicted, error)

    def take(self, predicted: PredictedReadings, y: Array) -> Taken:
        taken = super().take(predicted, y)
        W, H = taken.memory.gain, predicted.inner.readout
        kept = np.eye(H.shape[-1]) - W @ H
        error = _bounded(kept, predicted.inner.error) + np.abs(W) @ self._noise
        return taken._replace(memory=taken.memory._replace(error=error))

    def without_faults(
        self, memory: PresentMemory, predicted: PredictedReadings, now: TimeStep, u: Array, size: Array, uncertainty: Array
    ) -> PredictedReadings:
        error = predicted.inner.error
        rows = np.any(size != 0, axis=-1)
        error[rows] += _bounded(self._tangent(memory, predicted, now, u, rows) @ memory.gain[rows], uncertainty[rows])
        return self._widened(memory, super().without_faults(memory, predicted, now, u, size, uncertainty), error)

    def _widened(self, memory: PresentMemory, predicted: PredictedReadings, error: Array) -> PredictedReadings:
        """The predicted readings with bounds of their residuals (B, N) from bounds of the states' errors (B, n)."""
        radius = (_bounded(predicted.inner.readout, error) + self._noise) * (1 + ROUNDING)
        return predicted._replace(deviation=self.lam * memory.deviation + radius, inner=predicted.inner._replace(error=error))


def _bounded(matrix: Array, bound: Array) -> Array:
    """|matrix| bound (..., n) of matrices (..., n, m) and bounds (..., m)."""
    return np.asarray((np.abs(matrix) @ bound[..., None])[..., 0])
