"""The unscented Kalman filter, its moments summed relative to the centre point.

For sigma points X_0 ... X_2n with the usual weights (Wan and van der Merwe 2000), lambda = alpha^2 (n + kappa) - n,

    W_j = 1 / (2 (n + lambda)),  j >= 1,    Wm_0 = lambda / (n + lambda),    Wc_0 = Wm_0 + 1 - alpha^2 + beta,

the usual small alpha makes W_0 about -1/alpha^2, and the weighted sums cancel. With D_j = X_j - X_0 and
m = sum_j W_j D_j they are, identically, since the weights of the mean sum to 1,

    mean = X_0 + m,    cov = sum_{j >= 1} W_j D_j D_j' + (beta - alpha^2) m m',

a Gram matrix and therefore positive semi-definite by construction for beta >= alpha^2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import single
from fusion_sfdia.common.arguments import number
from fusion_sfdia.filters.gaussian import Joint, add, square_root, symmetrise
from fusion_sfdia.filters.sums import symmetric_sum

Array = NDArray[Any]
Model = Callable[[Array], Array]


@dataclass(frozen=True)
class SigmaPoints:
    """Scaled sigma points: alpha > 0 their spread, beta 2 for a Gaussian, kappa > -n.

    alpha = 1, beta = 0, kappa = 0 is the cubature rule (Arasaratnam and Haykin 2009); alpha = 1, beta = 0, kappa = 3 - n the
    original transform (Julier and Uhlmann 1997).
    """

    alpha: float = 1e-3
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        for name in ("alpha", "beta", "kappa"):
            number(name, getattr(self, name))
        if not (self.alpha > 0 and np.isfinite([self.alpha, self.beta, self.kappa]).all()):
            raise ValueError(f"alpha {self.alpha}, beta {self.beta}, kappa {self.kappa}; alpha must be positive and all finite")

    def spread(self, n: int) -> float:
        """Return n + lambda = alpha^2 (n + kappa), the square of the points' distance in standard deviations."""
        if n + self.kappa <= 0:
            raise ValueError(f"kappa is {self.kappa} for {n} states; it must exceed {-n}")
        return self.alpha**2 * (n + self.kappa)


def sigma_points(points: SigmaPoints, x: Array, P: Array) -> Array:
    """Return the sigma points (..., 2n+1, n): x, then x + sqrt(n + lambda) L_j, then x - sqrt(n + lambda) L_j, L L' = P."""
    return _around(points, x, square_root(single(P)))


def _around(points: SigmaPoints, x: Array, L: Array) -> Array:
    n = x.shape[-1]
    offsets = np.sqrt(points.spread(n)) * np.swapaxes(L, -1, -2)
    X = np.empty((*x.shape[:-1], 2 * n + 1, n))
    centre = x[..., None, :]
    X[..., :1, :] = centre
    np.add(centre, offsets, out=X[..., 1 : n + 1, :])
    np.subtract(centre, offsets, out=X[..., n + 1 :, :])
    return X


def _moments(points: SigmaPoints, X: Array, n: int) -> tuple[Array, Array, Array]:
    """Return mean (..., k), m (..., k) and the offsets sqrt(W_j) D_j (..., 2n, k) of points X (..., 2n+1, k)."""
    root = np.sqrt(0.5 / points.spread(n))
    offsets = X[..., 1:, :] - X[..., :1, :]
    offsets *= root
    m = root * np.sum(offsets, axis=-2)
    return X[..., 0, :] + m, m, offsets


def _covariance(points: SigmaPoints, a: tuple[Array, Array, Array], b: tuple[Array, Array, Array]) -> Array:
    """sum_{j >= 1} W_j D_j^a D_j^b' + (beta - alpha^2) m^a m^b'."""
    total = np.swapaxes(a[2], -1, -2) @ b[2]
    total += ((points.beta - points.alpha**2) * a[1])[..., :, None] * b[1][..., None, :]
    return total


def predict(points: SigmaPoints, x: Array, P: Array, f: Model, Q: Array) -> tuple[Array, Array, Array]:
    """Return x (..., n), P (..., n, n) after the step, and the propagated points (..., 2n+1, n)  (Shaheen 2024, sec. III-C3).

    f maps points (..., 2n+1, n) to points; Q is (n,) or (..., n, n).
    """
    propagated = f(sigma_points(points, x, P))
    x, spread = moments(points, propagated)
    return x, add(spread, Q), propagated


def moments(points: SigmaPoints, propagated: Array) -> tuple[Array, Array]:
    """Return mean (..., n) and covariance (..., n, n) of propagated points (..., 2n+1, n), without process noise."""
    of_state = _moments(points, propagated, propagated.shape[-1])
    return of_state[0], symmetrise(_covariance(points, of_state, of_state))


def joint(points: SigmaPoints, x: Array, P: Array, h: Model, R: Array, propagated: Array | None = None) -> Joint:
    """Return the joint Gaussian of state and readings.

    x (..., n), P (..., n, n), h maps points (..., 2n+1, n) to readings (..., 2n+1, N), R (N,) or (..., N, N).
    Without `propagated`, new points are drawn from x, P, as the textbook does. With it, the points that `predict` returned
    are used again, as Shaheen 2024, sec. III-C3 prints it; S and C then lack the process noise that P contains.
    """
    n = x.shape[-1]
    if propagated is None:
        L = square_root(P)
        Y = h(_around(points, x, L))
        of_readings = _moments(points, Y, n)
        # of points that lie symmetrically, sum_j W_j D_j (Y_j - Y_0)' is a central difference along the columns of L
        C = L @ ((Y[..., 1 : n + 1, :] - Y[..., n + 1 :, :]) * (0.5 / np.sqrt(points.spread(n))))
    else:
        of_readings = _moments(points, h(propagated), n)
        C = _covariance(points, _moments(points, propagated, n), of_readings)
    return Joint(x, P, of_readings[0], symmetric_sum(_covariance(points, of_readings, of_readings), R), C)
