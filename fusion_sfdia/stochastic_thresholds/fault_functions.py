"""Fault functions phi(x, u, e) of an area (Boem et al. 2018, "B18", sec. IV): their check, their values and derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

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


def effects_and_slopes(faults: Mapping[str, FaultFunction], x: Array, u: Array, e: Array, width: Array) -> tuple[Array, Array]:
    """Return what L faults add to the next state (B, L, n), and its derivatives (B, L, n, n + 1) by the state and by e.

    x (B, L, n), u (B, 1), e (B, 1). width (n + 1,): of the central differences by each state and by e.
    """
    n = x.shape[-1]
    shifts = np.concatenate([np.zeros((1, n + 1)), np.diag(width), -np.diag(width)])
    values, slopes = [], []
    for one, phi in enumerate(faults.values()):
        points = np.concatenate([x[:, one], e], axis=-1)[:, None] + shifts
        found = np.asarray(phi(points[..., :n], np.broadcast_to(u, points.shape[:-1]), points[..., n]), float)
        values.append(found[:, 0])
        slopes.append(np.swapaxes(found[:, 1 : n + 2] - found[:, n + 2 :], -1, -2) / (2 * width))
    return np.stack(values, axis=1), np.stack(slopes, axis=1)
