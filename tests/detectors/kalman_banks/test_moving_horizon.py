"""Moving-horizon estimation with sparse faults: against the stacked problem of all states and faults, and its statistics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from scipy.linalg import cholesky
from scipy.optimize import minimize
from scipy.stats import norm
from toy_plants import chain, readings

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.moving_horizon import Horizons, refitted, sparse_faults
from fusion_sfdia.detectors.kalman_banks.moving_horizon_bank import MovingHorizon
from fusion_sfdia.detectors.state import State

Array = NDArray[Any]
PLANT = chain(3, sensors=5)
N, n = 5, 3
F = PLANT.step_jacobian_at(0.0, PLANT.x0, np.zeros(0), 1.0)
H = PLANT.output_jacobian_at(0.0, PLANT.x0, np.zeros(0))
P0, Q, R = (np.diag(a) for a in (PLANT.initial_cov, PLANT.process_cov, PLANT.sensor_cov))
UNREACHED = 1e6


def root(cov: Array) -> Array:
    """W with W' W = cov^-1."""
    return np.linalg.inv(cholesky(cov, lower=True))


def filtered(y: Array) -> tuple[Array, Array]:
    """The textbook filter from the plant's x0 over readings y (K, N), rows of missing ones deleted."""
    x, P = PLANT.x0, P0
    for reading in y:
        x, P, seen = F @ x, F @ P @ F.T + Q, np.isfinite(reading)
        h = H[seen]
        K = P @ h.T @ np.linalg.inv(h @ P @ h.T + R[np.ix_(seen, seen)])
        x, P = x + K @ (reading[seen] - h @ x), P - K @ h @ P
    return x, P


def stacked(before: Array, y: Array) -> tuple[Array, Array]:
    """A, b of |A z - b|^2, z = (x_0, ..., x_K, f), readings y (K, N) after `before`, whose filter is the arrival cost."""
    m, P = filtered(before)
    rows, right, size = [], [], (len(y) + 1) * n

    def add(weight: Array, parts: dict[int, Array], value: Array) -> None:
        row = np.zeros((len(value), size + N))
        for column, part in parts.items():
            row[:, column : column + part.shape[1]] = part
        rows.append(weight @ row)
        right.append(weight @ value)

    add(root(P), {0: np.eye(n)}, m)
    for k, reading in enumerate(y):
        add(root(Q), {k * n: -F, (k + 1) * n: np.eye(n)}, np.zeros(n))
        seen = np.isfinite(reading)
        add(root(R[np.ix_(seen, seen)]), {(k + 1) * n: H[seen], size: np.eye(N)[seen]}, reading[seen])
    return np.concatenate(rows), np.concatenate(right)


def reduced(A: Array, b: Array) -> tuple[Array, Array]:
    """G, g of the problem in f alone: the trajectory is projected out."""
    basis, _ = np.linalg.qr(A[:, :-N])
    faults, rest = (a - basis @ (basis.T @ a) for a in (A[:, -N:], b))
    return faults.T @ faults, faults.T @ rest


def near(A: Array, b: Array) -> float:
    """Rounding of sums over all rows, carried by the condition of the trajectory's normal equations."""
    return rounding(np.linalg.cond(A[:, :-N]) ** 2 * np.max(np.abs(b)) ** 2, len(b))


def watched(y: Array, window: int, u: Array, t: Array) -> Horizons:
    """E, g, G after readings y (K, N) of one run, without isolation."""
    bank = MovingHorizon(PLANT, window=window, threshold_scale=UNREACHED)
    state: State
    state, _ = run(bank, bank.init(), t, y, u[:, 0])
    horizons: Horizons = state.memory.horizons
    return horizons


def weak_bias(steps: int, seed: int) -> tuple[Array, Array, Array]:
    """t, y (K, N), u with a bias of 3 sigma on sensor 1 from the start and gaps."""
    t, _, y, u = readings(PLANT, steps, 1, seed)
    y = y[:, 0].copy()
    y[:, 1] += 3.0
    y[4:5, 2] = y[5:6, [0, 3]] = np.nan
    return t, y, u


@pytest.mark.parametrize("steps", [3, 7, 10, 13])
def test_its_horizons_are_the_stacked_problem_without_its_trajectory(steps: int) -> None:
    t, y, u = weak_bias(steps, seed=1)
    found = watched(y, 8, u, t)  # horizons begin with readings 4, 8, 12, ... counted from 1
    newest = max(steps // 4 * 4 - 1, 0)
    for j, begin in enumerate((newest, max(newest - 4, 0))):
        A, b = stacked(y[:begin], y[begin:])
        G, g = reduced(A, b)
        np.testing.assert_allclose(found.G[j], G, rtol=0, atol=near(A, b))
        np.testing.assert_allclose(found.g[j], g, rtol=0, atol=near(A, b))


@pytest.mark.parametrize("penalty", [0.5, 2.0, 4.0])
def test_the_fault_is_that_of_the_stacked_problem(penalty: float) -> None:
    """By the conditions of Karush, Kuhn and Tucker on all variables, and against a general optimiser."""
    t, y, u = weak_bias(12, seed=2)
    y[:, 4] -= 2.0
    found = watched(y, 60, u, t)
    g, G = found.g[-1], found.G[-1]
    f = sparse_faults(g, G, np.ones(N, bool), penalty)
    assert np.any(f)
    A, b = stacked(y[:0], y)
    s = np.sqrt(np.diagonal(G))
    trajectory = np.linalg.lstsq(A[:, :-N], b - A[:, -N:] @ f, rcond=None)[0]
    slope = A.T @ (b - A @ np.append(trajectory, f))
    tolerance = near(A, b)
    np.testing.assert_allclose(slope[:-N], 0.0, atol=tolerance)
    np.testing.assert_allclose(slope[-N:][f != 0], (penalty * s * np.sign(f))[f != 0], rtol=0, atol=tolerance)
    assert np.all(np.abs(slope[-N:]) <= penalty * s + tolerance)

    def cost(z: Array) -> float:  # z = (trajectory, f+, f-)
        e = A @ np.append(z[: -2 * N], z[-2 * N : -N] - z[-N:]) - b
        return float(e @ e / 2 + penalty * s @ (z[-2 * N : -N] + z[-N:]))

    def gradient(z: Array) -> Array:
        v = A.T @ (A @ np.append(z[: -2 * N], z[-2 * N : -N] - z[-N:]) - b)
        return np.concatenate([v[:-N], v[-N:] + penalty * s, -v[-N:] + penalty * s])

    start = np.zeros(A.shape[1] + N)
    bounds = [(None, None)] * (len(start) - 2 * N) + [(0.0, None)] * (2 * N)
    other = minimize(cost, start, jac=gradient, bounds=bounds, method="SLSQP", options={"maxiter": 500, "ftol": 1e-12})
    ours = cost(np.concatenate([trajectory, np.maximum(f, 0), np.maximum(-f, 0)]))
    gap = other.fun - ours
    assert -tolerance <= gap < 1e-6 * ours
    off = other.x[-2 * N : -N] - other.x[-N:] - f
    assert off @ G @ off / 2 <= gap + tolerance  # by the convexity of the cost in f


def test_the_estimate_is_that_of_the_stacked_problem_with_the_isolated_faults_free() -> None:
    t, y, u = weak_bias(12, seed=3)
    found = watched(y, 60, u, t)
    fit = refitted(found.g[-1], found.G[-1], np.array([1, 3]), 0.0, N)
    x, P = filtered(y)
    moved = found.effect[-1][:, fit.sensors]
    A, b = stacked(y[:0], y)
    free = A[:, [*range(A.shape[1] - N), *(A.shape[1] - N + fit.sensors)]]
    z = np.linalg.lstsq(free, b, rcond=None)[0]
    covariance = np.linalg.inv(free.T @ free)
    last = slice(-n - 2, -2)
    tolerance = near(A, b)
    np.testing.assert_allclose(fit.f, z[-2:], rtol=0, atol=tolerance)
    np.testing.assert_allclose(x - moved @ fit.f, z[last], rtol=0, atol=tolerance)
    np.testing.assert_allclose(P + moved @ fit.covariance @ moved.T, covariance[last, last], rtol=0, atol=tolerance)


def test_the_detector_reports_that_estimate_at_its_alarm() -> None:
    t, y, u = weak_bias(30, seed=4)
    bank = MovingHorizon(PLANT, window=60)
    _, d = run(bank, bank.init(), t, y, u[:, 0], covariance=True)
    k = int(np.argmax(d.alarm))
    assert k > 0 and list(np.flatnonzero(d.isolated[k])) == [1] and not d.isolated[:k].any()
    A, b = stacked(y[:0], y[: k + 1])
    free = A[:, [*range(A.shape[1] - N), A.shape[1] - N + 1]]
    z = np.linalg.lstsq(free, b, rcond=None)[0]
    np.testing.assert_allclose(d.estimate[k], z[-n - 1 : -1], rtol=0, atol=near(A, b))


def test_statistics_of_every_horizon_are_standard_normal_when_healthy() -> None:
    runs = 400
    t, _, y, u = readings(PLANT, 17, runs, seed=5)
    bank = MovingHorizon(PLANT, window=8, threshold_scale=UNREACHED)
    state, _ = run(bank, bank.init((runs,)), t, y, u)
    _, g, G = state.memory.horizons
    z = g / np.sqrt(np.diagonal(G, axis1=-2, axis2=-1))
    assert np.all(np.abs(np.mean(z, axis=0)) < 4 / np.sqrt(runs))
    assert np.all(np.abs(np.var(z, axis=0) - 1) < 4 * np.sqrt(2 / runs))


def test_without_accommodation_the_filter_stays_undisturbed() -> None:
    t, y, u = weak_bias(30, seed=9)
    quiet, loud = (MovingHorizon(PLANT, accommodate=False, threshold_scale=scale) for scale in (UNREACHED, 1.0))
    (_, a), (_, b) = (run(bank, bank.init(), t, y, u[:, 0]) for bank in (quiet, loud))
    assert b.isolated.any() and not a.isolated.any()
    np.testing.assert_array_equal(a.estimate, b.estimate)


def test_at_the_penalty_there_is_no_fault_and_of_indistinguishable_faults_one_is_left() -> None:
    G = np.array([[4.0, 3.8], [3.8, 4.0]])
    assert not np.any(sparse_faults(np.array([6.0, -6.0]), G, np.ones(2, bool), 3.0))  # g / s = 3
    np.testing.assert_allclose(sparse_faults(np.array([8.0, 0.0]), G, np.array([True, False]), 3.0), [0.5, 0.0])
    fit = refitted(np.array([8.0, 7.9]), G, np.array([0, 1]), 3.0, 2)
    assert len(fit.sensors) == 1 and not fit.capped


def test_the_penalty_is_the_share_of_a_sensor_in_one_of_three_horizons() -> None:
    bank = MovingHorizon(PLANT, false_alarm=0.03, threshold_scale=1.5)  # 0.002 of both tails: 5 sensors, 3 horizons
    assert bank.penalty == pytest.approx(1.5 * norm.isf(0.001), rel=1e-12)


@pytest.mark.parametrize("largest", [0, 1, 2])
def test_the_horizon_with_the_largest_ratio_is_the_one_solved(largest: int) -> None:
    """Of the present reading, of a short and a long horizon; G = 1, sensors uncoupled: f = g, x loses E f."""
    g = np.full((3, N), 0.5)
    g[largest, 3], g[(largest + 1) % 3, 1] = 20.0, 10.0
    effect = np.broadcast_to(np.arange(1.0, 4.0)[:, None, None], (3, n, N))
    every = Horizons(effect, g, np.broadcast_to(np.eye(N), (3, N, N)))
    present, past = (Horizons(*(a[None, part] for a in every)) for part in (slice(0, 1), slice(1, 3)))
    bank = MovingHorizon(PLANT)
    ratio = np.abs(g)[None] / bank.penalty
    x, p, named, size, capped = bank._solve(
        (present, past), np.ones((1, 3, N), bool), ratio, np.array([2]), np.zeros((1, n)), np.zeros((1, n, n))
    )
    assert np.flatnonzero(named[0]).tolist() == [3] and not capped[0]
    np.testing.assert_allclose(size[0], [0, 0, 0, 20.0, 0])
    np.testing.assert_allclose(x[0], np.full(n, -20.0 * (largest + 1)))
    np.testing.assert_allclose(p[0], np.full((n, n), (largest + 1.0) ** 2))
