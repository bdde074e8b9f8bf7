"""A first linear model from recordings by canonical variates of past and future."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve, solve_triangular

from fusion_sfdia.learning.identification.linear_gaussian import LinearGaussian, maximised, smoothed

Array = NDArray[Any]

LAGS = 4  # samples of the past and of the future in canonical variates; a state for each reading in them takes one more
SHRINK = 0.1  # added to the variances, of readings of variance 1: rows of past and future are nearly collinear
SLOWEST = 0.99  # largest modulus of an eigenvalue at the start
NOISE = 0.2  # noise at the start over the residuals' variance: expectation maximisation raises it fast and lowers it slowly
LEAST = 0.005  # least variance of a reading's noise at the start, of a reading of variance 1


def canonical_variates(y: Array, u: Array, order: int, lags: int) -> LinearGaussian:
    """A model of that order from y (K, N) and u (K, m), centred and of variance 1; a missing reading is its last value.

    p_t = (y_t, ..., y_{t-lags+1}, u_t, ...), f_t = (y_{t+1}, ..., y_{t+lags}). With the singular value decomposition

        S_ff^-1/2 S_fp S_pp^-1/2' = U diag(rho) V',    x_t = V_n' S_pp^-1/2 p_t

    are the n combinations of the past that predict the future best (Larimore 1990; Van Overschee and De Moor 1996, sec. 4.3.3).
    A, B, C are then regressions, Q and r the variances of their residuals. Future inputs are not projected out: expectation
    maximisation starts here and corrects it.
    """
    y = held(y)
    ends = np.arange(lags - 1, len(y) - lags)
    past = np.hstack([s[ends - k] for s in (y, u) for k in range(lags)])
    future = np.hstack([y[ends + k] for k in range(1, lags + 1)])
    half_p, half_f = (cholesky(s.T @ s / len(ends) + SHRINK * np.eye(s.shape[1]), lower=True) for s in (past, future))
    between = solve_triangular(half_f, future.T @ past / len(ends), lower=True)
    V = np.linalg.svd(solve_triangular(half_p, between.T, lower=True).T, full_matrices=False)[2]
    x = past @ solve_triangular(half_p, V[:order].T, lower=True, trans="T")
    x = x / x.std(axis=0)

    before = np.hstack([x[:-1], u[ends[1:]]])
    AB = _regression(before, x[1:])
    A, B = AB[:, :order], AB[:, order:]
    C = _regression(x, y[ends])
    error = x[1:] - before @ AB.T
    A = A * min(1.0, SLOWEST / np.max(np.abs(np.linalg.eigvals(A))))
    Q = error.T @ error / len(error) + SHRINK**2 * np.eye(order)
    r = np.maximum(NOISE * np.mean((y[ends] - x @ C.T) ** 2, axis=0), LEAST)
    return LinearGaussian(A, B, C, Q, r, np.zeros(order), np.eye(order))


def fitted(y: Array, u: Array, order: int, ridge: float, iterations: int) -> LinearGaussian:
    """The model of that order after expectation maximisation, see `identify`; of y (F, K, N) a model for each recording."""
    lags = LAGS + order // y.shape[-1]
    if y.ndim == 2:
        model = canonical_variates(y, u, order, lags)
    else:
        model = LinearGaussian(*map(np.stack, zip(*(canonical_variates(one, u, order, lags) for one in y), strict=True)))
    for _ in range(iterations):
        model = maximised(model, smoothed(model, y, u), y, u, ridge)
    return model


def held(y: Array) -> Array:
    """Y (K, N) with missing readings replaced by the last one, 0 before the first."""
    last = np.maximum.accumulate(np.where(np.isfinite(y), np.arange(len(y))[:, None], -1), axis=0)
    return np.where(last >= 0, np.take_along_axis(np.nan_to_num(y), np.maximum(last, 0), axis=0), 0.0)


def _regression(z: Array, x: Array) -> Array:
    return np.asarray(solve(z.T @ z + np.eye(z.shape[1]), z.T @ x, assume_a="pos").T)
