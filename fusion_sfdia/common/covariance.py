"""Covariances given as a diagonal or as a matrix."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def diagonal(cov: Array) -> Array:
    """Variances (..., n) of a covariance given as its diagonal (n,) or as a matrix (..., n, n)."""
    return cov if cov.ndim == 1 else np.diagonal(cov, axis1=-2, axis2=-1)


def dense(cov: Array) -> Array:
    """The covariance matrix (..., n, n) of a covariance given as its diagonal (n,) or as a matrix."""
    return np.diag(cov) if cov.ndim == 1 else cov


def on_diagonal(P: Array) -> Array:
    """The diagonal (..., n) of a contiguous P (..., n, n), to be written to."""
    return P.reshape(*P.shape[:-2], -1)[..., :: P.shape[-1] + 1]


def require_covariance(what: str, cov: Array, n: int) -> None:
    """Raise ValueError unless cov is (n,) non-negative variances or an (n, n) positive semi-definite matrix."""
    if np.shape(cov) not in {(n,), (n, n)}:
        raise ValueError(f"{what} has shape {np.shape(cov)}; expected ({n},) variances or a ({n}, {n}) matrix")
    if not np.all(np.isfinite(cov)):
        raise ValueError(f"{what} has entries that are not finite; expected variances or a covariance matrix")
    variances = diagonal(np.asarray(cov))
    if np.any(variances < 0):
        raise ValueError(f"{what} has a negative variance ({variances.min():g}); a variance is at least 0")
    if np.ndim(cov) == 2:
        scale = np.sqrt(np.where(variances > 0, variances, 1.0))
        unit = cov / np.outer(scale, scale)
        if not np.allclose(unit, unit.T, atol=1e-9) or np.linalg.eigvalsh(unit).min() < -1e-9:
            raise ValueError(f"{what} is not symmetric positive semi-definite; give a covariance matrix")
