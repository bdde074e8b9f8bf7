"""Several sensors that read the same quantity: their weighted mean tells all that they tell about the state.

Sensors i of a group have the same row h of H and independent noise of variances R_i. With the information 1 / R_i of those in
use, a their sum,

    mean         sum_i y_i / R_i / a,  of variance h P h' + 1 / a
    contrasts    of each but the first: its reading less the weighted mean of those before it, of variance R_i + 1 / a_before

are independent of each other given the state, and no contrast depends on the state. So S^-1 = U U' with

    U = [D V, T]    S_mean^-1 = V V', D the weights of the means, T the contrasts over their standard deviations

where S_mean is as large as there are quantities, not sensors.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import compiled

Array = NDArray[Any]


class Repeated(NamedTuple):
    """Which sensors read the same: the number of the quantity that each reads (N,), 0 to `quantities` - 1; R of them (N,)."""

    group: Array
    quantities: int
    noise: Array


def repeated_readings(group: Array | None, H: Array, R: Array) -> Repeated | None:
    """The groups (N,) of sensors, where they have the same rows of H (N, n); None where they do not, or it differs by run."""
    if group is None or H.ndim > 2 or not (quantities := same_rows(H, group)):
        return None
    return Repeated(group, quantities, R)


@compiled
def same_rows(H: Array, group: Array) -> int:
    """How many groups (N,) there are, numbered from 0, if the rows of H (N, n) are the same within each; otherwise 0."""
    first, groups = np.full(group.size, -1), 0
    for i in range(group.size):
        k = first[group[i]]
        groups = max(groups, group[i] + 1)
        if k < 0:
            first[group[i]] = i
        else:
            for s in range(H.shape[1]):
                if H[i, s] != H[k, s]:
                    return 0
    return groups


@compiled
def mean_covariance(S: Array, used: Array, group: Array, quantities: int, R: Array) -> Array:
    """S_mean (B, quantities, quantities) of the sensors `used` (B, N), of S (B or 1, N, N); a quantity without any is apart."""
    B, N = used.shape
    found, first, second = np.zeros((B, quantities, quantities)), np.empty(quantities, np.int64), np.empty(quantities, np.int64)
    for r in range(B):
        of, information = S[r % S.shape[0]], np.zeros(quantities)
        first[:], second[:] = -1, -1
        for i in range(N):
            g = group[i]
            if used[r, i]:
                if first[g] < 0:
                    first[g] = i
                elif second[g] < 0:
                    second[g] = i
                information[g] += 1.0 / R[i]
        for g in range(quantities):
            if second[g] >= 0:  # without noise in common
                found[r, g, g] = of[first[g], second[g]] + 1.0 / information[g]
            else:
                found[r, g, g] = of[first[g], first[g]] if first[g] >= 0 else 1.0
            for h in range(g):
                if first[g] >= 0 and first[h] >= 0:
                    found[r, g, h] = found[r, h, g] = of[first[g], first[h]]
    return found


@compiled
def spread(V: Array, used: Array, group: Array, quantities: int, R: Array) -> Array:
    """U (B, N, N) of V (B, quantities, quantities): see the module; 0 for sensors not `used` (B, N)."""
    B, N = used.shape
    U = np.zeros((B, N, N))
    for r in range(B):
        information, column = np.zeros(quantities), quantities - 1
        seen = np.zeros(quantities, np.bool_)
        for i in range(N):
            g = group[i]
            column += seen[g]
            if used[r, i]:
                before, own = information[g], 1.0 / R[i]
                if before > 0.0:
                    size = np.sqrt(before * own / (before + own))
                    U[r, i, column] = size
                    for j in range(i):
                        if group[j] == g and used[r, j]:
                            U[r, j, column] = -size / (R[j] * before)
                information[g] += own
            seen[g] = True
        for i in range(N):
            if used[r, i]:
                weight = 1.0 / (R[i] * information[group[i]])
                for g in range(quantities):
                    U[r, i, g] = weight * V[r, group[i], g]
    return U
