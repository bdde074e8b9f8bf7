"""Sums of covariances, each in one pass over its numbers, where calls of a library would take a pass for each operation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import compiled, plain, python_first

Array = NDArray[Any]


def symmetric_sum(M: Array, D: Array) -> Array:
    """(M + M') / 2 + D of M (..., m, m), which may be written to, and D (..., m, m), or (m,) its diagonal."""
    m = M.shape[-1]
    total = plain(M.reshape(-1, m, m))
    _symmetric_sum(total, plain(D) if D.ndim == 1 else np.zeros(m))
    found: Array = total.reshape(M.shape)
    return found if D.ndim == 1 else found + D


@compiled
def _symmetric_sum(M: Array, D: Array) -> None:
    """The same of M (B, m, m) and D (m,), in place."""
    for k in range(M.shape[0]):
        of = M[k]
        for i in range(M.shape[1]):
            for j in range(i):
                of[i, j] = of[j, i] = (of[i, j] + of[j, i]) * 0.5
            of[i, i] += D[i]


def difference(P: Array, less: Array, floor: float) -> Array:
    """P - less + floor diag(P) of P (..., n, n) and less (..., n, n), which may be written to; P may be the same for all."""
    n = P.shape[-1]
    shape = less.shape if less.shape == P.shape else np.broadcast_shapes(P.shape, less.shape)
    total = plain((less if less.shape == shape else np.broadcast_to(less, shape)).reshape(-1, n, n))
    one = P if P.ndim == 3 and P.shape[0] in {1, len(total)} else np.broadcast_to(P, shape)
    _difference(plain(one.reshape(-1, n, n)), total, floor)
    return total.reshape(shape)


@python_first
def _difference(P: Array, less: Array, floor: float) -> None:
    """The same of P (B, n, n) or (1, n, n) and `less` (B, n, n), in place."""
    for k in range(less.shape[0]):
        of, to = P[k % P.shape[0]], less[k]
        for i in range(to.shape[0]):
            for j in range(to.shape[1]):
                to[i, j] = of[i, j] - to[i, j]
            to[i, i] += floor * of[i, i]
