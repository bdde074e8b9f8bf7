"""bench large: a step of plants of up to a thousand states and sensors, beside filters of the same plant in the same run.

The plant is a chain of n linear states, each read by a sensor. step_time and its ratio to filterpy's Kalman filter (quantity
`10 states` to `1000 states`):

- `none`, condition `Cholesky`: a Kalman filter in NumPy and SciPy with a factorisation of S, what a good engineer would write;
- `loo-glr` and `robust-glr`, condition `every step`: gains change in each step, as after a start or an alarm; condition
  `at rest`: the covariance is that of the Riccati equation and gains are kept;
- `none`, condition `least, filter` and `least, at rest`: a bound. Of the filter its multiply-adds at the rate of products of
  256 x 256, of a step at rest the matrices that it reads once at the rate of copies.

It takes minutes and is measured on request.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from fusion_sfdia.benchmarks.speed.support.calls import (
    COPY,
    PRODUCT,
    Call,
    reference,
    repeated_step,
    time_row,
    timed,
    timed_rows,
)
from fusion_sfdia.benchmarks.speed.support.coupled import chained
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.steady_gains import SETTLED
from fusion_sfdia.filters.gaussian import dense
from fusion_sfdia.filters.riccati import steady_prediction
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.results import Row

Array = NDArray[Any]

STATES = (10, 50, 200, 500, 1000)
DETECTORS = ("loo-glr", "robust-glr")
OF = "filterpy"
MULTIPLY_ADDS = 1 + 1 + 1 / 6 + 1 + 1  # over n^3: F P, (F P) F', the factor of S, K, K S K'
MATRICES = 4 + 5  # of n x n that a step at rest reads: F, S^-1, C, F K, and A^1 to A^16 for windows of up to 32 rows


def measure(seconds: float, states: tuple[int, ...] = STATES) -> list[Row]:
    """All sizes, each call for so many seconds."""
    product, copy = (timed({"": reference(of)}, seconds / 4)[""].best for of in (PRODUCT, COPY))
    rows: list[Row] = []
    for n in states:
        plant = chained(n)
        rested = at_rest(plant)
        calls: dict[tuple[str, str], Call] = {("none", "Cholesky"): by_hand(plant)}
        for name in DETECTORS:
            calls[name, "every step"] = repeated_step(registry.detector(name, plant))
            calls[name, "at rest"] = repeated_step(registry.detector(name, rested), settled=SETTLED + 1, noise=False)
        where = f"{n} states"
        for (name, condition), time in timed(calls, seconds, OF, filterpy(plant)).items():
            rows += timed_rows("large", plant.name, name, where, time, condition=condition)
        least = {"filter": MULTIPLY_ADDS * n**3 * product / 256**3, "at rest": MATRICES * 8 * n**2 * copy / 128e6}
        for what, value in least.items():
            rows.append(time_row("large", plant.name, "none", where, "step_time", value, 1, condition=f"least, {what}"))
    return rows


def matrices(plant: Plant) -> tuple[Array, Array, Array, Array]:
    """F (n, n), H (N, n), Q (n, n) and R (N, N) of a linear plant."""
    u = plant.input_at(0.0)
    F, H = plant.step_jacobian_at(0.0, plant.x0, u, plant.dt), plant.output_jacobian_at(0.0, plant.x0, u)
    return F, H, dense(plant.process_cov), np.diag(plant.sensor_cov)


def at_rest(plant: Plant) -> Plant:
    """The plant with the covariance at rest as its initial one, so that gains need not come to rest first."""
    F, H, Q, R = matrices(plant)
    P = steady_prediction(F, H, Q, np.diag(R))
    assert P is not None
    return replace(plant, initial_cov=P - P @ H.T @ np.linalg.solve(H @ P @ H.T + R, H @ P))


def by_hand(plant: Plant) -> Call:
    """A prediction and an update, always of the same x and P."""
    F, H, Q, R = matrices(plant)
    x0, P0, y = plant.x0, dense(plant.initial_cov), np.ones(len(plant.sensors))

    def step() -> tuple[Array, Array]:
        x, P = F @ x0, F @ P0 @ F.T + Q
        C = P @ H.T
        K = cho_solve(cho_factor(H @ C + R), C.T).T
        return x + K @ (y - H @ x), P - K @ C.T

    return step


def filterpy(plant: Plant) -> Callable[[], tuple[Array, Array]]:
    """The same by filterpy."""
    F, H, Q, R = matrices(plant)
    of = KalmanFilter(len(plant.states), len(plant.sensors))
    of.F, of.H, of.Q, of.R = F, H, Q, R
    y = np.ones(len(plant.sensors))

    def step() -> tuple[Array, Array]:
        of.x, of.P = plant.x0, dense(plant.initial_cov)
        of.predict()
        of.update(y)
        return np.asarray(of.x), np.asarray(of.P)

    return step
