"""How far local filters are from each other and from their mixture: the statistics (19) and (20) of Shaheen 2024."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import compiled
from fusion_sfdia.detectors.kalman_banks.bank_kernels import contiguous

Array = NDArray[Any]


def disagreement(local: Array, seen: Array, mixed: Array, scale: Array) -> tuple[Array, Array]:
    """Return the variance (19) of each expected reading over the filters, and the distance (20) of each filter, (..., N).

    Printed, (19) is of the states; the two are the same where every state has a sensor, as in the paper.

    local (..., N, n): estimates x_i of the filters; seen (..., N, N): readings that they expect, a row a filter;
    mixed (..., n): x_m; scale (n,), by which the states are divided:

        variance_s = sum_i (seen_is - mean_s)^2 / N,    distance_i = |(x_i - x_m) / scale|
    """
    variance, distance = _disagreement(contiguous(local), contiguous(seen), contiguous(mixed), scale)
    return variance, distance


@compiled
def _disagreement(local: Array, seen: Array, mixed: Array, scale: Array) -> tuple[Array, Array]:
    B, N, n = local.shape
    variance, distance = np.zeros((B, seen.shape[2])), np.empty((B, N))
    mean, square = np.empty(seen.shape[2]), np.empty(n)
    for r in range(B):
        mean[:] = 0.0
        for i in range(N):
            mean += seen[r, i]
        mean /= N
        into, centre = variance[r], mixed[r]
        for i in range(N):
            of = seen[r, i]
            for s in range(mean.size):
                into[s] += (of[s] - mean[s]) ** 2
        into /= N
        for i in range(N):
            of, width = local[r, i], n
            for j in range(n):
                square[j] = ((of[j] - centre[j]) / scale[j]) ** 2
            while width > 1:  # by halves: one number after the other would wait for each sum
                half = (width + 1) // 2
                for j in range(width - half):
                    square[j] += square[half + j]
                width = half
            distance[r, i] = np.sqrt(square[0])
    return variance, distance
