"""Gaussians in batches: covariances, positive-definite solves, conditioning on readings of which any may be missing.

A covariance that is the same for a whole batch (Q, R, P0) may be given as its diagonal (n,). The factorisations are
Cholesky's, whose success and accuracy do not change under a diagonal scaling of the matrix (Higham, Accuracy and Stability of
Numerical Algorithms, 2nd ed., Theorems 10.5 to 10.7): units such as Pa or bar make no difference beyond rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dtrsm

from fusion_sfdia.common.alike import repeated, single
from fusion_sfdia.common.covariance import dense as dense
from fusion_sfdia.common.covariance import on_diagonal as on_diagonal
from fusion_sfdia.filters.factors import half_inverses
from fusion_sfdia.filters.repeated import Repeated
from fusion_sfdia.filters.sums import difference

Array = NDArray[Any]

EPS = float(np.finfo(float).eps)
ROUNDING = 1e-10  # an eigenvalue of a unit-diagonal covariance above minus this is taken as a rounded zero


def symmetrise(P: Array) -> Array:
    """(P + P') / 2, (..., n, n)."""
    total = P + np.swapaxes(P, -1, -2)
    total *= 0.5
    return total


def add(P: Array, Q: Array) -> Array:
    """P + Q for P (..., n, n) and Q given as its diagonal (n,) or as a matrix (..., n, n)."""
    if Q.ndim != 1:
        return P + Q
    total = P.copy()
    on_diagonal(total)[...] += Q
    return total


def cholesky(A: Array) -> Array:
    """Lower L with L L' = A (..., n, n); only elements that are not positive definite are NaN."""
    try:
        return np.linalg.cholesky(A)
    except np.linalg.LinAlgError:
        return _one_by_one(_cholesky, A)


def square_root(A: Array) -> Array:
    """Some L with L L' = A (..., n, n): Cholesky's, or where A is singular to rounding, its eigenvectors' (NaN if neither).

    Singular means that the matrix scaled to a unit diagonal has an eigenvalue within 1e-10 of zero, on either side.
    """
    try:
        return np.linalg.cholesky(A)
    except np.linalg.LinAlgError:
        return _one_by_one(_square_root, A)


def sample(cov: Array, rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Array:
    """Draws (*shape, n) of N(0, cov), cov (n,) or (n, n), semi-definite allowed; n numbers are drawn for each in any case."""
    z = rng.standard_normal((*shape, cov.shape[-1]))
    return np.multiply(z, np.sqrt(cov), out=z) if cov.ndim == 1 else z @ square_root(cov).T


def inverse(A: Array) -> Array:
    """A^-1 (..., n, n) of positive definite A; only elements that are not positive definite are NaN."""
    U = half_inverse(A)
    return U @ np.swapaxes(U, -1, -2)


def half_inverse(A: Array, used: Array | None = None) -> Array:
    """U with U U' = A^-1 (..., n, n); only elements that are not positive definite are NaN.

    used (..., n): rows and columns of A to leave out as if they did not exist; U and U U' are zero there.
    """
    n = A.shape[-1]
    whole = A.shape if used is None else np.broadcast_shapes(A.shape, (*used.shape, n))
    U = np.array(A if A.shape == whole else np.broadcast_to(A, whole), dtype=float, order="C")
    take = np.ones((1, n), bool) if used is None else np.broadcast_to(used, whole[:-1]).reshape(-1, n)
    half_inverses(U.reshape(-1, n, n), np.array(take))
    return U


def solve_lower(L: Array, B: Array) -> Array:
    """L^-1 B (..., n, k) of lower triangular L (..., n, n) without a zero on its diagonal."""
    out = np.array(B, dtype=float, order="C")
    for index in np.ndindex(B.shape[:-2]):
        dtrsm(1.0, L[index].T, out[index].T, side=1, overwrite_b=1)  # X' L' = B', in the order of LAPACK
    return out


def whiten(rows: Array, R: Array, used: Array) -> Array:
    """Readings (..., k, N) in units of the noise R (N,) or (..., N, N) of those used (..., N), zero for the others.

    The product of two whitened rows is a' R^-1 b over the readings used.
    """
    if R.ndim == 1:
        return np.where(used[..., None, :], rows / np.sqrt(R), 0.0)
    return np.where(used[..., None, :], rows, 0.0) @ half_inverse(R, used)


def _one_by_one(function: Callable[[Array], Array], A: Array) -> Array:
    if A.ndim == 2:
        return function(A)
    out = np.empty(A.shape)
    for index in np.ndindex(A.shape[:-2]):
        out[index] = function(A[index])
    return out


def _cholesky(a: Array) -> Array:
    try:
        return np.linalg.cholesky(a)
    except np.linalg.LinAlgError:
        return np.full(a.shape, np.nan)


def _square_root(a: Array) -> Array:
    L = _cholesky(a)
    if np.all(np.isfinite(L)) or not np.all(np.isfinite(a)):
        return L
    variances = np.diagonal(a)
    scale = np.sqrt(np.where(variances > 0, variances, 1.0))
    values, vectors = np.linalg.eigh(a / np.outer(scale, scale))
    if values[0] < -ROUNDING:
        return L
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


class Joint(NamedTuple):
    """The joint Gaussian of state and readings before the readings are used.

    x (..., n), P (..., n, n): the state. y (..., N), S (..., N, N): the readings, S with their noise R. C (..., n, N):
    covariance of state and readings. considered (k,): positions of states that no update changes, see `consider`.
    H (..., N, n): Jacobian of the readings at x; None of a filter without it. repeated: sensors that read the same, if known.
    """

    x: Array
    P: Array
    y: Array
    S: Array
    C: Array
    considered: Array | None = None
    H: Array | None = None
    repeated: Repeated | None = None


def gain(joint: Joint, inverse: Array) -> Array:
    """K = C S^-1 (..., n, N) with S^-1 over the readings used; rows of considered states are 0."""
    return without_considered(joint, single(joint.C) @ single(inverse))


def without_considered(joint: Joint, K: Array) -> Array:
    """The gain K (..., n, N) of the joint Gaussian with rows of 0 for considered states, which is written to."""
    if joint.considered is not None:
        K[..., joint.considered, :] = 0.0
    return repeated(K, joint.C)


def consider(joint: Joint, x: Array, P: Array) -> tuple[Array, Array]:
    """Return the update by the gain K with zero rows for the considered states, from x, P of the optimal gain (Schmidt 1966).

    With x for the other states, theta for the considered ones and K_x = C_x S^-1, Joseph's form P - K C' - C K' + K S K' of
    K = [K_x; 0] is

        P_xx - K_x C_x',    P_x,theta - K_x C_theta',    P_theta,theta

    so that only the mean and the own covariance of theta differ from those of the optimal gain: they stay as they were. Since
    the gain is not the optimal one, innovations of successive steps are correlated: a test of one step keeps its rate of false
    alarms, a test that accumulates steps exceeds it.
    """
    if joint.considered is None:
        return x, P
    theta = joint.considered
    x, P = x.copy(), P.copy()
    x[..., theta] = joint.x[..., theta]
    P[..., theta[:, None], theta] = joint.P[..., theta[:, None], theta]
    return x, P


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


def rounding(joint: Joint) -> float:
    """What is added to the diagonal of P - W W', as a share of that of P: see `condition`."""
    return 4 * EPS * sum(joint.C.shape[-2:])


def condition(joint: Joint, y: Array, used: Array | None = None) -> Posterior:
    """Return the state given the readings y (..., N), those that are NaN or not `used` (..., N) left out.

        d = y - E[y],    x <- x + C S^-1 d,    P <- P - C S^-1 C'

    but for considered states, see `consider`.
    With S^-1 = U U' and W = C U, the subtraction P - W W' errs by no more than about (n + N) eps of the prior variances.
    Four times that is added to the diagonal, which keeps P positive definite, and errs to the safe side, for readings as
    precise as 1e-7 of the prior standard deviation; of a scalar state, any.
    """
    used = np.isfinite(y) if used is None else used & np.isfinite(y)
    if np.all(used):
        innovation = d = y - joint.y
        U = half_inverse(joint.S)
    else:
        innovation = np.where(used, y - joint.y, np.nan)
        d = np.where(used, innovation, 0.0)
        U = half_inverse(joint.S, used)
    Ut = np.swapaxes(U, -1, -2)
    whitened = (Ut @ d[..., None])[..., 0]
    W = joint.C @ U
    P = difference(joint.P, W @ np.swapaxes(W, -1, -2), rounding(joint))
    count = np.sum(used, axis=-1)
    nis = np.where(count > 0, np.sum(whitened * whitened, axis=-1) / np.maximum(count, 1), np.nan)
    x, P = consider(joint, joint.x + (W @ whitened[..., None])[..., 0], P)
    return Posterior(x, P, innovation, U @ Ut, used, nis)
