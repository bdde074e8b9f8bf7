"""The extended Kalman filter; with matrices for models, the linear Kalman filter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.alike import repeated, single
from fusion_sfdia.core.equation import complex_step_jacobian
from fusion_sfdia.filters import small
from fusion_sfdia.filters.gaussian import Joint, add, symmetrise
from fusion_sfdia.filters.sparse import congruence

Array = NDArray[Any]
Model = Callable[[Array], Array]


def predict(x: Array, P: Array, f: Model, F: Array | None, Q: Array, sparse: bool = False) -> tuple[Array, Array]:
    """Return x <- f(x), P <- F P F' + Q  (Shaheen 2024, sec. III-C1).

    x (..., n), P (..., n, n), f on batches, Q (n,) or (..., n, n); F (n, n) or (..., n, n) is the Jacobian of f at x, None
    for the complex step's (f must then be analytic). sparse: whether most entries of F are 0.
    """
    F = complex_step_jacobian(f, x) if F is None else F
    one = single(P) if F.ndim == 2 else P
    if small.is_small(F):
        return f(x), repeated(small.congruence(F, one, Q)[0], P)
    ahead = congruence(F, one)[0] if sparse else symmetrise(F @ one @ np.swapaxes(F, -1, -2))
    return f(x), repeated(add(ahead, Q), P)


def joint(x: Array, P: Array, h: Model, H: Array | None, R: Array, sparse: bool = False) -> Joint:
    """Return the joint Gaussian of state and readings: y = h(x), C = P H', S = H P H' + R  (Shaheen 2024, sec. III-C1).

    x (..., n), P (..., n, n), h on batches, R (N,) or (..., N, N); H (N, n) or (..., N, n) is the Jacobian of h at x, None
    for the complex step's (h must then be analytic). sparse: whether most entries of H are 0.
    """
    H = complex_step_jacobian(h, x) if H is None else H
    one = single(P) if H.ndim == 2 else P
    if small.is_small(H):
        S, C = small.congruence(H, one, R)
    elif sparse:
        HPH, HP = congruence(H, one)
        S, C = add(HPH, R), np.swapaxes(HP, -1, -2)
    else:
        C = one @ np.swapaxes(H, -1, -2)
        S = add(symmetrise(H @ C), R)
    return Joint(x, P, h(x), S if P.ndim == 2 else repeated(S, P), repeated(C, P), H=H)
