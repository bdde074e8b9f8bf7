"""Fault functions phi(x, u, e) of an area (Boem et al. 2018, "B18", sec. IV): their check, their values and derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
FaultFunction = Callable[[Array, Array, Array], Array]


def require_fault_functions(faults: Mapping[str, FaultFunction], n: int) -> None:
    """Raise ValueError for a function that does not give (..., n) finite numbers for x (..., n), u (...), e (...)."""
    for name, phi in faults.items():
        given = np.asarray(phi(np.zeros((3, n)), np.zeros(3), np.zeros(3)))
        if given.shape != (3, n) or given.dtype.kind not in "fi" or not np.all(np.isfinite(given)):
            raise ValueError(
                f"the fault function of {name!r} gives {given.dtype} {given.shape} for states (3, {n}); expected {n} "
                f"finite numbers for each of them, (3, {n})"
            )


class Effects(NamedTuple):
    """What L faults add to the next state, from readings with noise: mean (B, L, n), slopes (B, L, n, n + 1) by state and by e,
    and the variance (B, L, n) of what is of second order.
    """

    mean: Array
    slopes: Array
    curvature: Array


def effects(faults: Mapping[str, FaultFunction], x: Array, u: Array, e: Array, width: Array, variance: Array) -> Effects:
    """Return the effects to second order. x (B, L, n), u (B, 1), e (B, 1): as read. width (n + 1,): of the differences by x and
    e. variance (B, L, n + 1): of the noise of x and e.

    With d_i phi and d_ij phi the first and second derivatives, for Gaussian noise r of variances v in z + r

        E[phi(z + r)] = phi(z) + sum_i v_i d_ii phi / 2,    Var = sum_i v_i (d_i phi)^2 + sum_ij v_i v_j (d_ij phi)^2 / 2

    so the mean is phi as read less its second derivatives, and the last sum is the curvature: exact up to quadratic phi. What
    is not read has no noise here: of its error only the slope counts.
    """
    n = x.shape[-1]
    first, second = np.triu_indices(n + 1, 1)
    both = np.diag(width)[first] + np.diag(width)[second]
    shifts = np.concatenate([np.zeros((1, n + 1)), np.diag(width), -np.diag(width), both, -both])
    means, slopes, curvatures = [], [], []
    for one, phi in enumerate(faults.values()):
        points = np.concatenate([x[:, one], e], axis=-1)[:, None] + shifts
        found = np.asarray(phi(points[..., :n], np.broadcast_to(u, points.shape[:-1]), points[..., n]), float)
        here, up, down, pairs, opposite = np.split(found, np.cumsum([1, n + 1, n + 1, first.size]), axis=1)
        own = up + down - 2 * here
        mixed = (pairs + opposite - 2 * here - own[:, first] - own[:, second]) / 2
        noise = np.sqrt(variance[:, one, :, None]) / width[:, None]
        own, mixed = own * noise**2, mixed * noise[:, first] * noise[:, second]
        means.append(here[:, 0] - own.sum(axis=1) / 2)
        slopes.append(np.swapaxes(up - down, -1, -2) / (2 * width))
        curvatures.append(np.sum(own**2, axis=1) / 2 + np.sum(mixed**2, axis=1))
    return Effects(*(np.stack(part, axis=1) for part in (means, slopes, curvatures)))
