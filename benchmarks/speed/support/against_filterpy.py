"""filterpy on the workloads of the benchmark, each filter called as in its documentation.

filterpy's functions take one state at a time. `numpy_model` is a typical model for filterpy: NumPy array
expressions for one state, its Jacobian by the complex step for all columns at once. `compiled_model` hands filterpy our
compiled step and Jacobian instead, so that what remains is the filter alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import EnsembleKalmanFilter, ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.filters.gaussian import dense
from fusion_sfdia.models.gas_pipeline.physics import pipeline_parameters, pipeline_physics
from fusion_sfdia.plant.integration import runge_kutta_4
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
Call = Callable[[], Array]

MEMBERS = 40
POINTS = {"alpha": 1e-3, "beta": 2.0, "kappa": 0.0}


class Model(NamedTuple):
    """A step of one state x (n,) and its Jacobian (n, n); the Jacobian serves the extended filter only."""

    step: Callable[[Array], Array]
    jacobian: Callable[[Array], Array]


def compiled_model(plant: Plant, u: Array) -> Model:
    """Our own model under the input u (m,)."""
    return Model(lambda x: plant.step(0.0, x, u, plant.dt), lambda x: plant.step_jacobian_at(0.0, x, u, plant.dt))


def numpy_model(plant: Plant, u: Array) -> Model:
    """The gas pipeline under the input u (3,) in NumPy: one Runge-Kutta step of the semi-discrete equations."""
    nodes, dt = len(plant.states) // 3, plant.dt
    physics = pipeline_physics(nodes, pipeline_parameters())
    reached = [0, 2 * nodes, 2 * nodes - 1]

    def step(x: Array) -> Array:
        rates = (u - x[..., reached]) / dt
        return runge_kutta_4(lambda t, p: physics.f(t, p, p[..., :0], rates, physics.parameters), 0.0, x, dt)

    if not np.allclose(step(plant.x0), plant.step(0.0, plant.x0, u, dt), rtol=1e-9):
        raise ArithmeticError(
            f"the NumPy step and that of {plant.name!r} differ at x0; give the plant one substep and its usual pipe"
        )
    return Model(step, lambda x: complex_step_jacobian(step, x))


class _OneStepModel(ExtendedKalmanFilter):  # type: ignore[misc]
    """The extended filter with a nonlinear step: what filterpy asks its users to override."""

    model: Model
    x: Array

    def predict_x(self, u: Array | int = 0) -> None:
        self.F = self.model.jacobian(self.x)
        self.x = self.model.step(self.x)


def step_call(kind: str, plant: Plant, model: Model, y: Array, without: int | None = None) -> Call:
    """Return a call that repeats predict and update from the plant's x0, P0 and gives the estimate (n,).

    kind: "ekf", "ukf" (which draws its points again before the reading) or "enkf" (40 members, drawn once from numpy's
    global generator, as all of filterpy's numbers). y (N,): the readings, of which `without` is left out.
    """
    keep = np.delete(np.arange(y.size), [] if without is None else without)
    H = plant.output_jacobian_at(0.0, plant.x0, np.zeros(len(plant.inputs)))[keep]
    P0, Q, R, z = dense(plant.initial_cov), dense(plant.process_cov), np.diag(plant.sensor_cov[keep]), y[keep]
    n, dt = plant.x0.size, plant.dt
    if kind == "ekf":
        ekf = _OneStepModel(n, z.size)
        ekf.model, ekf.Q, ekf.R = model, Q, R

        def extended() -> Array:
            ekf.x, ekf.P = plant.x0, P0
            ekf.predict()
            ekf.update(z, lambda x: H, lambda x: x[keep])
            return ekf.x

        return extended
    if kind == "ukf":
        ukf = UnscentedKalmanFilter(
            n, z.size, dt, hx=lambda x: x[keep], fx=lambda x, dt: model.step(x), points=MerweScaledSigmaPoints(n, **POINTS)
        )
        ukf.Q, ukf.R = Q, R

        def unscented() -> Array:
            ukf.x, ukf.P = plant.x0, P0
            ukf.predict()
            ukf.update(z)
            return np.asarray(ukf.x)

        return unscented
    enkf = EnsembleKalmanFilter(plant.x0, P0, z.size, dt, MEMBERS, hx=lambda x: x[keep], fx=lambda x, dt: model.step(x))
    enkf.Q, enkf.R = Q, R
    members = enkf.sigmas.copy()

    def ensemble() -> Array:
        enkf.sigmas = members.copy()
        enkf.predict()
        enkf.update(z)
        return np.asarray(enkf.x)

    return ensemble
