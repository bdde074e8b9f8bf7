"""The extended Kalman filter; with matrices for models, the linear Kalman filter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import repeated, single
from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.filters import small, sparse
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.filters.sums import symmetric_sum

Array = NDArray[Any]
Model = Callable[[Array], Array]


def predict(x: Array, P: Array, f: Model, F: Array | None, Q: Array, few: bool = False) -> tuple[Array, Array]:
    """Return x <- f(x), P <- F P F' + Q  (Shaheen 2024, sec. III-C1).

    x (..., n), P (..., n, n), f on batches, Q (n,) or (..., n, n); F (n, n) or (..., n, n) is the Jacobian of f at x, None
    for the complex step's (f must then be analytic). few: whether most entries of F are 0.
    """
    F = complex_step_jacobian(f, x) if F is None else F
    ahead, _ = _congruence(F, single(P) if F.ndim == 2 else P, Q, few)
    return f(x), repeated(ahead, P)


def joint(x: Array, P: Array, h: Model, H: Array | None, R: Array, few: bool = False) -> Joint:
    """Return the joint Gaussian of state and readings: y = h(x), C = P H', S = H P H' + R  (Shaheen 2024, sec. III-C1).

    x (..., n), P (..., n, n), h on batches, R (N,) or (..., N, N); H (N, n) or (..., N, n) is the Jacobian of h at x, None
    for the complex step's (h must then be analytic). few: whether most entries of H are 0.
    """
    H = complex_step_jacobian(h, x) if H is None else H
    S, C = _congruence(H, single(P) if H.ndim == 2 else P, R, few)
    return Joint(x, P, h(x), S if P.ndim == 2 else repeated(S, P), repeated(C, P), H=H)


def _congruence(A: Array, P: Array, D: Array, few: bool) -> tuple[Array, Array]:
    """A P A' + D (..., m, m) and P A' (..., n, m), in the way that takes least time; few: whether most entries of A are 0."""
    if small.is_small(A):
        return small.congruence(A, P, D)
    if few:
        return sparse.congruence(A, P, D)
    right = P @ np.swapaxes(A, -1, -2)
    return symmetric_sum(A @ right, D), right
