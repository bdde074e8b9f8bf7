"""Moving-horizon estimation of constant sensor biases f with an L1 penalty, the trajectory eliminated by the filter.

Over a horizon of readings the estimate minimises (Rao, Rawlings and Lee 2001, with the filter's mean and covariance before
the horizon as arrival cost; the L1 term as in Kim, Koh, Boyd and Gorinevsky 2009)

    1/2 |x_0 - m_0|^2_(P_0^-1) + 1/2 sum |w_k|^2_(Q^-1) + 1/2 sum |y_k - h(x_k) - f|^2_(R^-1) + lambda sum s_i |f_i|

over the trajectory and f. For given f a filter minimises it over the trajectory. To first order, f changes the innovations d of
the filter that ran without faults by M f:

    M = I - H eta,    eta <- F E,    E = eta + K M,    E = 0 before the horizon

where E f is the change of the estimate after an update (Willsky and Jones 1976). This leaves a Lasso in f alone,

    min 1/2 f' G f - g' f + lambda sum s_i |f_i|,    G = sum M' S^-1 M,    g = sum M' S^-1 d,    s_i = sqrt(G_ii),

which is exact for a linear plant. In healthy operation g_i / s_i is N(0, 1), so lambda is a Gaussian quantile. f = 0 is the
solution as long as no |g_i| / s_i exceeds lambda. For a given set of faulty sensors and no penalty f has the covariance G^-1 of
that set, and the trajectory ends at x - E f with the covariance P + E G^-1 E'.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import for_all, repeated, single
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut
from fusion_sfdia.detectors.kalman_banks.likelihood_window import LEAST_INFORMATION

Array = NDArray[Any]


class Horizons(NamedTuple):
    """For J horizons, the oldest last: E after the last update (..., J, n, N), g (..., J, N) and G (..., J, N, N)."""

    effect: Array
    g: Array
    G: Array


def empty(batch: tuple[int, ...], horizons: int, states: int, sensors: int) -> Horizons:
    """Return horizons that begin with the next reading."""
    effect, G = (for_all(np.zeros((horizons, rows, sensors)), batch) for rows in (states, sensors))
    return Horizons(effect, np.zeros((*batch, horizons, sensors)), G)


def renew(now: Horizons) -> Horizons:
    """Return the horizons, shifted by one index, with a new first horizon that begins with the next reading."""
    effect, g, G = (np.roll(single(a), 1, axis) for a, axis in zip(now, (-3, -2, -3), strict=True))
    effect[..., 0, :, :] = g[..., 0, :] = G[..., 0, :, :] = 0.0
    return Horizons(repeated(effect, now.effect), repeated(g, now.g), repeated(G, now.G))


def extend(now: Horizons, tangent: Array, output_jacobian: Array, gain: Array, found: LeaveOneOut) -> Horizons:
    """Add the present innovations; F (..., n, n) of the step just taken, H (..., N, n), K (..., n, N) of all sensors in use.

    With S^-1 = U U' it adds (U' M)' U' d to g and (U' M)' U' M to G. E and G do not depend on readings: where all runs have the
    same matrices they are computed once.
    """
    assert found.half is not None and found.scores is not None
    before, F, H, K, U = (single(a) for a in (now.effect, tangent, output_jacobian, gain, found.half))
    eta = F[..., None, :, :] @ before
    change = np.eye(found.used.shape[-1]) - H[..., None, :, :] @ eta
    effect = eta + K[..., None, :, :] @ change
    whitened = np.swapaxes(U, -1, -2)[..., None, :, :] @ change
    transposed = np.swapaxes(whitened, -1, -2)
    G = single(now.G) + transposed @ whitened
    g = now.g + (transposed @ found.scores[..., None, :, None])[..., 0]
    return Horizons(repeated(effect, g), g, repeated(G, g))


def of_present(gain: Array, found: LeaveOneOut) -> Horizons:
    """Return the horizon of the present reading alone: E = K, g = S^-1 d, G = S^-1."""
    return Horizons(gain[..., None, :, :], found.whitened[..., None, :], found.inverse[..., None, :, :])


def information(horizons: Horizons, usable: Array, sensor_cov: Array) -> Array:
    """Return G_ii (..., J, N); 0 where a horizon has no information on faults of realistic size, or a sensor is not usable.

    usable: (..., N).
    """
    own = np.diagonal(horizons.G, axis1=-2, axis2=-1)
    return np.where(usable[..., None, :] & (own * sensor_cov > LEAST_INFORMATION), own, 0.0)


def sparse_faults(g: Array, G: Array, known: Array, penalty: float) -> Array:
    """Return the f (N,) that solves the Lasso for the `known` sensors (N,), 0 for others; exact, by least-angle regression."""
    from sklearn.linear_model import lars_path_gram  # slow to import

    f = np.zeros(g.shape)
    scale = np.sqrt(np.diagonal(G)[known])
    gram = G[np.ix_(known, known)] / np.outer(scale, scale)
    _, _, solution = lars_path_gram(g[known] / scale, gram, n_samples=1, alpha_min=penalty, method="lasso", return_path=False)
    f[known] = solution / scale
    return f


class HorizonFit(NamedTuple):
    """Sensors (k,) with a fault, f (k,) by least squares, its covariance (k, k); capped: whether more were significant."""

    sensors: Array
    f: Array
    covariance: Array
    capped: bool


def refitted(g: Array, G: Array, support: Array, penalty: float, most: int) -> HorizonFit:
    """Return the least-squares fit of f on a support (indices) without those of its sensors that are not significant.

    The penalty shrinks a large f, so that coupled sensors also enter the solution. The least significant sensor is removed
    repeatedly until all exceed `penalty` standard deviations and there are at most `most`, or one is left.
    """
    capped = False
    while True:
        covariance = np.linalg.inv(G[np.ix_(support, support)])
        f = covariance @ g[support]
        significance = np.abs(f) / np.sqrt(np.diagonal(covariance))
        least = int(np.argmin(significance))
        significant = bool(significance[least] > penalty)
        if len(support) == 1 or (significant and len(support) <= most):
            return HorizonFit(support, f, covariance, capped)
        capped = capped or significant
        support = np.delete(support, least)
