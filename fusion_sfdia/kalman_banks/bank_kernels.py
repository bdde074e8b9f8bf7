"""Compiled loops of the banks: for each run of a batch by itself, so that it has the bits that it has alone.

Arrays have one batch axis first, of B runs, or of 1 where they are the same for all. Products are written out for few sensors
and states, where a call of a library costs more than the product; larger ones are left to the library.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.equation import compiled

Array = NDArray[Any]


def runs(a: Array, batch: tuple[int, ...]) -> Array:
    """An array (*batch, ..) as (B, ..), contiguous and writeable, so that one type of arguments is compiled."""
    rows = a if len(batch) == 1 else a.reshape(-1, *a.shape[len(batch) :])
    return rows if rows.flags.carray else np.array(rows, order="C")


def common(a: Array, batch: tuple[int, ...], axes: int) -> Array:
    """An array (*batch, ..) or (..) of so many axes of its own as (B, ..) or (1, ..)."""
    if a.ndim == axes:
        return runs(a[None], (1,))
    lead = a.shape[: a.ndim - axes]
    return runs(a if lead == batch else np.broadcast_to(a, (*batch, *a.shape[a.ndim - axes :])), batch)


@compiled
def inverted(S: Array, d: Array, used: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Statistics of innovations d (B, N) with covariance S (B, N, N), over the readings `used` (B, N): see `leave_one_out`.

    U (B, N, N) with S^-1 = U U' and U' d; S^-1, S^-1 d and its diagonal. By Cholesky's factor of the matrix scaled to a unit
    diagonal; NaN where it is not positive definite.
    """
    B, N = d.shape
    half, inverse = np.empty((B, N, N)), np.empty((B, N, N))
    scores, whitened, weight = np.empty((B, N)), np.empty((B, N)), np.empty((B, N))
    scale, L, T = np.empty(N), np.empty((N, N)), np.zeros((N, N))
    for r in range(B):
        sound = True
        for i in range(N):
            variance = S[r, i, i] if used[r, i] else 1.0
            scale[i] = 1.0 / np.sqrt(variance) if variance > 0 else np.nan
            for j in range(i + 1):
                together = (used[r, i] and used[r, j]) or (i == j and not used[r, i])
                total = (S[r, i, j] if used[r, i] else 1.0) * (scale[i] * scale[j]) if together else 0.0
                for k in range(j):
                    total -= L[i, k] * L[j, k]
                if i == j:
                    sound = sound and total > 0 and total < np.inf
                    L[i, i] = np.sqrt(total) if sound else np.nan
                else:
                    L[i, j] = total / L[j, j]
        for j in range(N):  # T = L^-1
            for i in range(j, N):
                total = 1.0 if i == j else 0.0
                for k in range(j, i):
                    total -= L[i, k] * T[k, j]
                T[i, j] = total / L[i, i]
        for i in range(N):
            for j in range(N):
                half[r, i, j] = 0.0
                if used[r, i]:
                    half[r, i, j] = np.nan if not sound else scale[i] * T[j, i] if j >= i else 0.0
        for i in range(N):
            for j in range(i + 1):
                total = 0.0
                for k in range(i, N):
                    total += half[r, i, k] * half[r, j, k]
                inverse[r, i, j] = inverse[r, j, i] = total if sound else np.nan
            weight[r, i] = inverse[r, i, i]
        for i in range(N):
            total = 0.0
            for k in range(N):
                total += half[r, k, i] * d[r, k]
            scores[r, i] = total
        for i in range(N):
            total = 0.0
            for k in range(N):
                total += inverse[r, i, k] * d[r, k]
            whitened[r, i] = total
    return half, inverse, scores, whitened, weight


@compiled
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


@compiled
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


@compiled
def mean_of_others(chi_square: Array, used: Array) -> Array:
    """The mean of the chi-squares (B, N), 0 where not `used` (B, N), without the largest (B,); 1 of fewer than two."""
    found = np.ones(used.shape[0])
    for r in range(used.shape[0]):
        total, largest, count = 0.0, chi_square[r, 0], 0
        for i in range(used.shape[1]):
            total += chi_square[r, i]
            largest = max(largest, chi_square[r, i])
            count += used[r, i]
        if count > 1:
            found[r] = (total - largest) / (count - 1)
    return found
