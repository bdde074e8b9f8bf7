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
def shift(a: Array, b: Array, age: Array, places: Array) -> tuple[Array, Array, Array]:
    """Sums a (B, L, q), b (B or 1, L, q) and age (B, L) with the onset of each slot taken from the slot `places` (L,), a new one
    where negative.
    """
    sums, squares, ages = np.empty_like(a), np.empty_like(b), np.empty_like(age)
    for r in range(a.shape[0]):
        for l in range(places.shape[0]):  # noqa: E741
            k = places[l]
            if k < 0:
                sums[r, l] = 0.0
                if r < b.shape[0]:
                    squares[r, l] = 0.0
                ages[r, l] = 1.0
            else:
                sums[r, l] = a[r, k]
                if r < b.shape[0]:
                    squares[r, l] = b[r, k]
                ages[r, l] = age[r, k] + 1.0
    return sums, squares, ages


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
def carried(
    eta: Array,
    old: Array,
    A: Array,
    leading: int,
    places: Array,
    FK: Array,
    readings: Array,
    change: Array,
    once: int,
    age: Array,
) -> None:
    """Complete eta (B, n, L, q) from what stood in the slots `places` (L,) of `old`: see `weigh`.

    It has the products of A (B, n, n) with the leading states; those with the others, F K D and -C are added. readings (B, L):
    D of `old`. change (B, n, r): C, the first `once` at the onset only. age (B, L). Of 1 run where eta is the same for all.
    """
    B, n, L, q = eta.shape
    N, r = FK.shape[2], change.shape[2]
    zero = eta.dtype.type(0)
    for k in range(B):
        f, c = k % A.shape[0], k % change.shape[0]
        for i in range(n):
            row = FK[k % FK.shape[0], i]
            for l in range(L):  # noqa: E741
                into, at = eta[k, i, l], places[l]
                if at < 0:
                    into[:] = zero
                else:
                    factor = eta.dtype.type(readings[k, at])
                    for j in range(N):
                        into[j] += factor * row[j]
            for s in range(leading, n):
                factor = A[f, i, s]
                if factor != 0:
                    for l in range(L):  # noqa: E741
                        if places[l] >= 0:
                            into, out_of = eta[k, i, l], old[k % old.shape[0], s, places[l]]
                            for j in range(q):
                                into[j] += factor * out_of[j]
            for l in range(L):  # noqa: E741
                into, out_of = eta[k, i, l, q - r :], change[c, i]
                for j in range(0 if age[k, l] <= 1 else once, r):
                    into[j] -= out_of[j]


@compiled
def summed(M: Array, half: Array, scores: Array, readings: Array, a: Array, b: Array) -> None:
    """Add the present innovations to a (B, L, q) and b (B or 1, L, q), in place: see `weigh`.

    M (B, K, N, q): -U' H eta of the last K slots, 0 in those before. half U' (B, N, N), scores U' d (B, N), readings D (B, L).
    M and b are of 1 run, and U' and D too, where they are the same for all.
    """
    B, L, q = a.shape
    N, known = M.shape[2], L - M.shape[1]
    alike = B // M.shape[0]
    row, sums, squares = np.empty(q, M.dtype), np.empty((alike, q), M.dtype), np.empty(q, M.dtype)
    zero = M.dtype.type(0)
    for k in range(M.shape[0]):
        for l in range(L):  # noqa: E741
            D = M.dtype.type(readings[k % readings.shape[0], l])
            sums[:] = zero
            squares[:] = zero
            for i in range(N):
                direct = half[k % half.shape[0], i]
                if l < known:
                    row[:] = zero
                else:
                    row[:] = M[k, l - known, i]
                for j in range(N):
                    row[j] += D * direct[j]
                for r in range(alike):
                    score, into = scores[k * alike + r, i], sums[r]
                    for j in range(q):
                        into[j] += score * row[j]
                for j in range(q):
                    squares[j] += row[j] * row[j]
            for r in range(alike):
                for j in range(q):
                    a[k * alike + r, l, j] += sums[r, j]
            for j in range(q):
                b[k, l, j] += squares[j]


@compiled
def best(a: Array, b: Array, usable: Array, size: Array, first: int, least: float) -> tuple[Array, Array, Array, Array, Array]:
    """Statistic, size, information, evidence and slot (B, q) of the best onset from the slot `first` on, see `best_onset`.

    size (B, L, q), (1, L, q) or (1, 1, q): standard deviations before any reading; usable (B, q).
    """
    B, L, q = a.shape
    statistic, found, information = np.zeros((B, q)), np.zeros((B, q)), np.ones((B, q))
    evidence, slot = np.full((B, q), -np.inf), np.full((B, q), first)
    for r in range(B):
        for l in range(first, L):  # noqa: E741
            for j in range(q):
                s = size[r % size.shape[0], l % size.shape[1], j]
                expected = b[r, l, j] * (s * s)
                if usable[r, j] and expected > least:
                    value = a[r, l, j] ** 2 / b[r, l, j]
                    if evidence[r, j] == -np.inf or value > statistic[r, j]:
                        statistic[r, j], slot[r, j] = value, l
                        evidence[r, j] = expected
        for j in range(q):
            if evidence[r, j] > -np.inf:
                l, expected = slot[r, j], evidence[r, j]  # noqa: E741
                information[r, j] = b[r, l, j]
                found[r, j] = a[r, l, j] / information[r, j]
                statistic[r, j] = found[r, j] ** 2 * information[r, j]
                evidence[r, j] = statistic[r, j] * (expected / (1.0 + expected)) - np.log1p(expected)
    return statistic, found, information, evidence, slot
