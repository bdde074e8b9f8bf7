"""Vector autoregression with inputs, by regression with a ridge."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve

from fusion_sfdia.learning.identification.linear_gaussian import LEAST_NOISE
from fusion_sfdia.learning.identification.state_space import StateSpace, pairwise_covariance, positive
from fusion_sfdia.learning.identification.subspace import held
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

NOISE = 0.5  # share of a sensor's own error that counts as noise of its reading; the rest moves its state. The likelihood of
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
