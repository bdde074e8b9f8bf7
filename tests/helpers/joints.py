"""Joint Gaussians of state and readings, and what rounding an update of them has."""

from __future__ import annotations

import numpy as np
from rounding import rounding

from fusion_sfdia.filters import ekf
from fusion_sfdia.filters.gaussian import Joint


def random_joint(rng: np.random.Generator, n: int, count: int, batch: tuple[int, ...] = ()) -> tuple[Joint, np.ndarray]:
    """A joint Gaussian with a general H, and R as its diagonal."""
    root = rng.normal(size=(*batch, n, n))
    p = root @ np.swapaxes(root, -1, -2) + np.eye(n)
    h = rng.normal(size=(count, n))
    r = rng.uniform(0.5, 2.0, count)
    x = rng.normal(size=(*batch, n))
    return ekf.joint(x, p, lambda s: s @ h.T, h, r), r


def of_update(joint: Joint, y: np.ndarray, updates: int = 2) -> float:
    """Rounding of estimates and covariances after so many updates, of solving with S: its condition, and the numbers' size."""
    condition, operations = np.linalg.cond(joint.S).max(), joint.S.shape[-1] + joint.P.shape[-1]
    innovation = np.nan_to_num(y - joint.y)
    size = max(np.abs(joint.P).max(), np.abs(innovation).max(), np.abs(joint.x).max()) + np.abs(joint.C).max()
    return rounding(condition, updates * operations) * float(size)
