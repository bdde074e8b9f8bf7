"""A linear model with Gaussian noise of a recording: canonical variates to start from, its smoother, its likelihood, the update
of expectation maximisation, and the plant that it is, whose states have names and units.

    x_t = A x_{t-1} + B u_t + w_t, w ~ N(0, Q)        y_t = C x_t + v_t, v ~ N(0, diag r)

Models and recordings of the same length may have leading axes (...), as those of folds, which are then followed as a batch.
Equations of Shumway and Stoffer 1982, "An approach to time series smoothing and forecasting using the EM algorithm", and of
Ghahramani and Hinton 1996, "Parameter estimation for linear dynamical systems", with readings of which any may be missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, qr, solve, solve_triangular

from fusion_sfdia.learning.identification.healthy_runs import Scaled
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]

LEAST_NOISE = 1e-4  # least variance of a reading's noise over the variance of the reading: a hundredth of its deviation
LEAST_PROCESS = 1e-9  # least variance of the process noise, of a state of variance 1
LAGS = 4  # samples of the past and of the future in canonical variates; a state for each reading in them takes one more
SHRINK = 0.1  # added to the variances, of readings of variance 1: rows of past and future are nearly collinear
SLOWEST = 0.99  # largest modulus of an eigenvalue at the start
NOISE = 0.2  # noise at the start over the residuals' variance: expectation maximisation raises it fast and lowers it slowly
LEAST = 0.005  # least variance of a reading's noise at the start, of a reading of variance 1
LATER = 0.5  # weight of a reading one step later as a state: present readings are preferred


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


def plant_of(name: str, model: LinearGaussian, scale: Scaled, sensors: Sequence[Signal], inputs: Sequence[Signal]) -> Plant:
    """The plant of a model of scaled readings, in the readings' units.

    With T the n rows of (C; C A; C A^2; ...) that a QR decomposition with pivots chooses, of rows over the reading's noise, the
    states T x are values without noise of readings, now or some steps later without further input and noise: "true level",
    "true level 2 later".
    """
    A, B, C, Q, r, _, P0 = model
    n, count = len(A), len(C)
    powers = [np.eye(n)]
    while len(powers) < n:
        powers.append(powers[-1] @ A)
    rows = np.concatenate([C @ power for power in powers])
    weight = np.concatenate([LATER**k / np.sqrt(r) for k in range(n)])
    chosen = np.sort(qr((weight[:, None] * rows).T, mode="r", pivoting=True)[1][:n])
    which, later = chosen % count, chosen // count
    unit = scale.y_sd[which]
    T = unit[:, None] * rows[chosen]

    def of_states(matrix: Array) -> Array:
        return np.asarray(solve(T.T, matrix.T).T)  # matrix T^-1

    F, G = of_states(T @ A), T @ B / scale.u_sd
    H = of_states(scale.y_sd[:, None] * C)
    centre = scale.y_mean[which]  # x in own units is T x + centre
    names = [sensors[i].name + (f" {k} later" if k else "") for i, k in zip(which, later, strict=True)]
    return linear_plant(
        name, F, H, [
            Sensor(s.name, s.name, s.unit, sigma=float(sigma))
            for s, sigma in zip(sensors, scale.y_sd * np.sqrt(r), strict=True)
        ],
        dt=scale.dt, x0=centre, initial_cov=_symmetric(T @ P0 @ T.T), process_cov=_symmetric(T @ Q @ T.T),
        input_matrix=G, offset=centre - F @ centre - G @ scale.u_mean, output_offset=scale.y_mean - H @ centre,
        states=[Signal(f"true {s}", sensors[i].unit, float(x)) for s, i, x in zip(names, which, centre, strict=True)],
        inputs=[replace(s, nominal=float(mean)) for s, mean in zip(inputs, scale.u_mean, strict=True)],
    )  # fmt: skip
