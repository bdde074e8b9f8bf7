"""What all windows of likelihood ratios of one filter have in common in a step, see `likelihood_window`.

The update of the step before and the prediction are one product. With H, K of that update, and D of its readings,

    eta <- A eta + F K D - C,    A = F - F K H

and with S^-1 = U U' of the present readings

    a <- a + (U' M)' U' d,    b <- b + diag((U' M)' U' M),    U' M = U' D - U' H eta
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import for_all, repeated, single
from fusion_sfdia.detectors.kalman_banks.bank_kernels import contiguous, of_runs
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut
from fusion_sfdia.detectors.kalman_banks.window_kernels import transition

Array = NDArray[Any]

NUMBERS: type = np.float32  # of eta and M: their rounding is far below the noise, and products take half the time


class LastUpdate(NamedTuple):
    """The gain K (..., n, N) of the last update and H (..., N, n) of its readings."""

    gain: Array
    readout: Array


class WindowStep(NamedTuple):
    """A step of B runs.

    A (B, n, n), its columns of the first states, which are dense, FK (B, n, N). H (B, N, n), half U' (B, N, N), seen -U' H
    (B, rank, d) of the states that are read, its other rows being 0, scores U' d (B, N). Those but U' d are of 1 run where they
    are the same for all.
    """

    A: Array
    leading: Array
    FK: Array
    H: Array
    half: Array
    seen: Array
    scores: Array


def no_update(batch: tuple[int, ...], states: int, sensors: int) -> LastUpdate:
    """Return what stands for the update before the first readings."""
    K: Array = np.zeros((states, sensors))
    return LastUpdate(for_all(K, batch), for_all(K.T, batch))


def window_step(
    last: LastUpdate, tangent: Array, output_jacobian: Array, found: LeaveOneOut, kind: Any, leading: int | None = None
) -> WindowStep:
    """Return what a step has in common; tangent F (..., n, n) of the step just taken, H (..., N, n), all sensors in use.

    kind: of the numbers. leading: the states behind these are those on which few others depend, and no reading: of the products
    with them only those are taken whose factor is not 0 (None: all are dense).
    """
    assert found.half is not None and found.scores is not None
    n = tangent.shape[-1]
    d = n if leading is None else leading
    read = n if d < n and (output_jacobian[..., d:].any() or last.readout[..., d:].any()) else d
    F, H = of_runs(tangent, 2), of_runs(output_jacobian, 2)
    K, before = (contiguous(single(v)) for v in last)
    half = contiguous(single(found.half))
    turned = np.empty(half.shape, kind)
    rank = half.shape[-1] if found.rank is None else found.rank
    A, columns, FK, seen = transition(F, K, before, H, half, turned, (d, read, rank))
    return WindowStep(A, columns, FK, H, turned, seen, contiguous(found.scores.astype(kind, copy=False)))


def last_update(step: WindowStep, gain: Array, restart: Array) -> LastUpdate:
    """Return the update with gain K (..., n, N); restart (...): runs whose windows restart, in which it has no effect."""
    K = np.where(restart[..., None, None], 0.0, gain) if restart.any() else gain
    return LastUpdate(K, repeated(step.H, K))
