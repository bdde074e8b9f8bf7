"""Compiled loops of the banks: for each run of a batch by itself, so that it has the bits that it has alone.

Arrays have one batch axis first, of B runs, or of 1 where they are the same for all. Products are written out for few sensors
and states, where a call of a library costs more than the product; larger ones are left to the library.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import python_first

Array = NDArray[Any]


def contiguous(a: Array) -> Array:
    """An array as compiled loops take it, contiguous and writeable: one type of arguments is compiled."""
    return a if a.flags.carray else np.array(a, order="C")


def of_runs(a: Array, axes: int) -> Array:
    """An array of so many axes of its own, (B, ..) or the same for all runs (..), as (B, ..) or (1, ..), contiguous."""
    return contiguous(a if a.ndim > axes else a[None])


@python_first
def conditioned(
    x: Array, whitened: Array, C: Array, half: Array, inverse: Array, P: Array, floor: float
) -> tuple[Array, Array, Array]:
    """Estimates x + C S^-1 d (B, n), P - W W' + floor diag(P) with W = C U, and K = C S^-1: `leave_one_out.posterior_and_gain`.

    x (B, n), whitened S^-1 d (B, N); C (B, n, N), U and S^-1 (B, N, N), P (B, n, n), each of 1 run where it is the same
    for all.
    """
    (B, n), N = x.shape, whitened.shape[1]
    E = max(C.shape[0], half.shape[0], P.shape[0])
    after, p, gain, W = np.empty((B, n)), np.empty((E, n, n)), np.zeros((E, n, N)), np.empty((n, N))
    for r in range(B):
        for i in range(n):
            total = 0.0
            for k in range(N):
                total += C[r % C.shape[0], i, k] * whitened[r, k]
            after[r, i] = x[r, i] + total
    for e in range(E):
        U, V, prior = half[e % half.shape[0]], inverse[e % inverse.shape[0]], P[e % P.shape[0]]
        for i in range(n):
            of, to, into = C[e % C.shape[0], i], W[i], gain[e, i]
            for j in range(N):
                to[j] = 0.0
            for k in range(N):
                for j in range(N):
                    to[j] += of[k] * U[k, j]
                    into[j] += of[k] * V[k, j]
        for i in range(n):
            for j in range(i + 1):
                total = 0.0
                for k in range(N):
                    total += W[i, k] * W[j, k]
                p[e, i, j] = prior[i, j] - total
                p[e, j, i] = prior[j, i] - total
            p[e, i, i] += floor * prior[i, i]
    return after, p, gain


@python_first
def mean_square(y: Array, expected: Array, whitened: Array, used: Array) -> Array:
    """D' S^-1 d (B,) over the number of readings used (B, N), of d = y - expected and whitened S^-1 d (B, N)."""
    found = np.empty(y.shape[0])
    for r in range(y.shape[0]):
        total, count = 0.0, 0
        for i in range(y.shape[1]):
            if used[r, i]:
                total += (y[r, i] - expected[r, i]) * whitened[r, i]
                count += 1
        found[r] = total / max(count, 1)
    return found


@python_first
def mean_of_others(chi_square: Array, used: Array) -> Array:
    """The mean of the chi-squares (B, N), 0 where not `used` (B, N), without the largest (B,); 1 of fewer than two."""
    found = np.empty(used.shape[0])
    for r in range(used.shape[0]):
        found[r] = 1.0
        total, largest, count = 0.0, chi_square[r, 0], 0
        for i in range(used.shape[1]):
            total += chi_square[r, i]
            largest = max(largest, chi_square[r, i])
            count += used[r, i]
        if count > 1:
            found[r] = (total - largest) / (count - 1)
    return found
