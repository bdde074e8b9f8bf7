"""A linear model with Gaussian noise: its smoother, its likelihood and the update of expectation maximisation.

    x_t = A x_{t-1} + B u_t + w_t, w ~ N(0, Q)        y_t = C x_t + v_t, v ~ N(0, diag r)

Equations of Shumway and Stoffer 1982, "An approach to time series smoothing and forecasting using the EM algorithm", and of
Ghahramani and Hinton 1996, "Parameter estimation for linear dynamical systems", with readings of which any may be missing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve

Array = NDArray[Any]

LEAST_NOISE = 1e-4  # least variance of a reading's noise over the variance of the reading: a hundredth of its deviation
LEAST_PROCESS = 1e-9  # least variance of the process noise, of a state of variance 1


class LinearGaussian(NamedTuple):
    """A (n, n), B (n, m), C (N, n), Q (n, n), r (N,); x0 (n,) and P0 (n, n) of the state one step before the first reading."""

    A: Array
    B: Array
    C: Array
    Q: Array
    r: Array
    x0: Array
    P0: Array


class Filtered(NamedTuple):
    """Predicted states xp (K, n), Pp (K, n, n), updated ones xf, Pf; of each sample (K,) the innovation squared,
    e' S^-1 e, and the log-likelihood, -(e' S^-1 e + log |2 pi S|) / 2.
    """

    xp: Array
    Pp: Array
    xf: Array
    Pf: Array
    chi_square: Array
    log_likelihood: Array


class Smoothed(NamedTuple):
    """States given all readings: x (K + 1, n), P (K + 1, n, n) from the initial one on, lag[k] = cov(x_k+1, x_k) (K, n, n)."""

    x: Array
    P: Array
    lag: Array
    log_likelihood: float


def filtered(model: LinearGaussian, y: Array, u: Array) -> Filtered:
    """The Kalman filter on y (K, N), NaN where missing, and u (K, m), in its information form:

    J = C' R^-1 C over the readings present,    P <- (I + P J)^-1 P,    x <- x + P (C' R^-1 y - J x)
    """
    A, B, C, Q, r, x, P = model
    (steps, count), n = y.shape, len(A)
    known = np.isfinite(y)
    weight = known / r
    value = np.where(known, y, 0.0)
    J = (weight @ (C[:, :, None] * C[:, None, :]).reshape(count, n * n)).reshape(steps, n, n)
    h = (value * weight) @ C
    drive = u @ B.T
    xp, xf = np.empty((2, steps, n))
    Pp, Pf, gain = np.empty((3, steps, n, n))
    for t in range(steps):
        xp[t], Pp[t] = A @ x + drive[t], _symmetric(A @ P @ A.T + Q)
        gain[t] = np.eye(n) + Pp[t] @ J[t]
        Pf[t] = P = _symmetric(np.linalg.solve(gain[t], Pp[t]))
        xf[t] = x = xp[t] + P @ (h[t] - J[t] @ xp[t])
    error = np.where(known, y - xp @ C.T, 0.0)
    g = (error * weight) @ C  # e' S^-1 e = e' R^-1 e - g' P g, log |S| = log |R| + log |I + P J|
    chi_square = np.sum(error**2 * weight, axis=1) - np.einsum("ti,tij,tj->t", g, Pf, g)
    log_det = np.linalg.slogdet(gain)[1] + known @ np.log(2 * np.pi * r)
    return Filtered(xp, Pp, xf, Pf, chi_square, -(chi_square + log_det) / 2)


def smoothed(model: LinearGaussian, y: Array, u: Array) -> Smoothed:
    """The smoother of Rauch, Tung and Striebel 1965: G = P A' P+^-1, x <- x + G (x+ - A x - B u), P <- P + G (P+s - P+) G'."""
    found = filtered(model, y, u)
    x = np.concatenate([model.x0[None], found.xf])
    P = np.concatenate([model.P0[None], found.Pf])
    lag = np.empty_like(found.Pf)
    for t in range(len(y) - 1, -1, -1):
        G = np.linalg.solve(found.Pp[t], model.A @ P[t]).T
        x[t] += G @ (x[t + 1] - found.xp[t])
        P[t] += _symmetric(G @ (P[t + 1] - found.Pp[t]) @ G.T)
        lag[t] = P[t + 1] @ G.T
    return Smoothed(x, P, lag, float(found.log_likelihood.sum()))


def maximised(model: LinearGaussian, states: Smoothed, y: Array, u: Array, ridge: float) -> LinearGaussian:
    """The model that maximises the expected log-likelihood given the smoothed states.

    Each row of [A B] and of C is a regression; that of [A B] has `ridge` samples' worth of a prior of zero: the sums S of
    squares of the regressors become S + ridge diag(S) / K.
    """
    steps, n = len(y), len(model.A)
    before = np.hstack([states.x[:-1], u])
    S_zz, S_xz = before.T @ before, states.x[1:].T @ before
    S_zz[:n, :n] += states.P[:-1].sum(axis=0)
    S_xz[:, :n] += states.lag.sum(axis=0)
    S_xx = states.x[1:].T @ states.x[1:] + states.P[1:].sum(axis=0)
    AB = solve(_ridged(S_zz, ridge / steps), S_xz.T, assume_a="pos").T
    Q = _symmetric(S_xx - AB @ S_xz.T) / steps + LEAST_PROCESS * np.eye(n)

    known = np.isfinite(y)
    value, count = np.where(known, y, 0.0), known.sum(axis=0)
    squares = (states.x[1:, :, None] * states.x[1:, None, :] + states.P[1:]).reshape(steps, n * n)
    S_yx, S_of = value.T @ states.x[1:], (known.T.astype(float) @ squares).reshape(-1, n, n)
    C = np.stack([solve(s, b, assume_a="pos") for s, b in zip(S_of, S_yx, strict=True)])
    r = np.maximum((np.sum(value**2, axis=0) - np.sum(C * S_yx, axis=1)) / count, LEAST_NOISE)
    return LinearGaussian(AB[:, :n], AB[:, n:], C, Q, r, states.x[0], model.P0)


def _ridged(S: Array, share: float) -> Array:
    return np.asarray(S + share * np.diag(np.diag(S)))


def _symmetric(P: Array) -> Array:
    return np.asarray((P + P.T) / 2)
