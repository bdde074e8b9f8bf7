"""Scalar equations of local diagnosers that share variables (Boem et al. 2018, "B18", sec. III).

Area i has the linear model x_i+ = F_i x_i + b_i u_i + g_i (sum_j P_ij z_j - d_i) + w_i. Its first state, z_i, is shared: each
of the areas S = {i, neighbours of i} reads it with its own sensor. So an area reads its own states (4 sensors in the power
network) and z_j of each neighbour. With the residual e = y - x_hat and the filter parameter lam:

    drive_i  = all terms of z_i+ except that of z_i: row 0 of the model without its first term, for the readings of area i.
               Area i sends this number to the other areas of S; area j then has f_j(y_j) = a y_j + drive_i, a = F_i[0, 0].
    (5)      x_hat+   = f(y) - lam e                               for a state that is not shared
    (6)      z_hat_i+ = sum_j W_j (a y_j + drive_i - lam e_j)      the same number in all areas of S, since the weights
    (17)     W_j = (1 / v_j) / sum_S (1 / v)                       do not depend on the receiving area
    (14, 15) thresholds alpha s:  s+ = lam s + sd(chi),  s_i+ = lam sum_j W_j s_j + sd(chi_i)

The right-hand sides of (14) and (15) use the threshold of the present step, as in (32), not of the next step as printed. Then
s >= sd(e) by the triangle inequality of standard deviations, for any correlation of the chi of different times: e is a sum of
lam^k chi, whose deviation is at most the sum of lam^k sd(chi). So 1 / alpha^2 bounds the false alarms of a component, provided
that sd(chi) is correct. This needs noise that is white within one chi: chi contains the noise of readings at two instants,
whose variances are added below. For noise that changes its sign at each reading both terms have the same sign. Then sd(chi) is
up to sqrt(2) times as large, and at alpha = 5 a component may alarm in 0.076 of the steps instead of 0.04.

Correction of (15). Let z_i+ = a z_i + drive* + w with the true drive, and y_j = z_i + r_j. Subtract (6) from
y_i+ = z_i+ + r_i+, using sum_j W_j = 1 and a z_i = sum_j W_j a (y_j - r_j):

    e_i+ = sum_j W_j lam e_j + chi_i,   chi_i = -a sum_j W_j r_j + (drive* - drive) + w + r_i+
    Var[chi_i] = a^2 sum_j W_j^2 sigma_j^2 + Var[drive] + sigma_w^2 + sigma_i^2

since w and the error of the drive are the same in all areas of S, and r_i+, the noise of the receiver, has weight 1. As
printed, (15) has sum_j W_j^2 (a^2 sigma_j^2 + Var[drive] + sigma_w^2 + sigma_j^2), as if each area had its own w and its own
drive and r_i+ were averaged: about 1/|S| of the correct variance. Only the first term depends on W. It is smallest for
W_j ~ 1 / sigma_j^2, that is (17) with v_j = sigma_j^2 ("corrected"); as printed
v_j = a^2 sigma_j^2 + Var[drive] + sigma_w^2 + sigma_j^2 ("paper").

A missing reading is replaced by the estimate, e and s by 0, and its noise by `error_bound`, a bound of the standard deviation
of x - x_hat. This error correlates with the other terms, so error bounds are added instead of variances:
sd(chi) <= sqrt(variance of the readings) + sum of |coefficient| error_bound.

Layout, as in network.py: own readings (B, N, 4); sides (2E,), those of area i from start[i] to start[i + 1], each with the
reading of z of `neighbour[side]`; slope (2E,), 0 where the tie is open. The copies of z_i are own[i, 0] and the copies at
opposite[side] of the closed sides of i.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fusion_sfdia.core.equation import compiled, equation

UNKNOWN = 1e100  # an error bound without information: such residuals are not tested
ENOUGH = UNKNOWN**0.5  # deviations below this are of known readings


@equation
def noise_read(variance: Any, error_bound: Any) -> Any:
    """Noise variance of a held value: that of a reading, 0 for an estimate, that is, where error_bound > 0."""
    return variance * (error_bound == 0.0)


@equation
def private_term(value: Any, residual: Any, lam: Any) -> Any:
    """(5): f(y) - lam e, with value = f(y); the estimate of a state that is not shared."""
    return value - lam * residual


@equation
def shared_term(held: Any, drive: Any, residual: Any, a: Any, lam: Any) -> Any:
    """The bracket of (6), which an area sends to the areas that share the state: a y_j + drive - lam e_j."""
    return a * held + drive - lam * residual


@equation
def precision_read(variance: Any, error_bound: Any) -> Any:
    """1 / v_j of the corrected (17), where v_j is the variance of the held value."""
    return 1.0 / (noise_read(variance, error_bound) + error_bound * error_bound)


@equation
def precision_printed(variance: Any, error_bound: Any, a: Any, drive_variance: Any, process_variance: Any) -> Any:
    """1 / v_j of (17) as printed: v_j = a^2 sigma_j^2 + Var[drive] + sigma_w^2 + sigma_j^2."""
    return 1.0 / (
        a * a * (noise_read(variance, error_bound) + error_bound * error_bound) + drive_variance + process_variance + variance
    )


@equation
def printed_variance(variance: Any, error_bound: Any, a: Any, drive_variance: Any, process_variance: Any) -> Any:
    """The bracket of (15) as printed: a^2 sigma_j^2 + Var[drive] + sigma_w^2 + sigma_j^2."""
    return a * a * noise_read(variance, error_bound) + drive_variance + process_variance + variance


@equation
def error_deviation(memory: Any, variance: Any, process_variance: Any, error_bound: Any) -> Any:
    """Bound of the standard deviation of x - x_hat: lam s + sqrt(Var[f(x) - f(y)] + sigma_w^2) + error bounds."""
    return memory + np.sqrt(variance + process_variance) + error_bound


@equation
def residual_deviation(memory: Any, variance: Any, process_variance: Any, noise: Any, error_bound: Any) -> Any:
    """(14): s of a reading with this noise, lam s + sqrt(Var[f(x) - f(y)] + sigma_w^2 + sigma^2) + error bounds."""
    return memory + np.sqrt(variance + process_variance + noise) + error_bound


@compiled
def predict_areas(
    held: Any, held_shared: Any, error_bound: Any, error_bound_shared: Any, residual: Any, residual_shared: Any, deviation: Any,
    deviation_shared: Any, reference: Any, load: Any, lam: Any, printed: Any, matrices: Any, slope: Any, closed: Any,
    process_variance: Any, noise: Any, shared_noise: Any, start: Any, opposite: Any,
    estimate: Any, estimate_shared: Any, s: Any, s_shared: Any, estimate_bound: Any, estimate_bound_shared: Any,
) -> None:  # fmt: skip
    """Write estimates, deviations s and error bounds for the next readings into the last six arrays, (B, N, n) and (B, 2E)
    each.

    held to deviation_shared: of consensus.Diagnosers, in this order; reference, load (B, N); printed: (15), (17) as printed.
    matrices to opposite: of Areas; further sides may follow, such as copies in another part. All copies of z_i are treated with
    area i: it needs the copies at its sides and at the opposite sides, and writes the latter.
    """
    n = held.shape[2]
    for b in range(held.shape[0]):
        for i in range(held.shape[1]):
            inflow, inflow_variance, inflow_bound = 0.0, 0.0, 0.0
            for side in range(start[i], start[i + 1]):
                if closed[side]:
                    P, d = slope[side], error_bound_shared[b, side]
                    inflow += P * held_shared[b, side]
                    inflow_variance += P * P * noise_read(shared_noise[side], d)
                    inflow_bound += abs(P) * d
            drive, drive_variance, drive_bound = 0.0, 0.0, 0.0
            for r in range(n):
                F, G = matrices[i, r], matrices[i, r, n + 1]
                value = F[n] * reference[b, i] + G * (inflow - load[b, i])
                variance, d = G * G * inflow_variance, abs(G) * inflow_bound
                for c in range(0 if r else 1, n):
                    value += F[c] * held[b, i, c]
                    variance += F[c] * F[c] * noise_read(noise[i, c], error_bound[b, i, c])
                    d += abs(F[c]) * error_bound[b, i, c]
                if r == 0:
                    drive, drive_variance, drive_bound = value, variance, d
                else:
                    memory, q = lam * deviation[b, i, r], process_variance[i, r]
                    estimate[b, i, r] = private_term(value, residual[b, i, r], lam)
                    s[b, i, r] = residual_deviation(memory, variance, q, noise[i, r], d)
                    estimate_bound[b, i, r] = np.minimum(error_deviation(memory, variance, q, d), UNKNOWN)

            a, q, v, d = matrices[i, 0, 0], process_variance[i, 0], noise[i, 0], error_bound[b, i, 0]
            own = precision_printed(v, d, a, drive_variance, q) if printed else precision_read(v, d)
            total = 0.0
            for side in range(start[i], start[i + 1]):
                if closed[side]:
                    v, d = shared_noise[opposite[side]], error_bound_shared[b, opposite[side]]
                    total += precision_printed(v, d, a, drive_variance, q) if printed else precision_read(v, d)
            total += own
            agreed, memory, variance, agreed_bound, bracket = 0.0, 0.0, 0.0, 0.0, 0.0
            for side in range(start[i], start[i + 1]):
                if closed[side]:
                    k = opposite[side]
                    v, d = shared_noise[k], error_bound_shared[b, k]
                    W = (precision_printed(v, d, a, drive_variance, q) if printed else precision_read(v, d)) / total
                    agreed += W * shared_term(held_shared[b, k], drive, residual_shared[b, k], a, lam)
                    memory += W * deviation_shared[b, k]
                    variance += W * W * noise_read(v, d)
                    agreed_bound += W * d
                    bracket += W * W * printed_variance(v, d, a, drive_variance, q)
            W, v, d = own / total, noise[i, 0], error_bound[b, i, 0]
            agreed += W * shared_term(held[b, i, 0], drive, residual[b, i, 0], a, lam)
            memory = lam * (W * deviation[b, i, 0] + memory)
            variance = a * a * (W * W * noise_read(v, d) + variance) + drive_variance
            agreed_bound = abs(a) * (W * d + agreed_bound) + drive_bound
            bracket += W * W * printed_variance(v, d, a, drive_variance, q)
            estimate[b, i, 0] = agreed
            estimate_bound[b, i, 0] = np.minimum(error_deviation(memory, variance, q, agreed_bound), UNKNOWN)
            s[b, i, 0] = (
                memory + np.sqrt(bracket) + agreed_bound
                if printed
                else residual_deviation(memory, variance, q, v, agreed_bound)
            )
            for side in range(start[i], start[i + 1]):
                k = opposite[side]
                if closed[side]:
                    estimate_shared[b, k] = agreed
                    estimate_bound_shared[b, k] = estimate_bound[b, i, 0]
                    s_shared[b, k] = s[b, i, 0]
                    if not printed:
                        s_shared[b, k] = residual_deviation(memory, variance, q, shared_noise[k], agreed_bound)
                else:
                    estimate_shared[b, k], estimate_bound_shared[b, k], s_shared[b, k] = held_shared[b, k], UNKNOWN, UNKNOWN


@compiled
def take_readings(y: Any, held: Any, error_bound: Any, residual: Any, s: Any) -> None:
    """Replace estimates (in held), error bounds and deviations by the values after readings y; write residual; all flat."""
    for k in range(y.size):
        if np.isfinite(y[k]):
            known = s[k] < ENOUGH
            residual[k] = y[k] - held[k] if known else 0.0  # a copy without information starts here
            held[k], error_bound[k] = y[k], 0.0
            if not known:
                s[k] = 0.0
        else:
            residual[k], s[k] = 0.0, 0.0


@compiled
def find_alarms(residual: Any, residual_shared: Any, deviation: Any, deviation_shared: Any, alpha: Any, start: Any) -> Any:
    """Return (B, N): whether |residual| > alpha deviation for any reading of an area, own or of a neighbour's first state."""
    alarm = np.zeros(residual.shape[:2], np.bool_)
    for b in range(residual.shape[0]):
        for i in range(residual.shape[1]):
            crossed = False
            for c in range(residual.shape[2]):
                crossed |= abs(residual[b, i, c]) > alpha * deviation[b, i, c]
            for side in range(start[i], start[i + 1]):
                crossed |= abs(residual_shared[b, side]) > alpha * deviation_shared[b, side]
            alarm[b, i] = crossed
    return alarm


@compiled
def step_areas(
    held: Any, held_shared: Any, error_bound: Any, error_bound_shared: Any, residual: Any, residual_shared: Any, deviation: Any,
    deviation_shared: Any, reference: Any, load: Any, lam: Any, printed: Any, matrices: Any, slope: Any, closed: Any,
    process_variance: Any, noise: Any, shared_noise: Any, start: Any, opposite: Any, own: Any, shared: Any,
    h: Any, h_shared: Any, d: Any, d_shared: Any, r: Any, r_shared: Any, s: Any, s_shared: Any,
) -> None:  # fmt: skip
    """`predict_areas`, then the readings own (B, N, n) and shared (B, 2E); the last eight arrays are the Diagnosers after."""
    predict_areas(
        held, held_shared, error_bound, error_bound_shared, residual, residual_shared, deviation, deviation_shared, reference,
        load, lam, printed, matrices, slope, closed, process_variance, noise, shared_noise, start, opposite, h, h_shared, s,
        s_shared, d, d_shared,
    )  # fmt: skip
    size = own.size  # reshape, not ravel, which copies arrays of another memory order
    take_readings(own.reshape(size), h.reshape(size), d.reshape(size), r.reshape(size), s.reshape(size))
    size = shared.size
    take_readings(
        shared.reshape(size), h_shared.reshape(size), d_shared.reshape(size), r_shared.reshape(size), s_shared.reshape(size)
    )
