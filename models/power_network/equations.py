"""Power network: scalar equations of a generation area and the compiled drivers that join them.

Boem et al. 2018 (B18), sec. VIII, after Riverso 2014; linear, all variables deviations from the operating point:

    theta   rad     angle                        reference  per unit  P_ref, set point of the power
    omega   rad/s   speed                        load       per unit  P_L
    p_m     pu      mechanical power             external   per unit  sum_j P_ij theta_j - P_L: power from outside
    p_v     pu      steam valve                  stiffness  1/rad     sum_j P_ij over the closed ties

The tie lines enter an area twice: in `external` by the neighbours' angles and in `stiffness` by its own, so closing or
opening a tie changes both at once. `external` is all that an area needs of its neighbours. Where it is held over a step
(area by area), it acts as an input does; exactly, it changes with the angles during the step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.equation import compiled, equation

Array = NDArray[Any]

STATES = ("theta", "omega", "p_m", "p_v")
THETA, OMEGA, P_M, P_V = range(4)
TERMS = 18  # of the exponential's series: the last is 0.5^18 / 18! = 6e-22 of the first


@equation
def tie_flow(theta_i: Any, theta_j: Any, slope: Any) -> Any:
    """Power from area i to area j: P_ij (theta_i - theta_j), the linearised power-angle curve."""
    return slope * (theta_i - theta_j)


@equation
def angle_rate(omega: Any) -> Any:
    """Of theta: d theta / dt = omega."""
    return 1.0 * omega


@equation
def speed_rate(theta: Any, omega: Any, p_m: Any, external: Any, stiffness: Any, inertia: Any, damping: Any) -> Any:
    """Of omega: 2 H d omega / dt = p_m - D omega - sum_j P_ij (theta - theta_j) - P_L."""
    return (p_m - damping * omega - stiffness * theta + external) / (2.0 * inertia)


@equation
def turbine_rate(p_m: Any, p_v: Any, turbine_time: Any) -> Any:
    """Of p_m: T_t d p_m / dt = p_v - p_m."""
    return (p_v - p_m) / turbine_time


@equation
def governor_rate(omega: Any, p_v: Any, reference: Any, droop: Any, governor_time: Any) -> Any:
    """Of p_v: T_g d p_v / dt = P_ref - omega / R - p_v."""
    return (reference - omega / droop - p_v) / governor_time


@equation
def area_rates(
    theta: Any, omega: Any, p_m: Any, p_v: Any, reference: Any, external: Any, stiffness: Any,
    inertia: Any, droop: Any, damping: Any, turbine_time: Any, governor_time: Any,
) -> Any:  # fmt: skip
    """The rates of the four states."""
    return (
        angle_rate(omega),
        speed_rate(theta, omega, p_m, external, stiffness, inertia, damping),
        turbine_rate(p_m, p_v, turbine_time),
        governor_rate(omega, p_v, reference, droop, governor_time),
    )


@compiled
def area_matrices(stiffness: Any, constants: Any) -> Any:
    """(M, 4, 6): the columns of A_ii, of B_i for the reference and of the external power; the equations at unit vectors.

    stiffness (M,); constants (M, 5): inertia, droop, damping, turbine time, governor time; both of floats, or complex.
    """
    count = stiffness.size
    result = np.zeros((count, 4, 6), constants.dtype)
    unit = np.zeros(6)
    for i in range(count):
        H, R, D, T_t, T_g = constants[i]
        for column in range(6):
            unit[:] = 0.0
            unit[column] = 1.0
            result[i, 0, column], result[i, 1, column], result[i, 2, column], result[i, 3, column] = area_rates(
                unit[0], unit[1], unit[2], unit[3], unit[4], unit[5], stiffness[i], H, R, D, T_t, T_g
            )
    return result


@compiled
def hold(matrices: Any, dt: Any) -> Any:
    """(M, 4, 6): [F_i, b_i, g_i] of x+ = F x + b u + g e with u and e held over dt, of [A_i, B_i, G_i] (M, 4, 6).

    exp([A B; 0 0] dt) by scaling to a norm of at most 1/2, a Taylor series and squaring, each area by itself: its numbers do
    not depend on which other areas are computed.
    """
    result = np.empty_like(matrices)
    unit, scaled, now, following = (
        np.eye(4, 6),
        np.empty_like(matrices[0]),
        np.empty_like(matrices[0]),
        np.empty_like(matrices[0]),
    )
    for i in range(matrices.shape[0]):
        norm = 1e-300  # elements one by one: numba takes seconds to compile the same by arrays
        for row in range(4):
            across = 0.0
            for column in range(6):
                scaled[row, column] = matrices[i, row, column] * dt
                across += abs(scaled[row, column])
            norm = max(norm, across)
        squarings = max(0, int(np.ceil(np.log2(norm))) + 1)
        for row in range(4):
            for column in range(6):
                scaled[row, column] /= 2.0**squarings
                now[row, column] = unit[row, column]
        for k in range(TERMS, 0, -1):  # S now / k + 1, with S = [A B; 0 0]
            for row in range(4):
                for column in range(6):
                    total = scaled[row, column] if column > 3 else 0.0
                    for inner in range(4):
                        total += scaled[row, inner] * now[inner, column]
                    following[row, column] = total / k + unit[row, column]
            now, following = following, now
        for _ in range(squarings):  # [F G; 0 1]^2
            for row in range(4):
                for column in range(6):
                    total = now[row, column] if column > 3 else 0.0
                    for inner in range(4):
                        total += now[row, inner] * now[inner, column]
                    following[row, column] = total
            now, following = following, now
        for row in range(4):
            for column in range(6):
                result[i, row, column] = now[row, column]
    return result


@compiled
def advance(x: Any, reference: Any, load: Any, area: Any, start: Any, neighbour: Any, slope: Any) -> Any:
    """One step of all areas, the neighbours' angles held: x (B, N, 4), reference and load (B, N) give (B, N, 4).

    area (N, 4, 6): [F_i, b_i, g_i]. start (N + 1,), neighbour and slope (2E,): the sides, slope 0 where a tie is open.
    """
    after = np.empty_like(x)
    for b in range(x.shape[0]):
        for i in range(x.shape[1]):
            external = -load[b, i]
            for side in range(start[i], start[i + 1]):
                external += slope[side] * x[b, neighbour[side], 0]
            for row in range(4):
                after[b, i, row] = (
                    area[i, row, 0] * x[b, i, 0]
                    + area[i, row, 1] * x[b, i, 1]
                    + area[i, row, 2] * x[b, i, 2]
                    + area[i, row, 3] * x[b, i, 3]
                    + area[i, row, 4] * reference[b, i]
                    + area[i, row, 5] * external
                )
    return after
