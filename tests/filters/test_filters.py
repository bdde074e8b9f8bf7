"""Laws of the linear, extended and unscented Kalman filters."""

from __future__ import annotations

import numpy as np
import pytest
from rounding import rounding
from three_states import Array, F, H, Q, R, bend, f, h, look

from fusion_sfdia.filters import ekf, ukf
from fusion_sfdia.filters.gaussian import condition
from fusion_sfdia.filters.ukf import SigmaPoints

NAN = np.nan


def readings(steps: int, *batch: int) -> Array:
    """Random readings of which a fifth are missing, at one step all of them."""
    rng = np.random.default_rng(7)
    y = rng.standard_normal((steps, *batch, 2))
    y[rng.random(y.shape) < 0.2] = NAN
    y[3] = NAN
    return y


def kalman(x: Array, P: Array, y: Array) -> tuple[Array, Array]:
    """The textbook's Kalman filter for one series, readings left out by deleting rows."""
    for reading in y:
        x, P = F @ x, F @ P @ F.T + np.diag(Q)
        used = np.isfinite(reading)
        rows = H[used]
        K = P @ rows.T @ np.linalg.inv(rows @ P @ rows.T + np.diag(R[used]))
        x, P = x + K @ (reading[used] - rows @ x), (np.eye(3) - K @ rows) @ P
    return x, P


@pytest.mark.parametrize("filter_name", ["jacobian", "complex step", "ukf", "ukf 1e-3", "cubature"])
def test_every_filter_is_the_kalman_filter_on_a_linear_model(filter_name: str) -> None:
    """40 stable steps of some ten sums, S of a condition of 10; weights of 1/alpha^2 magnify the rounding."""
    points = {"ukf": SigmaPoints(0.5), "ukf 1e-3": SigmaPoints(), "cubature": SigmaPoints(1.0, 0.0, 0.0)}.get(filter_name)
    y = readings(40, 4)
    x, P = np.ones((4, 3)), np.broadcast_to(np.eye(3), (4, 3, 3))
    jacobians = (F, H) if filter_name == "jacobian" else (None, None)
    for reading in y:
        if points is None:
            x, P = ekf.predict(x, P, f, jacobians[0], Q)
            joint = ekf.joint(x, P, h, jacobians[1], R)
        else:
            x, P, _ = ukf.predict(points, x, P, f, Q)
            joint = ukf.joint(points, x, P, h, R)
        x, P = condition(joint, reading)[:2]
    magnified = 1.0 if points is None else 1 / points.alpha**2
    tolerance = rounding(magnified * 10, 40 * 10)
    for b in range(4):
        expected_x, expected_P = kalman(np.ones(3), np.eye(3), y[:, b])
        np.testing.assert_allclose(x[b], expected_x, rtol=0, atol=tolerance)
        np.testing.assert_allclose(P[b], expected_P, rtol=0, atol=tolerance)


@pytest.mark.parametrize("redraw", [True, False, None])
def test_a_batch_is_its_elements(redraw: bool | None) -> None:
    """For the EKF (None) and both kinds of UKF, on a nonlinear model with readings missing."""
    points = SigmaPoints(0.3)

    def run(x: Array, P: Array, ys: Array) -> tuple[Array, Array]:
        for y in ys:
            if redraw is None:
                x, P = ekf.predict(x, P, bend, None, Q)
                joint = ekf.joint(x, P, look, None, R)
            else:
                x, P, propagated = ukf.predict(points, x, P, bend, Q)
                joint = ukf.joint(points, x, P, look, R, None if redraw else propagated)
            x, P = condition(joint, y)[:2]
        return x, P

    y = readings(10, 2, 3)
    start_x = np.random.default_rng(0).standard_normal((2, 3, 3))
    x, P = run(start_x, np.broadcast_to(0.1 * np.eye(3), (2, 3, 3, 3)), y)
    tolerance = rounding(10 / points.alpha**2, 10 * 10)  # ten steps of some ten sums, of numbers up to 10, weights of 1/alpha^2
    for index in np.ndindex(2, 3):
        alone = run(start_x[index], 0.1 * np.eye(3), y[:, *index])
        np.testing.assert_allclose(x[index], alone[0], rtol=0, atol=tolerance)
        np.testing.assert_allclose(P[index], alone[1], rtol=0, atol=tolerance)


def test_units_change_nothing_beyond_rounding() -> None:
    """States and readings in other units, by up to 1e8: the same estimates, the same NIS."""
    state, reading = np.array([1e-5, 1.0, 1e8]), np.array([1e5, 1e-3])
    y = readings(20)

    def run(state: Array, reading: Array, points: SigmaPoints | None) -> tuple[Array, Array]:
        x, P, nis = np.ones(3) * state, np.diag(state**2), []

        def move(s: Array) -> Array:
            return bend(s / state) * state

        def read(s: Array) -> Array:
            return look(s / state) * reading

        for z in y:
            if points is None:
                x, P = ekf.predict(x, P, move, None, Q * state**2)
                joint = ekf.joint(x, P, read, None, R * reading**2)
            else:
                x, P, _ = ukf.predict(points, x, P, move, Q * state**2)
                joint = ukf.joint(points, x, P, read, R * reading**2)
            found = condition(joint, z * reading)
            x, P = found.x, found.P
            nis.append(found.nis)
        return x / state, np.array(nis)

    for points in (None, SigmaPoints(0.5)):
        ones = run(np.ones(3), np.ones(2), points)
        other = run(state, reading, points)
        # units round each number once more in each of 20 steps; states are of 1, P up to 100 times worse conditioned
        near = rounding(100 / 0.5**2, 20 * 30)
        np.testing.assert_allclose(other[0], ones[0], rtol=near, atol=near)
        np.testing.assert_allclose(other[1], ones[1], rtol=near, atol=near)


def test_the_filter_is_consistent() -> None:
    """NIS and NEES per dimension are 1 on average: chi-square means of K independent values have standard error sqrt(2 / K)."""
    rng = np.random.default_rng(5)
    runs, steps = 400, 20
    truth = rng.standard_normal((runs, 3))
    x, P = np.zeros((runs, 3)), np.broadcast_to(np.eye(3), (runs, 3, 3))
    nis = []
    for _ in range(steps):
        truth = f(truth) + np.sqrt(Q) * rng.standard_normal(truth.shape)
        x, P = ekf.predict(x, P, f, F, Q)
        y = h(truth) + np.sqrt(R) * rng.standard_normal((runs, 2))
        y[rng.random(y.shape) < 0.3] = NAN
        found = condition(ekf.joint(x, P, h, H, R), y)
        x, P = found.x, found.P
        nis.append(np.where(np.isfinite(found.nis), found.nis * found.used.sum(-1), 0.0).sum() / found.used.sum())
    assert abs(np.mean(nis) - 1) < 4 * np.sqrt(2 / (runs * steps * 2 * 0.7))
    nees = np.einsum("bi,bij,bj->b", x - truth, np.linalg.inv(P), x - truth) / 3
    assert abs(nees.mean() - 1) < 4 * np.sqrt(2 / (3 * runs))


def test_a_diverged_element_does_not_affect_the_others() -> None:
    x, P = np.zeros((3, 3)), np.broadcast_to(np.eye(3), (3, 3, 3)).copy()
    P[1] = NAN
    y = np.ones((3, 2))
    points = SigmaPoints(0.5)
    new_x, new_P, _ = ukf.predict(points, x, P, bend, Q)
    found = condition(ukf.joint(points, new_x, new_P, look, R), y)
    assert np.isnan(found.x[1]).all()
    alone_x, alone_P, _ = ukf.predict(points, x[0], P[0], bend, Q)
    alone = condition(ukf.joint(points, alone_x, alone_P, look, R), y[0])
    np.testing.assert_allclose(found.x[[0, 2]], np.stack([alone.x, alone.x]), rtol=0, atol=rounding(10 / 0.5**2, 30))
