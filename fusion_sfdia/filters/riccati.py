"""The covariance that a Kalman filter of a time-invariant linear plant tends to."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve

from fusion_sfdia.filters.gaussian import dense, symmetrise

Array = NDArray[Any]

DOUBLINGS = 20  # the covariance after 2^20 steps
CONVERGED = 1e-10  # relative change by a doubling, which is the square root of that by the next


def steady_prediction(F: Array, H: Array, Q: Array, R: Array) -> Array | None:
    """P (n, n) = F P F' - F P H' (H P H' + R)^-1 H P F' + Q, the covariance of a prediction; None where there is none.

    F (n, n), H (N, n), Q (n,) or (n, n), R (N,), its diagonal. By structure-preserving doubling (Chu, Fan, Lin and Wang 2004):

        A = F', G = H' R^-1 H, P = Q;    W = (I + G P)^-1,    A, G, P <- A W A, G + A W G A', P + A' P W A
    """
    A, G, P = F.T, (H.T / R) @ H, dense(Q)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(DOUBLINGS):
            factors = lu_factor(np.eye(len(F)) + G @ P)
            ahead, spread = lu_solve(factors, A), lu_solve(factors, G @ A.T)
            more = symmetrise(A.T @ P @ ahead)
            G, P, A = symmetrise(G + A @ spread), P + more, A @ ahead
            if not all(np.all(np.isfinite(M)) for M in (A, G, P)):
                return None
            if np.all(np.diagonal(more) <= CONVERGED * np.diagonal(P)):
                return P
    return None
