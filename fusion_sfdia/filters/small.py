"""Products of few states and sensors, written out: calls of a library would take longer than the products."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import plain, python_first

Array = NDArray[Any]

LARGEST = 12  # rows and columns, up to which this takes less time for many runs, too


def is_small(A: Array) -> bool:
    """Whether A (..., m, n) has so few rows and columns."""
    return bool(max(A.shape[-2:]) <= LARGEST)


def congruence(A: Array, P: Array, D: Array) -> tuple[Array, Array]:
    """Return A P A' + D (..., m, m), symmetric to the bit but for D, and P A' (..., n, m).

    A (m, n) or (..., m, n), symmetric P (..., n, n), D (..., m, m), or (m,) its diagonal.
    """
    batch, (m, n) = P.shape[:-2], A.shape[-2:]
    rows = A if A.ndim == 2 or A.shape[:-2] == batch else np.broadcast_to(A, (*batch, m, n))
    diagonal = D if D.ndim == 1 else np.zeros(m)
    both, right = _congruence(plain(rows.reshape(-1, m, n)), plain(P.reshape(-1, n, n)), plain(diagonal))
    if len(batch) != 1:
        both, right = both.reshape(*batch, m, m), right.reshape(*batch, n, m)
    return both if D.ndim == 1 else both + D, right


@python_first
def _congruence(A: Array, P: Array, D: Array) -> tuple[Array, Array]:
    """The same of A (B, m, n) or (1, m, n), P (B, n, n) and D (m,)."""
    B, n = P.shape[:2]
    m = A.shape[1]
    both, right = np.empty((B, m, m)), np.empty((B, n, m))
    for k in range(B):
        a, p, pa, apa = A[k % A.shape[0]], P[k], right[k], both[k]
        for s in range(n):
            for i in range(m):
                total = 0.0
                for r in range(n):
                    total += p[s, r] * a[i, r]
                pa[s, i] = total
        for i in range(m):
            for j in range(i + 1):
                total = 0.0
                for s in range(n):
                    total += a[i, s] * pa[s, j]
                apa[i, j] = apa[j, i] = total
            apa[i, i] += D[i]
    return both, right
