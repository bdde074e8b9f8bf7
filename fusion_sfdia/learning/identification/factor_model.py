"""Common factors of all sensors, and a slow offset of each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, solve

from fusion_sfdia.learning.identification.linear_gaussian import LEAST_NOISE
from fusion_sfdia.learning.identification.state_space import StateSpace, pairwise_covariance, positive
from fusion_sfdia.learning.identification.subspace import held
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

LAGS = (1, 5)  # samples, of the two autocovariances that separate an offset from noise
UNSEEN = 4.0  # variance of the offset at the start of a run that was not learnt from, over that of the others
SLOWEST = 0.9995  # largest autocorrelation of an offset from one sample to the next: changes over some hours at 1 Hz


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
