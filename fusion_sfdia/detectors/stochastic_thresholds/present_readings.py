"""One diagnoser of a whole plant: the next readings are predicted from the present readings alone.

Boem et al. 2018 ("B18") predict x+ = f(y, u) with y instead of the state, so that old readings do not enter. This module does
the same for every state that a sensor reads directly; several sensors of one state are weighted by their precision, (17). Any
other state, whose sensor is missing, left out or does not exist, is estimated from its past by the Kalman gain. The moments E
and Var of f(x) - f(y) follow from the covariance of the state estimate, which for directly read states is that of their
sensors' noise. With the gain W and the noise covariance R:

    x_bar = x + W (y - E[y]),   P_bar = (1 - W H) P (1 - W H)' + W R W'      for any gain, Joseph's form
    y_hat = E[y+] - lam (y - y_hat),   s+ = lam s + sqrt(Var[y+])             (5), (14)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import repeated
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.health import broken
from fusion_sfdia.filters import ekf, gaussian
from fusion_sfdia.filters.estimators import Estimator, Extended, GaussianState, Prior, Unscented, step_stream
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.filters.guarded_steps import readings_of
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


class PredictedReadings(NamedTuple):
    """Prediction of the readings (B, N).

    expected; deviation: bound of the standard deviation of y - expected, inf where unknown. guarded (B,): the estimate was
    moved into the model's limits. lost (B,): there is no finite estimate. inner: intermediate results of the diagnoser.
    """

    expected: Array
    deviation: Array
    guarded: Array
    lost: Array
    inner: Any


class PresentMemory(NamedTuple):
    """Estimate x_bar (B, n) with covariance P_bar (B, n, n) and the gain W (B, n, N) of its readings.

    residual, deviation (B, N): y - y_hat and s of the last readings, 0 where missing. error: bounds e (B, n) of the error of
    x_bar, (B, 0) for a diagnoser without bounds.
    """

    x: Array
    P: Array
    gain: Array
    residual: Array
    deviation: Array
    error: Array


class Taken(NamedTuple):
    """The memory after readings, and the state estimate (B, n) with its covariance (None for a diagnoser without one)."""

    memory: Any
    estimate: Array
    covariance: Array | None


class ReadingPredictor(Protocol):
    """Predicts and takes readings: AreaDiagnosers (memory: Diagnosers) or PresentReadings (memory: PresentMemory)."""

    def start(self, batch: tuple[int, ...], seed: int) -> Any: ...
    def predict(self, memory: Any, now: TimeStep, u: Array) -> PredictedReadings: ...
    def take(self, predicted: PredictedReadings, y: Array) -> Taken: ...
    def without_faults(
        self, memory: Any, predicted: PredictedReadings, now: TimeStep, u: Array, size: Array, uncertainty: Array
    ) -> PredictedReadings: ...
    def effects(
        self, memory: Any, predicted: PredictedReadings, now: TimeStep, u: Array, rows: Array
    ) -> tuple[Array, Array]: ...


class _Inner(NamedTuple):
    """The prior, and the Jacobian of its readings. joint: None where the tangent gives it when needed. readings (B, N): its
    own. error: bounds of the states' errors (BoundedReadings).
    """

    prior: Prior
    readout: Array
    joint: Joint | None = None
    readings: Array = np.empty(0)
    error: Array | None = None


@dataclass(frozen=True)
class PresentReadings:
    """The diagnoser of a plant; its memory is a PresentMemory."""

    plant: Plant
    lam: float
    moments: Estimator

    @cached_property
    def _direct(self) -> Array:
        """(n, N): H where a sensor reads a state and nothing else, 0 elsewhere."""
        plant = self.plant
        h = plant.output_jacobian_at(0.0, plant.x0, plant.input_at(0.0))
        measures = np.array([[s.measures == x.name for s in plant.sensors] for x in plant.states])
        alone = np.sum(h != 0, axis=1) == 1
        return np.where(measures & alone, np.swapaxes(h, 0, 1), 0.0)

    @cached_property
    def _linear(self) -> bool:
        """Whether every sensor reads a state and nothing else: exact moments of the readings are then those of the tangent."""
        exact = isinstance(self.moments, Extended) or (isinstance(self.moments, Unscented) and self.moments.redraw)
        return exact and bool(np.all(np.any(self._direct != 0, axis=0)))

    def start(self, batch: tuple[int, ...], seed: int) -> PresentMemory:
        """Return the memory at the plant's x0 and initial covariance."""
        n, count = len(self.plant.states), len(self.plant.sensors)
        x = np.broadcast_to(self.plant.x0, (*batch, n)).copy()
        P = np.broadcast_to(gaussian.dense(self.plant.initial_cov), (*batch, n, n)).copy()
        of_sensors = np.zeros((*batch, count))
        return PresentMemory(x, P, np.zeros((*batch, n, count)), of_sensors, of_sensors.copy(), np.zeros((*batch, 0)))

    def predict(self, memory: PresentMemory, now: TimeStep, u: Array) -> PredictedReadings:
        state = GaussianState(memory.x, memory.P)
        prior = self.moments.predict(self.plant, state, now.t_start, u, now.dt, step_stream(now.seed, 2 * now.k))
        inner = _Inner(prior, self.plant.output_jacobian_at(now.t, prior.core.x, u))
        lost = prior.lost | broken(*prior.core)
        predicted = PredictedReadings(np.empty(0), np.empty(0), prior.guarded, lost, inner)
        return self._expecting(predicted, memory.residual, memory.deviation, now.t, u)

    def _expecting(
        self, predicted: PredictedReadings, residual: Array, deviation: Array, t: float, u: Array
    ) -> PredictedReadings:
        """What the prior predicts with these last residuals (B, N) and their deviations."""
        inner = predicted.inner
        if self._linear:
            x, P = inner.prior.core
            inner = inner._replace(readings=readings_of(self.plant, t, x, u))
            variance = np.diagonal(P, axis1=-2, axis2=-1) @ self._direct**2 + self.plant.sensor_cov
        else:
            joint = self.moments.joint(self.plant, inner.prior, t, u)
            inner = inner._replace(readings=joint.y, joint=joint)
            variance = np.diagonal(joint.S, axis1=-2, axis2=-1)
        ahead = inner.readings - self.lam * residual, self.lam * deviation + np.sqrt(variance)
        return predicted._replace(expected=ahead[0], deviation=ahead[1], inner=inner)

    def take(self, predicted: PredictedReadings, y: Array) -> Taken:
        """Return memory and estimate after the readings y (B, N), NaN where missing or left out."""
        used = np.isfinite(y)
        given = np.where(used, y, 0.0)
        noise = self.plant.sensor_cov
        precision = np.where((used[:1] if np.all(used) else used)[..., None, :], self._direct / noise, 0.0)
        total = np.sum(precision * self._direct, axis=-1)
        W = precision / np.where(total > 0, total, 1.0)[..., None]
        estimate = np.sum(W * given[..., None, :], axis=-1)
        W, P = repeated(W, y), repeated((W * noise) @ np.swapaxes(W, -1, -2), y)
        read = np.broadcast_to(total > 0, estimate.shape)
        if np.any(some := ~np.all(read, axis=-1)):
            W, P = W.copy(), P.copy()
            estimate[some], P[some], W[some] = self._filtered(
                predicted.inner, some, y[some], read[some], estimate[some], W[some]
            )
        residual = np.where(used, y - predicted.expected, 0.0)
        deviation = np.where(used, predicted.deviation, 0.0)
        error = np.zeros((*estimate.shape[:-1], 0))
        return Taken(PresentMemory(estimate, P, W, residual, deviation, error), estimate, P)

    def _filtered(
        self, inner: _Inner, some: Array, y: Array, read: Array, estimate: Array, W: Array
    ) -> tuple[Array, Array, Array]:
        """Estimate, covariance and gain of `some` runs (B,) with the Kalman gain for those states that are not `read`."""
        (x, P), readings = (a[some] for a in inner.prior.core), inner.readings[some]
        H = inner.readout[some] if inner.readout.ndim > 2 else inner.readout
        if inner.joint is None:
            joint = ekf.joint(x, P, lambda s: readings, H, self.plant.sensor_cov, self.plant.sparse[1])
        else:
            joint = Joint(x, P, readings, inner.joint.S[some], inner.joint.C[some])
        used = np.isfinite(y)
        U = gaussian.half_inverse(joint.S, used)
        gain = gaussian.gain(joint._replace(considered=self.plant.considered), U @ np.swapaxes(U, -1, -2))
        W = np.where(read[..., None], W, gain)
        innovation = np.where(used, y - readings, 0.0)
        estimate = np.where(read, estimate, x + np.sum(W * innovation[..., None, :], axis=-1))
        kept = np.where(read[..., None], 0.0, np.eye(read.shape[-1]) - W @ H)
        P = kept @ P @ np.swapaxes(kept, -1, -2) + (W * self.plant.sensor_cov) @ np.swapaxes(W, -1, -2)
        return estimate, gaussian.symmetrise(P), W

    def without_faults(
        self, memory: PresentMemory, predicted: PredictedReadings, now: TimeStep, u: Array, size: Array, uncertainty: Array
    ) -> PredictedReadings:
        """Return the prediction without the effect of faults in the last readings; size, uncertainty (B, N), 0 for no fault."""
        rows = np.any(size != 0, axis=-1)
        absorbed = self._tangent(memory, predicted, now, u, rows) @ memory.gain[rows]
        spread = absorbed * uncertainty[rows][..., None, :]
        x, P = (a.copy() for a in predicted.inner.prior.core)
        x[rows] -= np.sum(absorbed * size[rows][..., None, :], axis=-1)
        P[rows] += spread @ np.swapaxes(spread, -1, -2)
        prior = predicted.inner.prior._replace(core=GaussianState(x, P))
        changed = predicted._replace(inner=predicted.inner._replace(prior=prior))
        return self._expecting(changed, np.where(size != 0, 0.0, memory.residual), memory.deviation, now.t, u)

    def _tangent(self, memory: PresentMemory, predicted: PredictedReadings, now: TimeStep, u: Array, rows: Array) -> Array:
        """F (R, n, n) of the runs chosen by `rows`, or (n, n) of all runs."""
        tangent = predicted.inner.prior.tangent
        if tangent is None:
            return self.plant.step_jacobian_at(now.t_start, self.plant.guard(memory.x[rows])[0], u[rows], now.dt)
        chosen: Array = tangent[rows] if tangent.ndim > 2 else tangent
        return chosen

    def effects(
        self, memory: PresentMemory, predicted: PredictedReadings, now: TimeStep, u: Array, rows: Array
    ) -> tuple[Array, Array]:
        """Return, for the R runs chosen by `rows` (B,), the derivative M (R, N, N) of the expected readings by the readings of
        the last step, and L (R, N, N), minus the derivative by its residuals.
        """
        readout = predicted.inner.readout
        H = readout[rows] if readout.ndim > 2 else readout
        from_readings = np.asarray(H @ (self._tangent(memory, predicted, now, u, rows) @ memory.gain[rows]))
        return from_readings, np.broadcast_to(self.lam * np.eye(H.shape[-2]), from_readings.shape)
