"""Cholesky factors and their inverses, written out: calls of LAPACK, matrix by matrix, take longer up to a few hundred rows.

Each loop takes four rows at once, so that a number is read once for four products. No number depends on the processor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import compiled, part, python_first

Array = NDArray[Any]


@compiled
def half_inverses(A: Array, used: Array) -> None:
    """A <- U with U U' = A^-1 of symmetric A (B, n, n), in place; NaN where A is not positive definite and finite.

    used (B, n), or (1, n) for all: rows and columns to take; the others are left out as if they did not exist, and 0 in U.
    """
    n = A.shape[1]
    X, factor = np.empty((n, n)), np.empty(n)
    for i in range(n):
        for j in range(n):
            X[i, j] = 0.0
    for b in range(A.shape[0]):
        of, take = A[b], used[b % used.shape[0]]
        for i in range(n):
            if not take[i]:
                for j in range(n):
                    of[i, j] = of[j, i] = 0.0
                of[i, i] = 1.0
        if factorise(of):
            invert(of, X, factor)
        else:
            for i in range(n):
                for j in range(n):
                    of[i, j] = np.nan
        for i in range(n):
            if not take[i]:
                for j in range(n):
                    of[i, j] = 0.0


@python_first
def inverted(S: Array, d: Array, used: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Statistics of innovations d (B, N) with covariance S (B, N, N), over the readings `used` (B, N): see `leave_one_out`.

    U (B, N, N) with S^-1 = U U' and U' d; S^-1, S^-1 d and its diagonal; NaN where S is not positive definite.
    """
    B, N = d.shape
    half, inverse = np.empty((B, N, N)), np.empty((B, N, N))
    scores, whitened, weight = np.empty((B, N)), np.empty((B, N)), np.empty((B, N))
    for r in range(B):
        for i in range(N):
            for j in range(N):
                half[r, i, j] = S[r % S.shape[0], i, j]
    half_inverses(half, used)
    for r in range(B):
        for i in range(N):
            for j in range(i + 1):
                total = 0.0
                for k in range(i, N):
                    total += half[r, i, k] * half[r, j, k]
                inverse[r, i, j] = inverse[r, j, i] = total
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


@python_first
def squares_of_rows(U: Array) -> Array:
    """The sums of squares (B, n) of the rows of U (B, n, m): diag(U U'). BLAS's depend on where a row begins in memory."""
    B, n, m = U.shape
    found, whole = np.empty((B, n)), m - m % 4
    for b in range(B):
        for i in range(n):
            row = U[b, i]
            s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
            for j in range(0, whole, 4):
                s0 += row[j] * row[j]
                s1 += row[j + 1] * row[j + 1]
                s2 += row[j + 2] * row[j + 2]
                s3 += row[j + 3] * row[j + 3]
            for j in range(whole, m):
                s0 += row[j] * row[j]
            found[b, i] = (s0 + s1) + (s2 + s3)
    return found


@part
def factorise(R: Any) -> Any:
    """R <- upper triangular R with R' R = the given matrix, of which the upper triangle counts; whether there is a finite one.

    Row by row, four at once: the product of the four with what is left is subtracted from the rows below.
    """
    n = R.shape[0]
    for first in range(0, n, 4):
        past = min(first + 4, n)
        for k in range(first, past):
            row = R[k]
            for i in range(first, k):
                f, above = R[i, k], R[i]
                for j in range(np.uintp(k), np.uintp(n)):  # unsigned: otherwise numba makes no vector instructions
                    row[j] -= f * above[j]
            if not (row[k] > 0.0 and row[k] < np.inf):
                return False
            row[k] = np.sqrt(row[k])
            inverse = 1.0 / row[k]
            for j in range(np.uintp(k + 1), np.uintp(n)):
                row[j] *= inverse
            for j in range(k):
                row[j] = 0.0
        if past < n:
            r0, r1, r2, r3 = R[first], R[first + 1], R[first + 2], R[first + 3]
            for i in range(past, n):
                f0, f1, f2, f3, row = r0[i], r1[i], r2[i], r3[i], R[i]
                for j in range(np.uintp(i), np.uintp(n)):
                    row[j] -= f0 * r0[j] + f1 * r1[j] + f2 * r2[j] + f3 * r3[j]
    return True


@part
def invert(R: Any, X: Any, factor: Any) -> None:
    """R <- R^-1 of upper triangular R; X (n, n), 0 above its diagonal, and factor (n,) are workspace.

    The rows of X = (R')^-1, which are the columns of the inverse, one after the other (Higham, Accuracy and Stability of
    Numerical Algorithms, 2nd ed., sec. 14.2): X_i = (e_i - sum_{k < i} R_ki X_k) / R_ii.
    """
    for i in range(R.shape[0]):
        row, inverse = X[i], 1.0 / R[i, i]
        for k in range(i):
            factor[k] = R[k, i]
            row[k] = 0.0
        together = i - i % 4
        for k in range(0, together, 4):
            f0, f1, f2, f3 = factor[k], factor[k + 1], factor[k + 2], factor[k + 3]
            x0, x1, x2, x3 = X[k], X[k + 1], X[k + 2], X[k + 3]
            for j in range(k + 4):
                row[j] -= f0 * x0[j] + f1 * x1[j] + f2 * x2[j] + f3 * x3[j]
        for k in range(together, i):
            f, above = factor[k], X[k]
            for j in range(k + 1):
                row[j] -= f * above[j]
        for j in range(i):
            row[j] *= inverse
            R[j, i] = row[j]
        row[i] = R[i, i] = inverse
