"""The smoother and the likelihood are those of the joint Gaussian of all states and readings; its maximisation never loses."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from scipy.stats import multivariate_normal

from fusion_sfdia.learning.identification.linear_gaussian import LinearGaussian, filtered, maximised, smoothed

N, M, COUNT, K = 2, 1, 3, 6  # states, inputs, sensors, samples


def made_up(seed: int = 0) -> tuple[LinearGaussian, NDArray[np.float64], NDArray[np.float64]]:
    """A stable model, readings of which every third is missing, and inputs."""
    rng = np.random.default_rng(seed)
    A = np.array([[0.8, 0.2], [-0.1, 0.6]])
    Q, P0 = (s @ s.T + 0.1 * np.eye(N) for s in rng.standard_normal((2, N, N)))
    model = LinearGaussian(
        A,
        rng.standard_normal((N, M)),
        rng.standard_normal((COUNT, N)),
        Q,
        rng.uniform(0.2, 1.0, COUNT),
        rng.standard_normal(N),
        P0,
    )
    y = rng.standard_normal((K, COUNT))
    y.ravel()[::3] = np.nan
    y[2] = np.nan
    return model, y, rng.standard_normal((K, M))


def joint(
    model: LinearGaussian, u: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Mean and covariance of (x_0, ..., x_K), and the matrix from those to (y_1, ..., y_K), by the equations themselves."""
    mean, steps = [model.x0], []
    for k in range(K):
        mean.append(model.A @ mean[-1] + model.B @ u[k])
    powers = np.zeros(((K + 1) * N, (K + 1) * N))  # of x in terms of (x_0 - mean, w_1, ..., w_K)
    for row in range(K + 1):
        for column in range(row + 1):
            block = np.linalg.matrix_power(model.A, row - column)
            powers[row * N : (row + 1) * N, column * N : (column + 1) * N] = block
    noise = np.kron(np.eye(K + 1), model.Q)
    noise[:N, :N] = model.P0
    steps = np.kron(np.eye(K, K + 1, 1), model.C)
    return np.concatenate(mean), powers @ noise @ powers.T, steps


def test_filter_and_smoother_are_the_joint_gaussian_given_the_readings() -> None:
    model, y, u = made_up()
    mean, cov, H = joint(model, u)
    known = np.isfinite(y).ravel()
    H = H[known]
    S = H @ cov @ H.T + np.diag(np.tile(model.r, K)[known])
    gain = np.linalg.solve(S, H @ cov).T
    value = y.ravel()[known]
    x, P = mean + gain @ (value - H @ mean), cov - gain @ H @ cov
    found = smoothed(model, y, u)
    close = rounding(float(np.linalg.cond(S)), 100 * K)
    assert found.x.ravel() == pytest.approx(x, abs=close)
    blocks = P.reshape(K + 1, N, K + 1, N)
    every = np.arange(K + 1)
    assert found.P == pytest.approx(blocks[every, :, every], abs=close)
    assert found.lag == pytest.approx(blocks[every[1:], :, every[:-1]], abs=close)
    expected = float(multivariate_normal.logpdf(value, H @ mean, S))
    assert found.log_likelihood == pytest.approx(expected, abs=close)
    one = filtered(model, y, u)
    assert one.xf[-1] == pytest.approx(x[-N:], abs=close)
    assert one.chi_square.sum() == pytest.approx((value - H @ mean) @ np.linalg.solve(S, value - H @ mean), abs=close)
    assert one.chi_square[2] == 0.0  # nothing was read


def test_maximisation_never_lowers_the_likelihood() -> None:
    """Of expectation maximisation without a prior (Dempster, Laird and Rubin 1977)."""
    rng = np.random.default_rng(1)
    model, _, _ = made_up(1)
    y, u = rng.standard_normal((60, COUNT)).cumsum(axis=0) / 4, rng.standard_normal((60, M))
    y[rng.random(y.shape) < 0.2] = np.nan
    before = -np.inf
    for _ in range(25):
        states = smoothed(model, y, u)
        assert states.log_likelihood >= before - rounding(1e6, y.size)
        before, model = states.log_likelihood, maximised(model, states, y, u, 0.0)


def test_the_prior_shrinks_the_transition() -> None:
    model, _, _ = made_up(2)
    rng = np.random.default_rng(2)
    y, u = rng.standard_normal((60, COUNT)), rng.standard_normal((60, M))
    states = smoothed(model, y, u)
    free, held = (maximised(model, states, y, u, ridge) for ridge in (0.0, 1e6))
    assert np.abs(held.A).max() < 1e-3 < np.abs(free.A).max() and np.abs(held.B).max() < 1e-3 < np.abs(free.B).max()
    assert np.array_equal(held.C, free.C) and np.array_equal(held.r, free.r)
