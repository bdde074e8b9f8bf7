"""Products with Jacobians of which most entries are 0: of a network, or of sensors that each read one state."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import repeated, single
from fusion_sfdia.derivatives.equation import compiled, plain

Array = NDArray[Any]


def congruence(A: Array, P: Array, D: Array) -> tuple[Array, Array]:
    """Return A P A' + D (..., m, m), symmetric to the bit but for D, and P A' (..., n, m).

    A (..., m, n), symmetric P (..., n, n), D (..., m, m), or (m,) its diagonal.
    """
    batch, n = P.shape[:-2], P.shape[-1]
    m = A.shape[-2]
    rows = A.reshape(1 if A.ndim == 2 else -1, m, n)
    if len(rows) > 1 and A.shape[:-2] != batch:
        rows = np.broadcast_to(A, (*batch, m, n)).reshape(-1, m, n)
    diagonal = D if D.ndim == 1 else np.zeros(m)
    both, one = _congruence(plain(rows), plain(P.reshape(-1, n, n)), plain(diagonal))
    if len(batch) != 1:
        both, one = both.reshape(*batch, m, m), one.reshape(*batch, m, n)
    return both if D.ndim == 1 else both + D, np.swapaxes(one, -1, -2)


def variances(A: Array, P: Array) -> Array:
    """Return the diagonal (..., m) of A P A', of A (m, n) or (..., m, n) and symmetric P (..., n, n)."""
    one = single(P) if A.ndim == 2 else P
    n, m = P.shape[-1], A.shape[-2]
    rows = A if A.ndim == 2 else np.broadcast_to(A, (*P.shape[:-2], m, n))
    found = _variances(plain(rows.reshape(-1, m, n)), plain(one.reshape(-1, n, n)))
    return repeated(found.reshape(*one.shape[:-2], m), P)


@compiled
def _congruence(A: Array, P: Array, D: Array) -> tuple[Array, Array]:
    """A P A' + D (B, m, m) and A P (B, m, n) of A (B, m, n) or (1, m, n), P (B, n, n) and D (m,)."""
    B, n = P.shape[:2]
    m = A.shape[1]
    both, one, turned = np.empty((B, m, m)), np.empty((B, m, n)), np.empty((n, m))
    first, column, factor = np.empty(m + 1, np.int64), np.empty(m * n, np.int64), np.empty(m * n)
    first[0] = 0
    for k in range(B):
        if k < A.shape[0]:  # otherwise it is that of the run before
            found = 0
            for i in range(m):
                row = A[k, i]
                for s in range(n):
                    if row[s] != 0:
                        column[found], factor[found] = s, row[s]
                        found += 1
                first[i + 1] = found
        for i in range(m):
            into = one[k, i]
            for j in range(n):
                into[j] = 0.0
            for f in range(first[i], first[i + 1]):
                out_of, by = P[k, column[f]], factor[f]
                for j in range(n):
                    into[j] += by * out_of[j]
            for j in range(n):
                turned[j, i] = into[j]
        for i in range(m):
            into = both[k, i]
            for j in range(i + 1):
                into[j] = 0.0
            for f in range(first[i], first[i + 1]):
                out_of, by = turned[column[f]], factor[f]
                for j in range(i + 1):
                    into[j] += by * out_of[j]
            for j in range(i):
                both[k, j, i] = into[j]
            into[i] += D[i]
    return both, one


@compiled
def _variances(A: Array, P: Array) -> Array:
    B, n = P.shape[:2]
    m = A.shape[1]
    found, column = np.zeros((B, m)), np.empty(n, np.int64)
    for k in range(B):
        for i in range(m):
            row, few = A[k % A.shape[0], i], 0
            for s in range(n):
                if row[s] != 0:
                    column[few] = s
                    few += 1
            for f in range(few):
                for g in range(few):
                    found[k, i] += row[column[f]] * P[k, column[f], column[g]] * row[column[g]]
    return found
