"""A linear model with Gaussian noise: its smoother, its likelihood and the update of expectation maximisation.

    x_t = A x_{t-1} + B u_t + w_t, w ~ N(0, Q)        y_t = C x_t + v_t, v ~ N(0, diag r)

Models and recordings of the same length may have leading axes (...), as those of folds, which are then followed as a batch.
Equations of Shumway and Stoffer 1982, "An approach to time series smoothing and forecasting using the EM algorithm", and of
Ghahramani and Hinton 1996, "Parameter estimation for linear dynamical systems", with readings of which any may be missing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

LEAST_NOISE = 1e-4  # least variance of a reading's noise over the variance of the reading: a hundredth of its deviation
LEAST_PROCESS = 1e-9  # least variance of the process noise, of a state of variance 1


class LinearGaussian(NamedTuple):
    """A (..., n, n), B (..., n, m), C (..., N, n), Q (..., n, n), r (..., N); x0 (..., n) and P0 (..., n, n) of the state one
    step before the first reading.
    """

    A: Array
    B: Array
    C: Array
    Q: Array
    r: Array
    x0: Array
    P0: Array


class Filtered(NamedTuple):
    """Predicted states xp (..., K, n), Pp (..., K, n, n), updated ones xf, Pf; of each sample (..., K) the innovation squared,
    e' S^-1 e, and the log-likelihood, -(e' S^-1 e + log |2 pi S|) / 2.
    """

    xp: Array
    Pp: Array
    xf: Array
    Pf: Array
    chi_square: Array
    log_likelihood: Array


class Smoothed(NamedTuple):
    """States given all readings: x (..., K + 1, n), P (..., K + 1, n, n) from the initial one on, lag (..., K, n, n) with
    lag[k] = cov(x_k+1, x_k); log_likelihood (...) of the readings.
    """

    x: Array
    P: Array
    lag: Array
    log_likelihood: Array


def filtered(model: LinearGaussian, y: Array, u: Array) -> Filtered:
    """The Kalman filter on y (..., K, N) or (K, N) for all models, NaN where missing, and u (K, m), in its information form:

    J = C' R^-1 C over the readings present,    P <- (I + P J)^-1 P,    x <- x + P (C' R^-1 y - J x)
    """
    A, B, C, Q, r, x, P = model
    *batch, n, _ = A.shape
    steps, count = y.shape[-2:]
    known = np.isfinite(y)
    weight = known / r[..., None, :]
    value = np.where(known, y, 0.0)
    squares = (C[..., :, None] * C[..., None, :]).reshape(*batch, count, n * n)
    J = (weight @ squares).reshape(*batch, steps, n, n)
    h, drive = (value * weight) @ C, u @ _transposed(B)
    xp, xf = np.empty((2, *batch, steps, n))
    Pp, Pf, gain = np.empty((3, *batch, steps, n, n))
    across, one = _transposed(A), np.eye(n)
    for t in range(steps):
        now = Pp[..., t, :, :] = _symmetric(A @ P @ across + Q)
        gain[..., t, :, :] = one + now @ J[..., t, :, :]
        P = Pf[..., t, :, :] = _symmetric(np.linalg.solve(gain[..., t, :, :], now))
        ahead = xp[..., t, :] = np.matvec(A, x) + drive[..., t, :]
        xf[..., t, :] = x = ahead + np.matvec(P, h[..., t, :] - np.matvec(J[..., t, :, :], ahead))
    error = np.where(known, y - xp @ _transposed(C), 0.0)
    g = (error * weight) @ C  # e' S^-1 e = e' R^-1 e - g' P g, log |S| = log |R| + log |I + P J|
    chi_square = np.sum(error**2 * weight, axis=-1) - np.vecdot(g, np.matvec(Pf, g))
    log_det = np.linalg.slogdet(gain)[1] + np.matvec(known, np.log(2 * np.pi * r))
    return Filtered(xp, Pp, xf, Pf, chi_square, -(chi_square + log_det) / 2)


def smoothed(model: LinearGaussian, y: Array, u: Array) -> Smoothed:
    """The smoother of Rauch, Tung and Striebel 1965: G = P A' P+^-1, x <- x + G (x+ - A x - B u), P <- P + G (P+s - P+) G'."""
    found = filtered(model, y, u)
    x = np.concatenate([model.x0[..., None, :], found.xf], axis=-2)
    P = np.concatenate([model.P0[..., None, :, :], found.Pf], axis=-3)
    G = _transposed(np.linalg.solve(found.Pp, model.A[..., None, :, :] @ P[..., :-1, :, :]))
    for t in range(y.shape[-2] - 1, -1, -1):
        gain = G[..., t, :, :]
        x[..., t, :] += np.matvec(gain, x[..., t + 1, :] - found.xp[..., t, :])
        P[..., t, :, :] += _symmetric(gain @ (P[..., t + 1, :, :] - found.Pp[..., t, :, :]) @ _transposed(gain))
    return Smoothed(x, P, P[..., 1:, :, :] @ _transposed(G), found.log_likelihood.sum(axis=-1))


def maximised(model: LinearGaussian, states: Smoothed, y: Array, u: Array, ridge: float) -> LinearGaussian:
    """The model that maximises the expected log-likelihood given the smoothed states.

    Each row of [A B] and of C is a regression; that of [A B] has `ridge` samples' worth of a prior of zero: the sums S of
    squares of the regressors become S + ridge diag(S) / K.
    """
    (*batch, steps, count), n = y.shape, model.A.shape[-1]
    x, P = states.x[..., 1:, :], states.P[..., 1:, :, :]
    before = np.concatenate([states.x[..., :-1, :], np.broadcast_to(u, (*batch, *u.shape))], axis=-1)
    S_zz, S_xz = _transposed(before) @ before, _transposed(x) @ before
    S_zz[..., :n, :n] += states.P[..., :-1, :, :].sum(axis=-3)
    S_xz[..., :n] += states.lag.sum(axis=-3)
    S_xx = _transposed(x) @ x + P.sum(axis=-3)
    AB = _transposed(np.linalg.solve(_ridged(S_zz, ridge / steps), _transposed(S_xz)))
    Q = _symmetric(S_xx - AB @ _transposed(S_xz)) / steps + LEAST_PROCESS * np.eye(n)

    known = np.isfinite(y)
    value = np.where(known, y, 0.0)
    squares = (x[..., :, None] * x[..., None, :] + P).reshape(*batch, steps, n * n)
    S_yx, S_of = _transposed(value) @ x, (_transposed(known).astype(float) @ squares).reshape(*batch, count, n, n)
    C = np.linalg.solve(S_of, S_yx[..., None])[..., 0]
    r = np.maximum((np.sum(value**2, axis=-2) - np.sum(C * S_yx, axis=-1)) / known.sum(axis=-2), LEAST_NOISE)
    return LinearGaussian(AB[..., :n], AB[..., n:], C, Q, r, states.x[..., 0, :], model.P0)


def _ridged(S: Array, share: float) -> Array:
    return np.asarray(S + share * S * np.eye(S.shape[-1]))


def _symmetric(P: Array) -> Array:
    return np.asarray((P + _transposed(P)) / 2)


def _transposed(a: Array) -> Array:
    return np.swapaxes(a, -1, -2)
