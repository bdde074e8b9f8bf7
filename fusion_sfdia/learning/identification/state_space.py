"""A scaled linear model with terms of the inputs as a plant: x+ = A x + B z(u) + w, y = C x + D z(u) + v.

It is a vector autoregression with inputs, by regression with a ridge, or common factors of all sensors and a slow offset of
each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, solve

from fusion_sfdia.learning.identification.healthy_runs import Runs
from fusion_sfdia.learning.identification.linear_gaussian import LEAST_NOISE, held
from fusion_sfdia.plant.linear import constant
from fusion_sfdia.plant.plant import Numerics, Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]
NOISE = 0.5  # share of a sensor's own error that counts as noise of its reading; the rest moves its state. The likelihood of
LAGS = (1, 5)  # samples, of the two autocovariances that separate an offset from noise
UNSEEN = 4.0  # variance of the offset at the start of a run that was not learnt from, over that of the others
SLOWEST = 0.9995  # largest autocorrelation of an offset from one sample to the next: changes over some hours at 1 Hz


class StateSpace(NamedTuple):
    """A (n, n), B (n, p), C (N, n), D (N, p), Q (n, n), r (N,), P0 (n, n) of scaled readings and the p terms of the inputs;
    names and sensors (n,) of the states: what each is, and the position of the sensor whose unit it has, -1 for none.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    Q: Array
    r: Array
    P0: Array
    names: tuple[str, ...]
    sensors: tuple[int, ...]


def terms(u: Array, mean: Array, sd: Array, quadratic: bool) -> Array:
    """z(u) (..., p): 1, the inputs scaled, and where `quadratic` their squares less 1: a gain that depends on the operation."""
    s = (u - mean) / sd
    return np.concatenate([np.ones((*s.shape[:-1], 1)), s, *([s**2 - 1] if quadratic else [])], axis=-1)


def _step(A: Array, B: Array, z: partial[Array], t_start: float, x: Array, u: Array, dt: float) -> Array:
    return np.asarray(x @ A.T + z(u) @ B.T)


def _output(C: Array, D: Array, offset: Array, z: partial[Array], t: float, x: Array, u: Array) -> Array:
    return np.asarray(x @ C.T + z(u) @ D.T + offset)


def plant_of_model(
    name: str, model: StateSpace, runs: Runs, sensors: Sequence[Signal], inputs: Sequence[Signal], quadratic: bool
) -> Plant:
    """The plant in the readings' units; states are deviations from the mean of the healthy readings."""
    A, B, C, D, Q, r, P0, names, of = model
    unit = np.array([runs.y_sd[i] if i >= 0 else 1.0 for i in of])
    z = partial(terms, mean=runs.u_mean, sd=runs.u_sd, quadratic=quadratic)
    F, H = unit[:, None] * A / unit, runs.y_sd[:, None] * C / unit
    both = np.outer(unit, unit)
    return Plant(
        name=name,
        states=tuple(Signal(what, sensors[i].unit if i >= 0 else "1") for what, i in zip(names, of, strict=True)),
        sensors=tuple(
            Sensor(s.name, s.name, s.unit, sigma=float(sigma)) for s, sigma in zip(sensors, runs.y_sd * np.sqrt(r), strict=True)
        ),
        step=partial(_step, F, unit[:, None] * B, z),
        output=partial(_output, H, runs.y_sd[:, None] * D, runs.y_mean, z),
        dt=runs.dt,
        inputs=tuple(replace(s, nominal=float(mean)) for s, mean in zip(inputs, runs.u_mean, strict=True)),
        x0=np.zeros(len(A)),
        initial_cov=both * P0,
        process_cov=both * Q,
        numerics=Numerics(partial(constant, F), partial(constant, H), fixed_dt=True),
    )


def pairwise_covariance(e: Array, shrink: float) -> Array:
    """The covariance (N, N) of errors e (K, N) with NaN where missing, from the samples that both sensors of a pair have.

    Shrunk to its diagonal: (1 - shrink) S + shrink diag(S); then the nearest whose eigenvalues are positive.
    """
    known = np.isfinite(e).astype(float)
    value = np.nan_to_num(e)
    S = value.T @ value / np.maximum(known.T @ known, 1)
    S = (1 - shrink) * S + shrink * np.diag(np.diag(S))
    return positive(S)


def positive(S: Array, least: float = 1e-6) -> Array:
    """The symmetric matrix with eigenvalues of its unit-diagonal form of at least `least`."""
    sd = np.sqrt(np.maximum(np.diag(S), 1e-12))
    values, vectors = np.linalg.eigh((S + S.T) / 2 / np.outer(sd, sd))
    fixed = (vectors * np.maximum(values, least)) @ vectors.T
    return np.asarray((fixed + fixed.T) / 2 * np.outer(sd, sd))


# left-out readings hardly depends on it, from 0.02 to 0.5


def autoregression(parts: Sequence[tuple[Array, Array]], order: int, ridge: float, sensors: Sequence[Signal]) -> StateSpace:
    """The model of scaled readings y (K, N) and terms z (K, p) of several runs,

        y_t = B z_t + A_1 y_t-1 + ... + A_p y_t-p + e_t,    e ~ N(0, S)    (Luetkepohl 2005, sec. 10.2)

    by least squares a sensor, with `ridge` samples' worth of a prior of zero of all but the constant. B has the offset and the
    feedthrough of the present input. A missing regressor is the last reading. S of the residuals is shrunk to its diagonal by
    N over the number of samples. The states are y_t to y_t-p+1; S is split into the noise of readings, a share of what no other
    sensor explains, and the noise of the states. Of order 0 the states have no memory: each reading is predicted
    from the other ones and the inputs at the same time, by the ridge regression of each sensor on the others.
    """
    rows, targets, windows = [], [], []
    stacked = max(order, 1)
    for y, z in parts:
        if len(y) > order:
            last = held(y)
            rows.append(np.hstack([z[order:], *(last[order - k : len(y) - k] for k in range(1, order + 1))]))
            targets.append(y[order:])
            windows.append(np.hstack([last[order - k : len(y) - k] for k in range(stacked)]))
    count = parts[0][0].shape[1]
    if sum(map(len, rows)) <= count:
        raise ValueError(f"{sum(map(len, rows))} samples for {count} sensors of an autoregression; record more")
    X, Y, W = np.concatenate(rows), np.concatenate(targets), np.concatenate(windows)
    penalty = np.diag(np.concatenate([[0.0], np.full(X.shape[1] - 1, ridge)])) + 1e-9 * len(X) * np.eye(X.shape[1])
    known = np.isfinite(Y)
    if known.all():
        weights = solve(X.T @ X + penalty, X.T @ Y, assume_a="pos").T
    else:
        weights = np.stack([
            solve(X[k].T @ X[k] + penalty, X[k].T @ Y[k, i], assume_a="pos") for i, k in enumerate(known.T)
        ])  # fmt: skip
    inputs = X.shape[1] - count * order
    S = pairwise_covariance(Y - X @ weights.T, min(1.0, count / len(X))) + LEAST_NOISE * np.eye(count)
    own = 1.0 / np.diag(np.linalg.inv(S))  # variance of what the other sensors do not explain
    largest = np.linalg.eigvalsh(np.linalg.inv(S) * np.sqrt(np.outer(own, own)))[-1]
    r = np.maximum(NOISE / largest * own, LEAST_NOISE / 2)

    n = count * stacked
    A, B, Q = np.zeros((n, n)), np.zeros((n, inputs)), np.zeros((n, n))
    A[:count, : count * order], B[:count] = weights[:, inputs:], weights[:, :inputs]
    A[count:, :-count] = np.eye(n - count)
    Q[:count, :count] = positive(S - np.diag(r))
    P0 = positive(np.cov(W.T).reshape(n, n) + LEAST_NOISE * np.eye(n))
    C = np.eye(count, n)
    names = tuple(f"true {s.name}" + (f" {k} before" if k else "") for k in range(stacked) for s in sensors)
    return StateSpace(A, B, C, np.zeros((count, inputs)), Q, r, P0, names, tuple(range(count)) * stacked)


def factors(parts: Sequence[tuple[Array, Array]], count: int, ridge: float, sensors: Sequence[Signal]) -> StateSpace:
    """The model of scaled readings y (K, N) and terms z (K, p) of several runs,

        y_t = D z_t + C f_t + o_t + v_t,    f_t = A_f f_t-1 + w_t,    o_i,t = rho_i o_i,t-1 + noise

    D by regression with `ridge` samples' worth of a prior of zero. C are the first principal directions of what is left, f
    their scores, A_f the regression of f on the sample before. Of what remains of a sensor the autocovariances g_1 and g_5 give

        rho = (g_5 / g_1)^(1/4),    variance of o: g_1 / rho,    variance of v: g_0 - g_1 / rho

    A missing reading is the last one where scores are computed. The variance of an offset includes that between runs.
    """
    X = np.concatenate([z for _, z in parts])
    Y = np.concatenate([y for y, _ in parts])
    N = Y.shape[1]
    if count >= N:
        raise ValueError(f"{count} factors of {N} sensors; expected fewer")
    penalty = np.diag(np.concatenate([[0.0], np.full(X.shape[1] - 1, ridge)])) + 1e-9 * len(X) * np.eye(X.shape[1])
    D = np.stack([solve(X[k].T @ X[k] + penalty, X[k].T @ Y[k, i], assume_a="pos") for i, k in enumerate(np.isfinite(Y).T)])
    left = [y - z @ D.T for y, z in parts]
    C = np.linalg.eigh(pairwise_covariance(np.concatenate(left), 0.0))[1][:, ::-1][:, :count]
    scores = [held(e) @ C for e in left]
    f0, f1 = np.concatenate([f[:-1] for f in scores]), np.concatenate([f[1:] for f in scores])
    A = solve(f0.T @ f0 + ridge * np.eye(count), f0.T @ f1, assume_a="pos").T
    A = A * min(1.0, SLOWEST / max(np.max(np.abs(np.linalg.eigvals(A))), 1e-9))
    Q = positive(np.atleast_2d(np.cov((f1 - f0 @ A.T).T)))
    P = positive(np.atleast_2d(np.cov(np.concatenate(scores).T)))

    rest = [e - f @ C.T for e, f in zip(left, scores, strict=True)]
    g0, g1, g5 = (_autocovariance(rest, k) for k in (0, *LAGS))
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = np.where((g1 > 0) & (g5 > 0), (np.maximum(g5, 0) / g1) ** (1 / (LAGS[1] - LAGS[0])), 0.5)
    rho = np.clip(rho, 0.0, SLOWEST)
    offset = np.clip(np.where(rho > 0, g1 / np.maximum(rho, 0.1), 0.0), 1e-3 * g0 + 1e-6, g0)
    r = np.maximum(g0 - offset, LEAST_NOISE)
    names = (*(f"factor {k + 1}" for k in range(count)), *(f"offset of {s.name}" for s in sensors))
    return StateSpace(
        A=block_diag(A, np.diag(rho)),
        B=np.zeros((count + N, X.shape[1])),
        C=np.hstack([C, np.eye(N)]),
        D=D,
        Q=block_diag(Q, np.diag((1 - rho**2) * offset)),
        r=r,
        P0=block_diag(P, np.diag(UNSEEN * offset)),
        names=names,
        sensors=(*(-1,) * count, *range(N)),
    )


def _autocovariance(parts: Sequence[Array], lag: int) -> Array:
    """Mean products (N,) of errors (K, N) and those `lag` samples later, of the readings that are known."""
    total, pairs = 0.0, 0
    for e in parts:
        if len(e) > lag:
            product = e[lag:] * e[: len(e) - lag]
            total, pairs = total + np.nansum(product, axis=0), pairs + np.isfinite(product).sum(axis=0)
    return np.asarray(total / np.maximum(pairs, 1))
