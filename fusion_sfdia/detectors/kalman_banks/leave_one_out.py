"""All leave-one-out filters from one filter: the estimate of each filter that ignores one sensor, without running it.

With a common prior, the filter that leaves out sensor i differs by rank one from the filter that uses all sensors. From the
joint Gaussian of state and readings, innovation d, S^-1 over the readings used, and K = C S^-1, let u = S^-1 d, w_i =
(S^-1)_ii, K_i the i-th column of K. Then, by the partitioned inverse,

    leave-one-out innovation   y_i - E[y_i | prior, other readings] = u_i / w_i, with variance 1 / w_i
    local estimate             x_i = x_f - K_i u_i / w_i
    local covariance           P_i = P_f + K_i K_i' / w_i

where x_f, P_f are those of the filter that uses all sensors. No inverse of P appears, so P may be singular (an ensemble's).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import repeated, single
from fusion_sfdia.detectors.kalman_banks.bank_kernels import conditioned, contiguous, mean_square, of_runs
from fusion_sfdia.filters.factors import inverted, squares_of_rows
from fusion_sfdia.filters.gaussian import Joint, consider, half_inverse, rounding, without_considered
from fusion_sfdia.filters.repeated import Repeated, mean_covariance, spread
from fusion_sfdia.filters.sums import difference

Array = NDArray[Any]

WRITTEN_OUT = 16  # states and readings below which `inverted` and `bank_kernels` have the products


@dataclass(frozen=True)
class LeaveOneOut:
    """Leave-one-out statistics of the readings used (..., N).

    whitened: u, weight: w (..., N), both 0 for a reading that is not used. known: S^-1, None where `inverse` is to compute it.
    half: U with S^-1 = U U', scores: U' d (..., N), both None after an elimination.
    rank: with the columns of U behind so many C U is 0 (None: with none).
    """

    whitened: Array
    weight: Array
    known: Array | None
    used: Array
    half: Array | None
    scores: Array | None
    rank: int | None = None

    @cached_property
    def inverse(self) -> Array:
        """S^-1 (..., N, N) with zero rows and columns for readings that are not used."""
        if self.known is not None:
            return self.known
        assert self.half is not None
        half = single(self.half)
        return repeated(half @ np.swapaxes(half, -1, -2), self.half)

    @cached_property
    def innovation(self) -> Array:
        """y_i less its prediction from the prior and the other readings (..., N), in sensor units; 0 where not used."""
        return np.asarray(self.whitened / np.where(self.used, self.weight, 1.0))

    @cached_property
    def variance(self) -> Array:
        """Variance of `innovation` (..., N); inf where not used."""
        with np.errstate(divide="ignore"):
            return 1.0 / self.weight

    @cached_property
    def chi_square(self) -> Array:
        """Squared innovation over its variance, chi-square with 1 degree of freedom when healthy (..., N)."""
        return self.whitened * self.innovation


def statistics(joint: Joint, y: Array, used: Array) -> LeaveOneOut:
    """Return the leave-one-out statistics of the readings y (..., N) where `used` holds; NaN readings are not used."""
    used = used & np.isfinite(y)
    d = np.where(used, y, joint.y) - joint.y
    if _few_readings(joint):
        half, s_inv, scores, whitened, weight = inverted(contiguous(joint.S), contiguous(d), contiguous(used))
        return LeaveOneOut(whitened, weight, s_inv, used, half, scores)
    half, rank = half_and_rank(joint, used)
    scores = (np.swapaxes(half, -1, -2) @ d[..., None])[..., 0]
    whitened = (half @ scores[..., None])[..., 0]
    weight = squares_of_rows(half.reshape(-1, *half.shape[-2:])).reshape(half.shape[:-1])
    return LeaveOneOut(whitened, repeated(weight, d), None, used, repeated(half, d), scores, rank)


def _few_readings(joint: Joint) -> bool:
    """Whether `factors.inverted` takes the readings of a batch as they are, also those that are read twice."""
    return joint.S.ndim > 2 and joint.S.shape[-1] < WRITTEN_OUT


def half_and_rank(joint: Joint, used: Array) -> tuple[Array, int | None]:
    """U (..., N, N), or (1, N, N) where it is the same for all runs; how many columns come before those where C U is 0."""
    if joint.repeated is not None and not _few_readings(joint):
        return half_of_repeated(joint.repeated, joint.S, used), joint.repeated.quantities
    return half_inverse(single(joint.S)) if used.all() else half_inverse(joint.S, used), None


def half_of_repeated(sensors: Repeated, S: Array, used: Array) -> Array:
    """U (..., N, N), see `filters.repeated`; (1, N, N) where all runs have the same S and use all readings."""
    S, in_use = contiguous(single(S)), contiguous(used)
    if len(S) == 1 and used.all():
        in_use = in_use[:1]
    V = half_inverse(mean_covariance(S, in_use, *sensors))
    return np.asarray(spread(V, in_use, *sensors))


def eliminate(found: LeaveOneOut, worst: Array, where: Array) -> LeaveOneOut:
    """Return the statistics without sensor `worst` (...) in the elements of the batch for which `where` (...) holds.

    A downdate of the inverse by rank one: S^-1 <- S^-1 - s_w s_w' / s_ww, u <- u - s_w u_w / s_ww, with s_w the w-th column.
    """
    given = found.inverse, found.whitened, found.weight, found.used
    s_inv, whitened, weight, used = (np.array(values, order="C") for values in given)
    N, runs = used.shape[-1], np.flatnonzero(where)
    S, u, w = s_inv.reshape(-1, N, N), whitened.reshape(-1, N), weight.reshape(-1, N)  # views
    one = runs, worst.ravel()[runs]
    column, pivot = S.swapaxes(-1, -2)[one], w[one][:, None]
    left = S[runs] - column[:, :, None] * (column / pivot)[:, None, :]
    S[runs], w[runs] = left, np.maximum(np.diagonal(left, axis1=-2, axis2=-1), 0.0)
    u[runs] -= column * (u[one][:, None] / pivot)
    for values in (S, S.swapaxes(-1, -2), u, w, used.reshape(-1, N)):
        values[one] = 0
    return LeaveOneOut(whitened, weight, s_inv, used, None, None)


def posterior(joint: Joint, found: LeaveOneOut) -> tuple[Array, Array]:
    """Return estimate (..., n) and covariance (..., n, n) after the readings used: x + C u and P - C S^-1 C'.

    As `gaussian.condition`, with W = C U, and with considered states as there. Four times the rounding of P - W W' is added to
    its diagonal, so that it stays positive definite.
    """
    if _written_out(joint, found):
        return _conditioned(joint, found)[:2]
    return _posterior(joint, found, single(joint.C) @ _half(joint, found))


def posterior_and_gain(joint: Joint, found: LeaveOneOut) -> tuple[Array, Array, Array]:
    """Return `posterior`, and the gain K = C S^-1 = W U' (..., n, N), see `gaussian.gain`."""
    if _written_out(joint, found):
        return _conditioned(joint, found)
    half = _half(joint, found)
    w = single(joint.C) @ half
    return *_posterior(joint, found, w), without_considered(joint, w @ np.swapaxes(half, -1, -2))


def _half(joint: Joint, found: LeaveOneOut) -> Array:
    """U, without columns for which C U is 0."""
    half, rank = half_and_rank(joint, found.used) if found.half is None else (single(found.half), found.rank)
    return half[..., :rank]


def _written_out(joint: Joint, found: LeaveOneOut) -> bool:
    """Whether `bank_kernels` has the products: of a batch with few states and sensors."""
    return joint.C.ndim > 2 and max(joint.C.shape[-2:]) < WRITTEN_OUT and found.known is not None


def _conditioned(joint: Joint, found: LeaveOneOut) -> tuple[Array, Array, Array]:
    given = joint.C, _half(joint, found), found.inverse, joint.P
    C, half, inverse, P = (of_runs(single(v), 2) for v in given)
    x, whitened = contiguous(joint.x), contiguous(found.whitened)
    x, p, K = conditioned(x, whitened, C, half, inverse, P, rounding(joint))
    return *consider(joint, x, repeated(p, x)), without_considered(joint, K)


def _posterior(joint: Joint, found: LeaveOneOut, w: Array) -> tuple[Array, Array]:
    C, P = single(joint.C), single(joint.P)
    x = joint.x + (C @ found.whitened[..., None])[..., 0]
    p = difference(P, w @ np.swapaxes(w, -1, -2), rounding(joint))
    return consider(joint, x, repeated(p, joint.P))


def local_estimates(joint: Joint, found: LeaveOneOut) -> tuple[Array, Array]:
    """Return x_i (..., N, n) of every local filter, and the columns K_i of the gain as rows (..., N, n)."""
    x = joint.x + (single(joint.C) @ found.whitened[..., None])[..., 0]
    gains = single(found.inverse) @ np.swapaxes(single(joint.C), -1, -2)
    local = gains * -found.innovation[..., None]
    local += x[..., None, :]
    return local, repeated(gains, x)


def local_covariances(joint: Joint, found: LeaveOneOut, gains: Array) -> Array:
    """Return P_i = P_f + K_i K_i' / w_i (..., N, n, n) of every local filter; gains: K_i as rows (..., N, n)."""
    p = single(posterior(joint, found)[1])[..., None, :, :]
    share = gains / np.where(found.used, found.weight, 1.0)[..., None]
    return np.asarray(p + gains[..., :, None] * share[..., None, :])


def normalised_innovation_squared(joint: Joint, found: LeaveOneOut, y: Array) -> Array:
    """Return d' S^-1 d over the readings used, divided by their number (...): 1 on average for a consistent filter."""
    return np.asarray(mean_square(*map(contiguous, (y, joint.y, found.whitened, found.used))))


def one_hot(index: Array, count: int) -> Array:
    """Whether each of so many is the one at that index (...): (..., count)."""
    return np.asarray(np.arange(count) == index[..., None])


def value_at(v: Array, index: Array) -> Array:
    """The values (...) of v (..., q) at an index (...)."""
    rows = v.reshape(-1, v.shape[-1])
    return np.asarray(rows[np.arange(len(rows)), index.ravel()].reshape(index.shape))
