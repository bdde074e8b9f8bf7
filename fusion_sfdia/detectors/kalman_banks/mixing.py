"""The information mixture of local filters (Shaheen 2024, sec. III-B, step 3), literal and in closed form.

P_m = (sum_i P_i^-1)^-1,    x_m = P_m sum_i P_i^-1 x_i
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import repeated, single
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, posterior, statistics
from fusion_sfdia.filters.gaussian import Joint, cholesky, half_inverse, on_diagonal, solve_lower

Array = NDArray[Any]

RANK_TOLERANCE = 1e-9  # of the largest eigenvalue, below which a direction of a scaled covariance is outside its range


def mix(x: Array, p: Array, scale: Array) -> tuple[Array, Array]:
    """Return x_m (..., n), P_m (..., n, n) from N local estimates x (..., N, n), p (..., N, n, n), as printed.

    Singular covariances (an ensemble smaller than the state) are inverted on their range, which leave-one-out filters with a
    common prior share. scale (n,): magnitude of each state, which makes the result independent of the units of the states.
    """
    unit = scale[:, None] * scale
    information = np.linalg.pinv(p / unit, rcond=RANK_TOLERANCE, hermitian=True)
    p_m = np.linalg.pinv(np.sum(information, axis=-3), rcond=RANK_TOLERANCE, hermitian=True)
    # relative to the mean of the x_i: exact, since the weights sum to the identity on the common range
    middle = np.mean(x, axis=-2)
    pull = np.sum(information @ ((x - middle[..., None, :]) / scale)[..., None], axis=-3)
    return middle + scale * (p_m @ pull)[..., 0], p_m * unit


def mixture(joint: Joint, y: Array, used: Array, sensor_cov: Array) -> tuple[Array, Array, LeaveOneOut]:
    """Return x_m, P_m of the N leave-one-out filters with a common prior, N = number of sensors, in closed form, and the
    statistics of the central filter behind it.

    Each reading in use enters N - 1 of the N filters, so sum_i P_i^-1 = N P^-1 + (N - 1) H' R^-1 H: one central filter with
    R N / (N - 1), its covariance divided by N. A missing reading leaves N unchanged: its filter runs on the other readings.
    sensor_cov: R as its diagonal (N,). Holds where S = H P H' + R and C = P H' (not for sigma points that lack Q).
    """
    count = sensor_cov.size
    S = repeated(single(joint.S) + np.diag(sensor_cov / (count - 1)), joint.S)
    alike = joint.repeated and joint.repeated._replace(noise=joint.repeated.noise + sensor_cov / (count - 1))
    spread = joint._replace(S=S, repeated=alike)
    found = statistics(spread, y, used)
    x, p = posterior(spread, found)
    return x, repeated(single(p) / count, p), found


def mixture_without(sensor: Array, x: Array, p: Array, found: LeaveOneOut, C: Array) -> tuple[Array, Array]:
    """Return x_m, P_m without a sensor (B,) each, of what `mixture` returned for (B, ..) and C of its joint Gaussian.

    That of a central filter, so by the identity of `leave_one_out`: x - K_i u_i / w_i, P + K_i K_i' / w_i.
    """
    assert found.half is not None
    at, count = (np.arange(len(x)), sensor), found.weight.shape[-1]
    K = (C @ (found.half @ found.half[at][..., None]))[..., 0]
    step = K / found.weight[at][..., None]
    return x - step * found.whitened[at][..., None], p + step[..., :, None] * (K / count)[..., None, :]


def mixture_of_any_joint(joint: Joint, found: LeaveOneOut) -> tuple[Array, Array]:
    """Return x_m, P_m of the N leave-one-out filters with a common prior for any joint Gaussian with positive P_f, but for
    states without variance, which stay as they are.

    With A = P_f, P_i^-1 = A^-1 - v_i v_i' / (w_i + K_i' v_i), v_i = A^-1 K_i (Sherman and Morrison), so with the
    Cholesky factor L of A, b_i = L^-1 K_i and V V' = (N I - sum_i b_i b_i' / (w_i + |b_i|^2))^-1, P_m = L V (L V)' and
    x_m = x_f - L V V' sum_i b_i u_i / (w_i + |b_i|^2). Used for the printed unscented filter, whose C lacks Q.
    """
    x, a = posterior(joint, found)
    count = found.weight.shape[-1]
    a, inverse = single(a), single(found.inverse)
    weight, used, gains = found.weight[: len(inverse)], found.used[: len(inverse)], single(joint.C) @ inverse
    exact = np.diagonal(a, axis1=-2, axis2=-1) == 0
    factor = cholesky(a + exact[..., None] * np.eye(a.shape[-1]) if np.any(exact) else a)
    batch = np.broadcast_shapes(factor.shape[:-2], gains.shape[:-2])
    b = solve_lower(*(np.broadcast_to(m, (*batch, *m.shape[-2:])) for m in (factor, gains)))
    share = np.where(used, 1.0 / np.where(used, weight + np.sum(b * b, axis=-2), 1.0), 0.0)
    shared = b * np.sqrt(share)[..., None, :]
    inner = shared @ np.swapaxes(shared, -1, -2)
    np.negative(inner, out=inner)
    on_diagonal(inner)[...] += count
    V = half_inverse(inner)
    LV = factor @ V
    pull = np.swapaxes(V, -1, -2) @ (b @ (share * found.whitened)[..., None])
    p = LV @ np.swapaxes(LV, -1, -2)
    p = np.where(exact[..., None] | exact[..., None, :], 0.0, p) if np.any(exact) else p
    return x - (LV @ pull)[..., 0], repeated(p, x)
