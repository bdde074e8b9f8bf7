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

States without a sensor. B18 has y = x + rho, (4): all states of an area are read. An area whose sensors read only some of its
states estimates the others with the gain K from what is new in its readings, chi = e - lam e of the last step:

    x_hat+ = f(x_bar) - lam e,   chi+ = y+ - f(x_bar)        x_bar: y of a state that is read, see (5)
    x_bar  = x_hat + K chi                                   of a state that is not, where e = 0
    M      = F Sigma F' + g g' sum_j P_ij^2 sigma_j^2 + Q,   Sigma = (1 - K C) M (1 - K C)' + K R K'

with a row of K that is a unit row for each state that is read, whose held value is its reading. M is the covariance of
x+ - f(x_bar), Sigma that of x - x_bar. So L = F K of an observer with the error matrix F - L C; with C = 1, K = 1 and L = F - lam
the observer is (5). (14) holds with Var[chi] = M_rr + sigma^2, as s+ = lam s + sd(chi) holds for any correlation of the chi. The
paper gives no gain: see unread_states. Sigma is exact where the area reads its neighbours' first states or receives their
readings: these are new in each step. Errors of values that are estimates (a neighbour's first state that no sensor reads, a
missing reading) correlate with all others. Sigma then has a bound, by the triangle inequality of root mean squares: with C_l the
covariances of the parts of a sum,

    cov <= T sum_l C_l / t_l,   t_l = sqrt(trace C_l),   T = sum_l t_l

A first state that its area does not read is one more term of (6), with v = Sigma_00 in (17). A neighbour without a sensor of it
sends no bracket: W = 0. It receives the value that the area holds.

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
CERTAIN = 1 / UNKNOWN  # least variance of an estimate in a weight


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


# Weights and deviations depend on the readings only by which are missing, so those of areas that miss none are kept from step
# to step. Arguments have the names and shapes of consensus.Diagnosers and areas.AreaArrays.


@equation
def find_terms(
    b: Any, i: Any, error_bound: Any, error_bound_shared: Any, covariance: Any, partly: Any, printed: Any, matrices: Any,
    slope: Any, closed: Any, process_variance: Any, noise: Any, shared_noise: Any, unread: Any, unread_shared: Any, start: Any,
    opposite: Any, area_terms: Any, side_terms: Any, row: Any, shift: Any,
) -> None:  # fmt: skip
    """Write weights and deviations of area i to area_terms[row] and, for each side, to side_terms[side + shift].

    In area_terms are the weight of its own copy of z_i, then what a step adds to lam s for the residuals of its n states, and
    for the errors of their estimates; in side_terms the weight of the neighbour's copy, and what a step adds for its residual.
    """
    n = error_bound.shape[2]
    inflow_variance, inflow_bound = 0.0, 0.0
    for side in range(start[i], start[i + 1]):
        if closed[side]:
            P, d = slope[side], error_bound_shared[b, side]
            inflow_variance += P * P * noise_read(shared_noise[side], d)
            inflow_bound += abs(P) * d
    drive_variance, drive_bound = 0.0, 0.0
    for r in range(n):
        G, q = matrices[i, r, n + 1], process_variance[i, r]
        variance, d = G * G * inflow_variance, abs(G) * inflow_bound
        for c in range(0 if r else 1, n):
            F = matrices[i, r, c]
            variance += F * F * noise_read(noise[i, c], error_bound[b, i, c])
            d += abs(F) * error_bound[b, i, c]
        if partly and r:
            variance += spread(matrices[i, r], matrices[i, r], 1.0, 1.0, covariance[b, i])
        if r == 0:
            drive_variance, drive_bound = variance, d
        else:
            area_terms[row, 1 + r] = residual_deviation(0.0, variance, q, noise[i, r], d)
            area_terms[row, 1 + n + r] = error_deviation(0.0, variance, q, d)

    a, q, v, d = matrices[i, 0, 0], process_variance[i, 0], noise[i, 0], error_bound[b, i, 0]
    if unread[i, 0]:
        v = max(covariance[b, i, 0, 0], CERTAIN)
    own = precision_printed(v, d, a, drive_variance, q) if printed else precision_read(v, d)
    total = 0.0
    for side in range(start[i], start[i + 1]):
        if closed[side]:
            v, d = shared_noise[opposite[side]], error_bound_shared[b, opposite[side]]
            precision = precision_printed(v, d, a, drive_variance, q) if printed else precision_read(v, d)
            if unread_shared[opposite[side]]:
                precision = 0.0
            side_terms[side + shift, 0] = precision
            total += precision
    total += own
    variance, agreed_bound, bracket = 0.0, 0.0, 0.0
    for side in range(start[i], start[i + 1]):
        if closed[side]:
            v, d = shared_noise[opposite[side]], error_bound_shared[b, opposite[side]]
            W = side_terms[side + shift, 0] / total
            side_terms[side + shift, 0] = W
            variance += W * W * noise_read(v, d)
            agreed_bound += W * d
            bracket += W * W * printed_variance(v, d, a, drive_variance, q)
    W, v, d = own / total, noise[i, 0], error_bound[b, i, 0]
    variance = a * a * (W * W * noise_read(v, d) + variance) + drive_variance
    if partly:
        variance += spread(matrices[i, 0], matrices[i, 0], W, W, covariance[b, i])
    agreed_bound = abs(a) * (W * d + agreed_bound) + drive_bound
    bracket += W * W * printed_variance(v, d, a, drive_variance, q)
    as_printed = np.sqrt(bracket) + agreed_bound
    area_terms[row, 0] = W
    area_terms[row, 1] = as_printed if printed else residual_deviation(0.0, variance, q, v, agreed_bound)
    area_terms[row, 1 + n] = error_deviation(0.0, variance, q, agreed_bound)
    for side in range(start[i], start[i + 1]):
        v = shared_noise[opposite[side]]
        side_terms[side + shift, 1] = as_printed if printed else residual_deviation(0.0, variance, q, v, agreed_bound)


@equation
def spread(F: Any, G: Any, weight_F: Any, weight_G: Any, covariance: Any) -> Any:
    """F Sigma G' of two rows of the model, whose first entries have weights."""
    n = covariance.shape[0]
    total = 0.0
    for c in range(n):
        for k in range(n):
            total += F[c] * (weight_F if c == 0 else 1.0) * covariance[c, k] * G[k] * (weight_G if k == 0 else 1.0)
    return total


@compiled
def find_prior(
    b: Any, i: Any, error_bound: Any, error_bound_shared: Any, covariance: Any, matrices: Any, slope: Any, closed: Any,
    process_variance: Any, noise: Any, shared_noise: Any, start: Any, opposite: Any, area_terms: Any, side_terms: Any, row: Any,
    shift: Any, M: Any,
) -> None:  # fmt: skip
    """Write M (n, n), the covariance of x+ - f(x_bar) of area i, or its bound, with the weights of find_terms."""
    n = error_bound.shape[2]
    inflow_variance, inflow_bound, agreed_variance, agreed_bound = 0.0, 0.0, 0.0, 0.0
    for side in range(start[i], start[i + 1]):
        if closed[side]:
            P, d = slope[side], error_bound_shared[b, side]
            inflow_variance += P * P * noise_read(shared_noise[side], d)
            inflow_bound += abs(P) * d
            W, v, d = side_terms[side + shift, 0], shared_noise[opposite[side]], error_bound_shared[b, opposite[side]]
            agreed_variance += W * W * noise_read(v, d)
            agreed_bound += W * d
    a, own = matrices[i, 0, 0], area_terms[row, 0]
    trace = 0.0
    for r in range(n):
        for k in range(n):
            W_r, W_k = own if r == 0 else 1.0, own if k == 0 else 1.0
            m = spread(matrices[i, r], matrices[i, k], W_r, W_k, covariance[b, i])
            m += matrices[i, r, n + 1] * matrices[i, k, n + 1] * inflow_variance
            for c in range(n):
                w = W_r * W_k if c == 0 else 1.0
                m += matrices[i, r, c] * matrices[i, k, c] * w * noise_read(noise[i, c], error_bound[b, i, c])
            M[r, k] = m
        M[r, r] += process_variance[i, r] + (a * a * agreed_variance if r == 0 else 0.0)
        trace += M[r, r]
    # parts of the error that correlate with all others: of each missing reading, of the copies in (6), of the inflow
    first, total = np.sqrt(trace), np.sqrt(trace) + abs(a) * agreed_bound
    size = np.zeros(n + 1)
    for c in range(n + 1):
        for r in range(n):
            F = matrices[i, r, c if c < n else n + 1] * (own if r == 0 and c == 0 else 1.0)
            size[c] += F * F
        size[c] = np.sqrt(size[c]) * (error_bound[b, i, c] if c < n else inflow_bound)
        total += size[c]
    if total > first:
        for r in range(n):
            for k in range(n):
                m = M[r, k] / first if first > 0.0 else 0.0
                for c in range(n + 1):
                    if size[c] > 0.0:
                        d = error_bound[b, i, c] if c < n else inflow_bound
                        F = matrices[i, r, c if c < n else n + 1] * (own if r == 0 and c == 0 else 1.0)
                        G = matrices[i, k, c if c < n else n + 1] * (own if k == 0 and c == 0 else 1.0)
                        m += F * d * (G * d / size[c])
                M[r, k] = m * total
        M[0, 0] += abs(a) * agreed_bound * total
    if total > UNKNOWN:
        for r in range(n):
            for k in range(n):
                M[r, k] *= (UNKNOWN / total) ** 2


@compiled
def correct(held: Any, M: Any, gain: Any, noise: Any, unread: Any, residual: Any, memory: Any, s: Any) -> None:
    """Correct the estimates of unread states in held (n) with chi = residual - memory of the readings that are known (s > 0);
    M (n, n) becomes the covariance of the errors of these states, with each other and with the readings."""
    n = held.size
    kept, prior = np.zeros((n, n)), M.copy()
    for r in range(n):
        if unread[r]:
            kept[r, r] = 1.0
            for c in range(n):
                if not unread[c] and s[c] > 0.0:
                    kept[r, c] = -gain[r, c]
                    held[r] += gain[r, c] * (residual[c] - memory[c])
    for r in range(n):
        for k in range(n):
            M[r, k] = spread(kept[r], kept[k], 1.0, 1.0, prior)  # 0 of a state that is read
            for c in range(n):
                if not unread[c] and s[c] > 0.0:
                    M[r, k] += kept[r, c] * kept[k, c] * noise[c]
            if unread[r] and not unread[k]:
                M[r, k] = -kept[r, k] * noise[k]
            if unread[k] and not unread[r]:
                M[r, k] = -kept[k, r] * noise[r]


@equation
def sent(b: Any, k: Any, value: Any, error_bound: Any, variance: Any, h_shared: Any, d_shared: Any, e_shared: Any,
         s_shared: Any) -> None:  # fmt: skip
    """What the area at side k, without a sensor of its neighbour's first state, receives of it; variance: Sigma_00."""
    h_shared[b, k], d_shared[b, k] = value, min(error_bound + np.sqrt(variance), UNKNOWN)
    e_shared[b, k], s_shared[b, k] = 0.0, 0.0


@compiled
def correct_areas(
    closed: Any, noise: Any, unread: Any, unread_shared: Any, gain: Any, start: Any, opposite: Any, memory: Any, h: Any,
    h_shared: Any, d: Any, d_shared: Any, e: Any, e_shared: Any, s: Any, s_shared: Any, covariance: Any,
) -> None:  # fmt: skip
    """Correct estimates of unread states in the diagnosers h to covariance after take_readings; memory: of the prediction."""
    runs, areas, n = h.shape
    for b in range(runs):
        for i in range(areas):
            if np.any(unread[i]):
                correct(h[b, i], covariance[b, i], gain[i], noise[i], unread[i], e[b, i], memory[b, i], s[b, i])
            for side in range(start[i], start[i + 1]):
                k = opposite[side]
                if closed[side] and unread_shared[k]:
                    variance = covariance[b, i, 0, 0] if unread[i, 0] else 0.0
                    sent(b, k, h[b, i, 0], d[b, i, 0], variance, h_shared, d_shared, e_shared, s_shared)


@equation
def taken(y: Any, estimate: Any, error_bound: Any, s: Any) -> Any:
    """What is held after the reading y, its error bound, residual and deviation."""
    if not np.isfinite(y):
        return estimate, error_bound, 0.0, 0.0
    known = s < ENOUGH
    return y, 0.0, y - estimate if known else 0.0, s if known else 0.0  # a copy without information starts here


@compiled
def take_readings(y: Any, held: Any, error_bound: Any, residual: Any, s: Any) -> None:
    """Replace estimates (in held), error bounds and deviations by the values after readings y; write residual; all flat."""
    for k in range(y.size):
        held[k], error_bound[k], residual[k], s[k] = taken(y[k], held[k], error_bound[k], s[k])


@compiled
def step_areas(
    held: Any, held_shared: Any, error_bound: Any, error_bound_shared: Any, residual: Any, residual_shared: Any, deviation: Any,
    deviation_shared: Any, covariance: Any, reference: Any, load: Any, lam: Any, printed: Any, matrices: Any, slope: Any,
    closed: Any, process_variance: Any, noise: Any, shared_noise: Any, unread: Any, unread_shared: Any, gain: Any, start: Any,
    opposite: Any, reader: Any, known: Any, area_terms: Any, side_terms: Any, alpha: Any, own: Any, shared: Any, h: Any,
    h_shared: Any, d: Any, d_shared: Any, e: Any, e_shared: Any, s: Any, s_shared: Any, covariance_after: Any, alarm: Any,
) -> Any:  # fmt: skip
    """Write the diagnosers after the readings own (B, N, n) and shared (B, 2E), under reference and load (B, N).

    h to covariance_after: the Diagnosers after; without readings, given by arrays of no runs, estimates, error bounds, lam e and
    deviations of the next ones, and M. printed: (15), (17) as printed. alarm (B, N + K), False before: whether |residual| > alpha deviation for any
    reading of an area, own or of a neighbour's first state; K columns for the copies behind the sides of the N areas, each read
    in another part. All copies of z_i are treated with area i: it needs the copies at its sides and at the opposite sides, and
    writes the latter. Returns whether the shapes fit; if they do not, nothing is written.
    """
    runs, areas, n = held.shape
    read = own.shape[0] > 0
    given = held_shared.shape == shared.shape and held.shape == own.shape
    fits = (given or not read) and matrices.shape[:2] == (areas, n) and held_shared.shape == (runs, slope.size)
    fits &= reference.shape == load.shape == (runs, areas)
    fits &= error_bound.shape == residual.shape == deviation.shape == h.shape == d.shape == e.shape == s.shape == held.shape
    fits &= error_bound_shared.shape == residual_shared.shape == deviation_shared.shape == held_shared.shape
    fits &= h_shared.shape == d_shared.shape == e_shared.shape == s_shared.shape == held_shared.shape
    fits &= covariance.shape == covariance_after.shape
    fits &= gain.shape[0] == 0 or (gain.shape == matrices[:, :, :n].shape and covariance.shape == (runs, areas, n, n))
    if not fits:
        return False
    memories, some = np.zeros(n), gain.shape[0] > 0  # some: whether any state is not read
    for b in range(runs):
        for i in range(areas):
            first, past, row, shift = start[i], start[i + 1], i, 0
            partly = some and np.any(unread[i])
            inflow, complete = 0.0, not partly  # complete: all values that are used of the states of the area and of its neighbours
            for c in range(n):
                complete &= error_bound[b, i, c] == 0.0
            for side in range(first, past):
                if closed[side]:
                    inflow += slope[side] * held_shared[b, side]
                    complete &= error_bound_shared[b, side] == 0.0 and error_bound_shared[b, opposite[side]] == 0.0
            if not complete:
                row, shift = areas, start[areas] - first  # behind the terms of all areas
            if not (complete and known[i]):
                find_terms(
                    b, i, error_bound, error_bound_shared, covariance, partly, printed, matrices, slope, closed,
                    process_variance, noise, shared_noise, unread, unread_shared, start, opposite, area_terms, side_terms, row,
                    shift,
                )  # fmt: skip
                known[i] |= complete
            if partly:
                find_prior(
                    b, i, error_bound, error_bound_shared, covariance, matrices, slope, closed, process_variance, noise,
                    shared_noise, start, opposite, area_terms, side_terms, row, shift, covariance_after[b, i],
                )  # fmt: skip
            elif some:
                covariance_after[b, i] = 0.0
            drive, crossed = 0.0, False
            for r in range(n):
                value = matrices[i, r, n] * reference[b, i] + matrices[i, r, n + 1] * (inflow - load[b, i])
                for c in range(0 if r else 1, n):
                    value += matrices[i, r, c] * held[b, i, c]
                if r == 0:
                    drive = value
                    continue
                memory = lam * deviation[b, i, r]
                x = (
                    private_term(value, residual[b, i, r], lam),
                    0.0 if partly and unread[i, r] else min(memory + area_terms[row, 1 + n + r], UNKNOWN),
                    0.0,
                    (memory + area_terms[row, 1 + r]),
                )
                if read:
                    x = taken(own[b, i, r], x[0], x[1], x[3])
                h[b, i, r], d[b, i, r], e[b, i, r], s[b, i, r] = x
                crossed |= abs(x[2]) > alpha * x[3]
            a, W = matrices[i, 0, 0], area_terms[row, 0]
            agreed, memory = 0.0, 0.0
            for side in range(first, past):
                if closed[side]:
                    k, W_k = opposite[side], side_terms[side + shift, 0]
                    agreed += W_k * shared_term(held_shared[b, k], drive, residual_shared[b, k], a, lam)
                    memory += W_k * deviation_shared[b, k]
            agreed += W * shared_term(held[b, i, 0], drive, residual[b, i, 0], a, lam)
            memory = lam * (W * deviation[b, i, 0] + memory)
            bound = min(memory + area_terms[row, 1 + n], UNKNOWN)
            x = agreed, 0.0 if partly and unread[i, 0] else bound, 0.0, memory + area_terms[row, 1]
            if read:
                x = taken(own[b, i, 0], x[0], x[1], x[3])
            h[b, i, 0], d[b, i, 0], e[b, i, 0], s[b, i, 0] = x
            crossed |= abs(x[2]) > alpha * x[3]
            alarm[b, i] |= crossed
            if partly:
                memories[1:] = lam * residual[b, i, 1:]
                memories[0] = W * lam * residual[b, i, 0]
                for side in range(first, past):
                    if closed[side]:
                        memories[0] += side_terms[side + shift, 0] * lam * residual_shared[b, opposite[side]]
                if not read:
                    e[b, i] = memories
            if read and partly:
                correct(h[b, i], covariance_after[b, i], gain[i], noise[i], unread[i], e[b, i], memories, s[b, i])
            variance = covariance_after[b, i, 0, 0] if partly and unread[i, 0] else 0.0
            for side in range(first, past):
                k = opposite[side]
                x = held_shared[b, k], UNKNOWN, 0.0, UNKNOWN
                if closed[side]:
                    x = agreed, bound, 0.0, memory + side_terms[side + shift, 1]
                if read:
                    x = taken(shared[b, k], x[0], x[1], x[3])
                h_shared[b, k], d_shared[b, k], e_shared[b, k], s_shared[b, k] = x
                alarm[b, reader[side]] |= abs(x[2]) > alpha * x[3]
                if some and read and closed[side] and unread_shared[k]:
                    sent(b, k, h[b, i, 0], d[b, i, 0], variance, h_shared, d_shared, e_shared, s_shared)
    return True
