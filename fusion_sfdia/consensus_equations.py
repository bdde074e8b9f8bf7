"""Local diagnosers that share variables: their scalar equations (Boem et al. 2018, "B18", sec. III).

An area i has the linear model x_i+ = F_i x_i + b_i u_i + g_i (sum_j P_ij z_j - d_i) + w_i. Its first state, z_i, is shared: the
areas S = {i, neighbours of i} each read it with a sensor of their own, so an area reads its own states (4 sensors in the power
network) and z_j of each neighbour. With e the residual y - x_hat, lam the filter parameter:

    drive_i  = what z_i+ takes from all but z_i itself: row 0 of the model without its first term, of area i's readings.
               One number, which area i tells the others of S; f_j(y_j) = a y_j + drive_i with a = F_i[0, 0] is then known to j.
    (5)      x_hat+   = f(y) - lam e                                            of a state that is not shared
    (6)      z_hat_i+ = sum_j W_j (a y_j + drive_i - lam e_j)                    the same number for all of S, since
    (17)     W_j = (1 / v_j) / sum_S (1 / v)                                     does not depend on who uses it
    (14, 15) thresholds alpha s:  s+ = lam s + sd(chi),  s_i+ = lam sum_j W_j s_j + sd(chi_i)

On the right of (14) and (15) stands the threshold of the present step, as in (32), not that of the next as printed. Then
s >= sd(e) always, by the triangle inequality of standard deviations, however the chi of different times correlate: e is a sum
of lam^k chi, whose deviation is at most the sum of lam^k sd(chi). So 1 / alpha^2 bounds the false alarms of a component.

What (15) should be. Let z_i+ = a z_i + drive* + w, with the true drive, and y_j = z_i + r_j. Subtract (6) from
y_i+ = z_i+ + r_i+, using sum_j W_j = 1 and a z_i = sum_j W_j a (y_j - r_j):

    e_i+ = sum_j W_j lam e_j + chi_i,   chi_i = -a sum_j W_j r_j + (drive* - drive) + w + r_i+
    Var[chi_i] = a^2 sum_j W_j^2 sigma_j^2 + Var[drive] + sigma_w^2 + sigma_i^2

for w and the drive's error are the same for all who share, and r_i+ is the receiver's own, of weight 1. As printed, (15) has
sum_j W_j^2 (a^2 sigma_j^2 + Var[drive] + sigma_w^2 + sigma_j^2): as if each had another w and another drive and r_i+ were
averaged, about 1/|S| of the truth. Only the first term depends on W: it is least for W_j ~ 1 / sigma_j^2, that is (17) with
v_j = sigma_j^2 ("corrected"); as printed v_j = a^2 sigma_j^2 + Var[drive] + sigma_w^2 + sigma_j^2 ("paper").

A reading that is missing is replaced by the estimate, e and s by 0, and its noise by `doubt`, a bound of the standard
deviation of x - x_hat. That error correlates with the rest, so doubts add up where variances would: sd(chi) <=
sqrt(variance of what was read) + sum of |coefficient| doubt.

Layout, as in network.py: own readings (B, N, 4); sides (2E,), those of area i from start[i] to start[i + 1], at each the
reading of z of `neighbour[side]`; slope (2E,), 0 where the tie is open. The copies of z_i are own[i, 0] and those at
opposite[side] of the closed sides of i.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fusion_sfdia.equation import equation

UNKNOWN = 1e100  # a doubt beyond which nothing is known: such residuals are not judged


@equation
def noise_read(variance: Any, doubt: Any) -> Any:
    """Noise variance of what stands for a reading: 0 where it is an estimate, which `doubt` > 0 says."""
    return variance * (doubt == 0.0)


@equation
def private_term(value: Any, residual: Any, lam: Any) -> Any:
    """(5): f(y) - lam e, with value = f(y); the estimate of a state that is not shared."""
    return value - lam * residual


@equation
def shared_term(held: Any, drive: Any, residual: Any, a: Any, lam: Any) -> Any:
    """The bracket of (6), which an area tells the others who share: a y_j + drive - lam e_j."""
    return a * held + drive - lam * residual


@equation
def precision_read(variance: Any, doubt: Any) -> Any:
    """1 / v_j of the corrected (17), where v_j is the variance of what stands for the reading."""
    return 1.0 / (noise_read(variance, doubt) + doubt * doubt)


@equation
def precision_printed(variance: Any, doubt: Any, a: Any, drive_variance: Any, process_variance: Any) -> Any:
    """1 / v_j of (17) as printed: v_j = a^2 sigma_j^2 + Var[drive] + sigma_w^2 + sigma_j^2."""
    return 1.0 / (a * a * (noise_read(variance, doubt) + doubt * doubt) + drive_variance + process_variance + variance)


@equation
def printed_variance(variance: Any, doubt: Any, a: Any, drive_variance: Any, process_variance: Any) -> Any:
    """The bracket of (15) as printed: a^2 sigma_j^2 + Var[drive] + sigma_w^2 + sigma_j^2."""
    return a * a * noise_read(variance, doubt) + drive_variance + process_variance + variance


@equation
def error_deviation(memory: Any, variance: Any, process_variance: Any, doubt: Any) -> Any:
    """Bound of the standard deviation of x - x_hat: lam s + sqrt(Var[f(x) - f(y)] + sigma_w^2) + doubts."""
    return memory + np.sqrt(variance + process_variance) + doubt


@equation
def residual_deviation(memory: Any, variance: Any, process_variance: Any, noise: Any, doubt: Any) -> Any:
    """(14): s of a reading with this noise, lam s + sqrt(Var[f(x) - f(y)] + sigma_w^2 + sigma^2) + doubts."""
    return memory + np.sqrt(variance + process_variance + noise) + doubt
