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

Unread states (ours: B18 reads all states of an area, (4)). The area keeps the covariance Sigma of x - x_bar of all its states,
where x_bar is y of a state that it reads, as in (5), and of the others an estimate with the gain K:

    chi+   = y+ - f(x_bar),   x_bar+ = f(x_bar) + K chi+ of an unread state,   K = M_ur (M_rr + R)^-1
    M      = F Sigma F' + g g' sum_j P_ij^2 sigma_j^2 + Q     the covariance of x+ - f(x_bar), where F_00 stands for W_i F_00,
                                                              and Q_00 has a^2 sum_j W_j^2 sigma_j^2 of the neighbours' copies
    Sigma+ = (1 - K C) M (1 - K C)' + K R K'                  with a unit row of K for each state that is read

u the unread states, r those that are read. These keep their readings, so K is the Kalman gain of the unread states only, whose
errors correlate with the noise of the readings that corrected them, Sigma_ur = K R. (14), (15) have Var[chi] = M_rr + R, and
(17) v_i = Sigma_00 of the area's own value. A reading that is missing makes its state unread for a step. Where all are read,
Sigma is R, and these are the equations above. A neighbour without a sensor of z_i has no weight; it receives the value that the
area holds, with the noise of its reading, or with the error bound sqrt(Sigma_00) of its estimate.

The error of a neighbour's value that is an estimate, whose root mean square is at most error_bound, correlates with Sigma. With
A + B for the error of f(x_bar), B = g sum_j P_ij (z_j - held_j) of such neighbours,

    E[(A + B)(A + B)'] <= (1 + tau) E[A A'] + (1 + 1 / tau) E[B B']     for any tau > 0, since 2 a b <= tau a^2 + b^2 / tau

bounds M. tau is the ratio of the sizes of B and A, which makes the bound least; sizes are relative to both in each state, so
that units do not matter.

Layout, as in network.py: own readings (B, N, 4); sides (2E,), those of area i from start[i] to start[i + 1], each with the
reading of z of `neighbour[side]`; slope (2E,), 0 where the tie is open. The copies of z_i are own[i, 0] and the copies at
opposite[side] of the closed sides of i.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fusion_sfdia.derivatives.equation import compiled, equation

UNKNOWN = 1e100  # an error bound without information: such residuals are not tested
ENOUGH = UNKNOWN**0.5  # deviations below this are of known readings
FAR = 1e4  # standard deviation of a state without information, over that with it


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


# Weights and deviations depend on the readings only by which are missing: those of areas that miss none depend on the areas
# alone. Arguments have the names and shapes of consensus.Diagnosers and areas.AreaArrays.


class Terms(NamedTuple):
    """Weights and deviations of areas, in the mode in which they were computed.

    of_areas (N, 1 + 2 n): the weight of an area's own copy of z_i, then what a step adds to lam s for the residuals of its n
    states, and for the errors of their estimates. of_sides (2E, 2): the weight of the neighbour's copy, and what a step adds
    for its residual.
    """

    of_areas: Any
    of_sides: Any


@equation
def find_terms(b: Any, i: Any, now: Any, printed: Any, areas: Any, terms: Any, row: Any, shift: Any) -> None:
    """Write weights and deviations of area i to terms.of_areas[row] and, for each side, to terms.of_sides[side + shift].

    now: Diagnosers, of which error bounds are used; areas: AreaArrays.
    """
    error_bound, error_bound_shared = now.error_bound, now.error_bound_shared
    area_terms, side_terms = terms
    matrices, slope, closed, process_variance, noise, shared_noise, received, start, opposite = areas[:9]
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
        if r == 0:
            drive_variance, drive_bound = variance, d
        else:
            area_terms[row, 1 + r] = residual_deviation(0.0, variance, q, noise[i, r], d)
            area_terms[row, 1 + n + r] = error_deviation(0.0, variance, q, d)

    a, q, v, d = matrices[i, 0, 0], process_variance[i, 0], noise[i, 0], error_bound[b, i, 0]
    own = precision_printed(v, d, a, drive_variance, q) if printed else precision_read(v, d)
    total = 0.0
    for side in range(start[i], start[i + 1]):
        if closed[side]:
            v, d = shared_noise[opposite[side]], error_bound_shared[b, opposite[side]]
            precision = precision_printed(v, d, a, drive_variance, q) if printed else precision_read(v, d)
            precision = 0.0 if received[opposite[side]] else precision
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
    agreed_bound = abs(a) * (W * d + agreed_bound) + drive_bound
    bracket += W * W * printed_variance(v, d, a, drive_variance, q)
    as_printed = np.sqrt(bracket) + agreed_bound
    area_terms[row, 0] = W
    area_terms[row, 1] = as_printed if printed else residual_deviation(0.0, variance, q, v, agreed_bound)
    area_terms[row, 1 + n] = error_deviation(0.0, variance, q, agreed_bound)
    for side in range(start[i], start[i + 1]):
        v = shared_noise[opposite[side]]
        side_terms[side + shift, 1] = as_printed if printed else residual_deviation(0.0, variance, q, v, agreed_bound)


@compiled
def find_partly_terms(b: Any, i: Any, now: Any, areas: Any, terms: Any, row: Any, shift: Any, M: Any) -> None:
    """As find_terms, of an area that does not read all its states; also write M (n, n), or its bound."""
    error_bound_shared, covariance = now.error_bound_shared, now.covariance
    area_terms, side_terms = terms
    matrices, slope, closed, process_variance, noise, shared_noise, received, start, opposite = areas[:9]
    n = noise.shape[1]
    own = 1.0 / max(covariance[b, i, 0, 0], 1.0 / UNKNOWN)
    inflow_variance, bound, total, agreed = 0.0, 0.0, own, 0.0
    for side in range(start[i], start[i + 1]):
        if closed[side]:
            P, d, k = slope[side], error_bound_shared[b, side], opposite[side]
            inflow_variance += P * P * noise_read(shared_noise[side], d)
            bound += abs(P) * d
            of_reading = error_bound_shared[b, k] == 0.0 and not received[k]
            side_terms[side + shift, 0] = 1.0 / shared_noise[k] if of_reading else 0.0
            total += side_terms[side + shift, 0]
    for side in range(start[i], start[i + 1]):
        if closed[side]:
            side_terms[side + shift, 0] /= total
            agreed += side_terms[side + shift, 0] ** 2 * shared_noise[opposite[side]]
    area_terms[row, 0] = own / total
    F, g, a = matrices[i, :, :n].copy(), matrices[i, :, n + 1], matrices[i, 0, 0]
    F[0, 0] *= own / total
    for r in range(n):
        for k in range(n):
            M[r, k] = g[r] * g[k] * inflow_variance
            for c in range(n):
                for j in range(n):
                    M[r, k] += F[r, c] * covariance[b, i, c, j] * F[k, j]
        M[r, r] = max(M[r, r], 0.0) + process_variance[i, r] + (a * a * agreed if r == 0 else 0.0)
        area_terms[row, 1 + r] = residual_deviation(0.0, M[r, r], 0.0, noise[i, r], abs(g[r]) * bound)
        area_terms[row, 1 + n + r] = error_deviation(0.0, M[r, r], 0.0, abs(g[r]) * bound)
    for side in range(start[i], start[i + 1]):
        v = shared_noise[opposite[side]]
        side_terms[side + shift, 1] = residual_deviation(0.0, M[0, 0], 0.0, v, abs(g[0]) * bound)
    t_A, t_B = 0.0, 0.0
    for r in range(n):
        A, B = M[r, r], (g[r] * bound) ** 2
        if B > 0.0:
            t_A, t_B = t_A + A / (A + B), t_B + B / (A + B)
    if t_B > 0.0:
        tau = np.sqrt(t_B / t_A) if t_A > 0.0 else FAR
        bound, tau = bound * min(1.0, FAR / tau), min(tau, FAR)  # beyond, the neighbour's value is not known at all
        for r in range(n):
            for k in range(n):
                M[r, k] = (1.0 + tau) * M[r, k] + (1.0 + 1.0 / tau) * (g[r] * bound) * (g[k] * bound)
    lost = False
    for r in range(n):
        lost |= not M[r, r] <= UNKNOWN
    if lost:  # of an area whose errors grow and that has been without readings for long
        M[:] = UNKNOWN * np.eye(n)


@compiled
def estimate_unread(y: Any, ahead: Any, noise: Any, held: Any, P: Any) -> Any:
    """Write estimates of states without a reading y (n) to held, from f(x_bar) in ahead; P: M before, Sigma afterwards.

    One reading after the other, for their noise is independent. Returns a bound of the deviation of held z, 0 for a reading.
    """
    n = y.size
    for c in range(n):
        if np.isfinite(y[c]) and np.isfinite(noise[c]):
            variance, new = P[c, c] + noise[c], y[c] - ahead[c]
            column = P[:, c].copy()
            for r in range(n):
                ahead[r] += column[r] / variance * new
                for k in range(n):
                    P[r, k] -= column[r] * column[k] / variance
    for c in range(n):
        if np.isfinite(y[c]) and np.isfinite(noise[c]):
            for k in range(n):  # P_ur is K R
                if np.isfinite(y[k]) and np.isfinite(noise[k]):
                    P[c, k] = noise[c] if c == k else 0.0
        else:
            held[c], P[c, c] = ahead[c], max(P[c, c], 0.0)
    return 0.0 if np.isfinite(y[0]) and np.isfinite(noise[0]) else np.sqrt(P[0, 0])


@compiled
def take_unread(areas: Any, own: Any, ahead: Any, after: Any) -> None:
    """Complete the diagnosers after take_readings: estimates of unread states, and what areas send of them."""
    closed, noise, received, start, opposite = areas.closed, areas.noise, areas.received, areas.start, areas.opposite
    h, h_shared, d, d_shared, _, e_shared, _, s_shared, covariance = after
    for b in range(h.shape[0]):
        for i in range(h.shape[1]):
            bound = d[b, i, 0]
            if not np.all(np.isfinite(noise[i])):
                bound = estimate_unread(own[b, i], ahead[b, i], noise[i], h[b, i], covariance[b, i])
            for side in range(start[i], start[i + 1]):
                k = opposite[side]
                if closed[side] and received[k]:
                    h_shared[b, k], d_shared[b, k], e_shared[b, k], s_shared[b, k] = h[b, i, 0], bound, 0.0, 0.0


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
def write_terms(which: Any, exact: Any, printed: Any, areas: Any, terms: Any) -> None:
    """Write the terms of some areas (M,) that miss no reading to `terms`; exact: Diagnosers (1, ...) whose error bounds are 0.

    Terms of areas with unread states change from step to step; nothing is written of them.
    """
    for i in which:
        if np.all(np.isfinite(areas.noise[i])):
            find_terms(0, i, exact, printed, areas, terms, i, 0)


@compiled
def step_areas(
    now: Any, reference: Any, load: Any, lam: Any, printed: Any, areas: Any, known: Any, alpha: Any, own: Any, shared: Any,
    after: Any, alarm: Any,
) -> Any:  # fmt: skip
    """Write the diagnosers after the readings own (B, N, n) and shared (B, 2E), under reference and load (B, N).

    now, after: Diagnosers; areas: AreaArrays. known: the Terms of areas that miss no reading, or those of no areas, and then
    they are computed. Without readings, given by arrays of no runs, what is written are estimates, error bounds, f(x_bar) of
    areas with unread states, deviations of the next ones, and M. printed: (15), (17) as printed.
    alarm (B, N + K), False before: whether |residual| > alpha deviation for any reading of an area, own or of a neighbour's
    first state; K columns for the copies behind the sides of the N areas, each read in another part. All copies of z_i are
    treated with area i: it needs the copies at its sides and at the opposite sides, and writes the latter. Returns whether the
    shapes fit; if they do not, nothing is written.
    """
    held, held_shared, error_bound, error_bound_shared, residual, residual_shared, deviation, deviation_shared, covariance = now
    matrices, slope, closed, _, noise, _, received, start, opposite, reader = areas
    h, h_shared, d, d_shared, e, e_shared, s, s_shared, covariance_after = after
    runs, count, n = held.shape
    read = own.shape[0] > 0
    fits = not read or (held_shared.shape == shared.shape and held.shape == own.shape)
    fits &= matrices.shape[:2] == (count, n) and held_shared.shape == (runs, slope.size)
    fits &= reference.shape == load.shape == (runs, count)
    fits &= error_bound.shape == residual.shape == deviation.shape == h.shape == d.shape == e.shape == s.shape == held.shape
    fits &= error_bound_shared.shape == residual_shared.shape == deviation_shared.shape == held_shared.shape
    fits &= h_shared.shape == d_shared.shape == e_shared.shape == s_shared.shape == held_shared.shape
    some = covariance.shape[2] > 0  # whether any state is not read
    fits &= covariance.shape == covariance_after.shape and (not some or covariance.shape == (runs, count, n, n))
    given = known.of_areas.shape[0] > 0
    fits &= not given or (known.of_areas.shape == (count, 1 + 2 * n) and known.of_sides.shape[0] == start[count])
    if not fits:
        return False
    area_terms, side_terms, ahead = np.empty((1, 1 + 2 * n)), np.empty((np.max(np.diff(start)), 2)), np.zeros(n)
    here = Terms(area_terms, side_terms)
    for b in range(runs):
        for i in range(count):
            first, past = start[i], start[i + 1]
            partly = some and not np.all(np.isfinite(noise[i]))
            inflow, complete = 0.0, not partly  # complete: all values used of the states of the area and of its neighbours
            for c in range(n):
                complete &= error_bound[b, i, c] == 0.0
            for side in range(first, past):
                if closed[side]:
                    inflow += slope[side] * held_shared[b, side]
                    complete &= error_bound_shared[b, side] == 0.0 and error_bound_shared[b, opposite[side]] == 0.0
            if partly:
                find_partly_terms(b, i, now, areas, here, 0, -first, covariance_after[b, i])
            elif complete and given:
                for c in range(1 + 2 * n):
                    area_terms[0, c] = known.of_areas[i, c]
                for side in range(first, past):
                    side_terms[side - first, 0] = known.of_sides[side, 0]
                    side_terms[side - first, 1] = known.of_sides[side, 1]
            else:
                find_terms(b, i, now, printed, areas, here, 0, -first)
            if some and not partly:
                covariance_after[b, i] = 0.0
            drive, crossed = 0.0, False
            for r in range(n):
                value = matrices[i, r, n] * reference[b, i] + matrices[i, r, n + 1] * (inflow - load[b, i])
                for c in range(0 if r else 1, n):
                    value += matrices[i, r, c] * held[b, i, c]
                ahead[r] = value
                if r == 0:
                    drive = value
                    continue
                memory = lam * deviation[b, i, r]
                x = (
                    private_term(value, residual[b, i, r], lam),
                    0.0 if partly else min(memory + area_terms[0, 1 + n + r], UNKNOWN),
                    0.0,
                    (memory + area_terms[0, 1 + r]),
                )
                if read:
                    x = taken(own[b, i, r], x[0], x[1], x[3])
                h[b, i, r], d[b, i, r], e[b, i, r], s[b, i, r] = x
                crossed |= abs(x[2]) > alpha * x[3]
            a, W = matrices[i, 0, 0], area_terms[0, 0]
            agreed, memory = 0.0, 0.0
            for side in range(first, past):
                if closed[side]:
                    k, W_k = opposite[side], side_terms[side - first, 0]
                    agreed += W_k * shared_term(held_shared[b, k], drive, residual_shared[b, k], a, lam)
                    memory += W_k * deviation_shared[b, k]
            agreed += W * shared_term(held[b, i, 0], drive, residual[b, i, 0], a, lam)
            memory = lam * (W * deviation[b, i, 0] + memory)
            bound = min(memory + area_terms[0, 1 + n], UNKNOWN)
            x = agreed, 0.0 if partly else bound, 0.0, memory + area_terms[0, 1]
            if read:
                x = taken(own[b, i, 0], x[0], x[1], x[3])
            h[b, i, 0], d[b, i, 0], e[b, i, 0], s[b, i, 0] = x
            crossed |= abs(x[2]) > alpha * x[3]
            alarm[b, i] |= crossed
            held_bound = d[b, i, 0]
            if partly:
                ahead[0] += W * a * held[b, i, 0]
                for side in range(first, past):
                    if closed[side]:
                        ahead[0] += side_terms[side - first, 0] * a * held_shared[b, opposite[side]]
                if read:
                    held_bound = estimate_unread(own[b, i], ahead, noise[i], h[b, i], covariance_after[b, i])
                else:
                    e[b, i] = ahead
            for side in range(first, past):
                k = opposite[side]
                x = held_shared[b, k], UNKNOWN, 0.0, UNKNOWN
                if closed[side]:
                    x = agreed, bound, 0.0, memory + side_terms[side - first, 1]
                if read:
                    x = taken(shared[b, k], x[0], x[1], x[3])
                h_shared[b, k], d_shared[b, k], e_shared[b, k], s_shared[b, k] = x
                alarm[b, reader[side]] |= abs(x[2]) > alpha * x[3]
                if some and read and closed[side] and received[k]:
                    h_shared[b, k], d_shared[b, k], e_shared[b, k], s_shared[b, k] = h[b, i, 0], held_bound, 0.0, 0.0
    return True
