"""Gaussians in batches: covariances, positive-definite solves, conditioning on readings of which any may be missing.

A covariance that is the same for a whole batch (Q, R, P0) may be given as its diagonal (n,). The factorisations are
LAPACK's Cholesky ones, whose success and accuracy do not change under a diagonal scaling of the matrix (Higham, Accuracy
and Stability of Numerical Algorithms, 2nd ed., Theorems 10.5 to 10.7): Pa or bar makes no difference beyond rounding.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri

Array = NDArray[Any]

ONE_BY_ONE = 16  # size from which LAPACK calls on single matrices beat NumPy's batch routines
ROUNDING = 1e-10  # an eigenvalue of a unit-diagonal covariance above minus this is taken as a rounded zero


def dense(cov: Array) -> Array:
    """The covariance matrix (..., n, n) of a covariance given as its diagonal (n,) or as a matrix."""
    return np.diag(cov) if cov.ndim == 1 else cov


def symmetrise(P: Array) -> Array:
    """(P + P') / 2, (..., n, n)."""
    return (P + np.swapaxes(P, -1, -2)) / 2


def add(P: Array, Q: Array) -> Array:
    """P + Q for P (..., n, n) and Q given as its diagonal (n,) or as a matrix (..., n, n)."""
    if Q.ndim != 1:
        return P + Q
    total = P.copy()
    np.einsum("...ii->...i", total)[...] += Q
    return total


def cholesky(A: Array) -> Array:
    """Lower L with L L' = A (..., n, n); an element of the batch that is not positive definite is NaN, it alone."""
    try:
        return np.linalg.cholesky(A)
    except np.linalg.LinAlgError:
        return _one_by_one(_cholesky, A)


def square_root(A: Array) -> Array:
    """Some L with L L' = A (..., n, n): Cholesky's, or where A is singular to rounding, its eigenvectors' (NaN if neither).

    Singular means that the matrix scaled to a unit diagonal has an eigenvalue within 1e-10 of zero, on either side.
    """
    L = cholesky(A)
    failed = ~np.all(np.isfinite(L), axis=(-2, -1)) & np.all(np.isfinite(A), axis=(-2, -1))
    if not np.any(failed):
        return L
    variances = np.diagonal(A, axis1=-2, axis2=-1)[failed]
    scale = np.sqrt(np.where(variances > 0, variances, 1.0))
    values, vectors = np.linalg.eigh(A[failed] / (scale[:, :, None] * scale[:, None, :]))
    root = scale[:, :, None] * vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    L[failed] = np.where(values[:, 0, None, None] >= -ROUNDING, root, np.nan)
    return L


def sample(cov: Array, rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Array:
    """Draws (*shape, n) of N(0, cov), cov (n,) or (n, n), semi-definite allowed; n numbers are drawn for each in any case."""
    z = rng.standard_normal((*shape, cov.shape[-1]))
    return z * np.sqrt(cov) if cov.ndim == 1 else z @ square_root(cov).T


def inverse(A: Array) -> Array:
    """A^-1 (..., n, n) of positive definite A; an element of the batch that is not positive definite is NaN, it alone."""
    if A.ndim == 2 or A.shape[-1] >= ONE_BY_ONE:
        return _one_by_one(_inverse, A)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = 1.0 / np.sqrt(np.diagonal(A, axis1=-2, axis2=-1))
        unit = A * (scale[..., :, None] * scale[..., None, :])
        good = np.all(np.isfinite(cholesky(unit)), axis=(-2, -1), keepdims=True)
        inverted = symmetrise(np.linalg.inv(np.where(good, unit, np.eye(A.shape[-1]))))
        return np.where(good, inverted, np.nan) * (scale[..., :, None] * scale[..., None, :])


def _one_by_one(function: Any, A: Array) -> Array:
    if A.ndim == 2:
        return np.asarray(function(A))
    out = np.empty(A.shape)
    for index in np.ndindex(A.shape[:-2]):
        out[index] = function(A[index])
    return out


def _cholesky(a: Array) -> Array:
    try:
        return np.linalg.cholesky(a)
    except np.linalg.LinAlgError:
        return np.full(a.shape, np.nan)


def _inverse(a: Array) -> Array:
    n = a.shape[0]
    factor, failed = dpotrf(a.T, lower=1, clean=1)
    if failed:
        return np.full((n, n), np.nan)
    triangle, _ = dpotri(factor, lower=1, overwrite_c=1)
    whole: Array = triangle + triangle.T
    whole.reshape(-1)[:: n + 1] *= 0.5
    return whole


class Joint(NamedTuple):
    """The joint Gaussian of state and readings before the readings are used.

    x (..., n), P (..., n, n): the state. y (..., N), S (..., N, N): the readings, S with their noise R. C (..., n, N):
    covariance of state and readings.
    """

    x: Array
    P: Array
    y: Array
    S: Array
    C: Array


class Posterior(NamedTuple):
    """The state after the readings: x (..., n), P (..., n, n).

    innovation (..., N): reading less prediction, NaN where not used. inverse (..., N, N): S^-1 over the readings used, zero
    rows and columns elsewhere. used (..., N). nis (...): d' S^-1 d over the number of readings used, NaN for none.
    """

    x: Array
    P: Array
    innovation: Array
    inverse: Array
    used: Array
    nis: Array


def condition(joint: Joint, y: Array, used: Array | None = None) -> Posterior:
    """Return the state given the readings y (..., N), those that are NaN or not `used` (..., N) left out.

        d = y - E[y],    K = C S^-1,    x <- x + K d,    P <- P - K C'

    A reading left out has its row and column of S and C masked, so the cost is the same and shapes never change.
    """
    used = np.isfinite(y) if used is None else used & np.isfinite(y)
    if np.all(used):
        d = y - joint.y
        S_inv = inverse(joint.S)
        innovation = d
    else:
        innovation = np.where(used, y - joint.y, np.nan)
        d = np.where(used, innovation, 0.0)
        S_inv = masked_inverse(joint.S, used)
    K = joint.C @ S_inv
    x = joint.x + (K @ d[..., None])[..., 0]
    P = symmetrise(joint.P - K @ np.swapaxes(joint.C, -1, -2))
    count = np.sum(used, axis=-1)
    chi_square = np.sum(d * (S_inv @ d[..., None])[..., 0], axis=-1)
    nis = np.where(count > 0, chi_square / np.maximum(count, 1), np.nan)
    return Posterior(x, P, innovation, S_inv, used, nis)


def masked_inverse(S: Array, used: Array) -> Array:
    """S^-1 over the readings used (..., N), with zero rows and columns for the others (..., N, N)."""
    pair = used[..., :, None] & used[..., None, :]
    rest = np.where(used, 0.0, np.diagonal(S, axis1=-2, axis2=-1))
    masked = np.where(pair, S, 0.0)
    np.einsum("...ii->...i", masked)[...] += rest
    return np.where(pair, inverse(masked), 0.0)
