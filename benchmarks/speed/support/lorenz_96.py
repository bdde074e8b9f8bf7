"""The workload on which filter libraries are compared: Lorenz-96 with 63 states, all read, one Runge-Kutta step, one update.

    dx_i/dt = (x_{i+1} - x_{i-2}) x_{i-1} - x_i + F    (Lorenz 1996), F = 8

Two implementations of the same right-hand side: np.roll, the usual one, as costly for one state as for a hundred, and one
gather of neighbours, some three times cheaper for a single state. The cost of a call decides how much slower a filter is that
calls its model state by state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.speed.support.against_filterpy import MEMBERS, Model, step_call
from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.filters import ekf, enkf, ukf
from fusion_sfdia.filters.gaussian import condition
from fusion_sfdia.plant.discretise import discretise
from fusion_sfdia.plant.physics import Physics
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]
Call = Callable[[], Array]

SIZE, FORCING, DT = 63, 8.0, 0.05
AHEAD, BEHIND, FAR = (np.roll(np.arange(SIZE), shift) for shift in (-1, 1, 2))


def rolled(t: float, x: Array, z: Array, u: Array, c: float) -> Array:
    """The right-hand side for states (..., 63) by np.roll."""
    return (np.roll(x, -1, -1) - np.roll(x, 2, -1)) * np.roll(x, 1, -1) - x + c


def gathered(t: float, x: Array, z: Array, u: Array, c: float) -> Array:
    """The same by indices."""
    return (x.take(AHEAD, -1) - x.take(FAR, -1)) * x.take(BEHIND, -1) - x + c


MODELS = {"np.roll": rolled, "indices": gathered}


def lorenz_96(model: str = "np.roll") -> Plant:
    """Return the workload as a plant: x0 near the rest state, sigma 1 of every reading, Q = 0.01."""
    states = tuple(Signal(f"x{i}") for i in range(SIZE))
    return discretise(
        Physics("lorenz-96", states, MODELS[model], parameters=FORCING),
        [Sensor(f"z{i}", f"x{i}", sigma=1.0) for i in range(SIZE)],
        dt=DT,
        x0=FORCING + 0.1 * np.sin(np.arange(SIZE)),
        initial_cov=np.ones(SIZE),
        process_cov=np.full(SIZE, 0.01),
    )


def pairs(kind: str, model: str) -> tuple[Call, Call]:
    """Return predict and update of this package and of filterpy, each giving its estimate (63,).

    kind: "kf", "ukf" or "enkf"; model: one of MODELS. For "kf" the tangent of the step is the constant matrix of both, and
    neither calls the model.
    """
    plant, nothing = lorenz_96(model), np.empty(0)
    y = plant.x0 + np.cos(np.arange(SIZE))
    x, P, Q, R = plant.x0, np.diag(plant.initial_cov), plant.process_cov, plant.sensor_cov
    H = np.eye(SIZE)

    def step(s: Array) -> Array:
        return plant.step(0.0, s, nothing, DT)

    if kind == "kf":
        F = complex_step_jacobian(step, x)
        theirs = KalmanFilter(SIZE, SIZE)
        theirs.F, theirs.H, theirs.Q, theirs.R = F, H, np.diag(Q), np.diag(R)

        def linear() -> Array:
            mean, cov = ekf.predict(x, P, lambda s: F @ s, F, Q)
            return condition(ekf.joint(mean, cov, lambda s: H @ s, H, R), y).x

        def linear_filterpy() -> Array:
            theirs.x, theirs.P = x, P
            theirs.predict()
            theirs.update(y)
            return np.asarray(theirs.x)

        return linear, linear_filterpy
    filterpy = step_call(kind, plant, Model(step, lambda s: complex_step_jacobian(step, s)), y)
    if kind == "ukf":
        points = ukf.SigmaPoints()

        def unscented() -> Array:
            mean, cov, _ = ukf.predict(points, x, P, step, Q)
            return condition(ukf.joint(points, mean, cov, lambda s: s, R), y).x

        return unscented, filterpy
    settings, rng = enkf.EnKFSettings(MEMBERS), np.random.default_rng(0)
    members = x + rng.standard_normal((MEMBERS, SIZE))

    def ensemble() -> Array:
        members_after = enkf.update(settings, enkf.predict(members, step, Q, rng), lambda s: s, y, R, rng)
        return np.asarray(np.mean(members_after, axis=0))

    return ensemble, filterpy
