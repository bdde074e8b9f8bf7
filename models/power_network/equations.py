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

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import COMPLEX_STEP, compiled, equation

Array = NDArray[Any]

STATES = ("theta", "omega", "p_m", "p_v")
THETA, OMEGA, P_M, P_V = range(4)
LANES = 16  # areas whose exponentials are computed together
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
def area_matrices(stiffness: Any, constants: Any, along: Any) -> Any:
    """(M, 1 + D, 4, 6): the columns of A_ii, of B_i for the reference and of the external power; the equations at unit vectors.

    stiffness (M,); constants (M, 5): inertia, droop, damping, turbine time, governor time. along (D,): with respect to which of
    the stiffness (0) and the constants (1 to 5) derivatives follow, by the complex step, one after the other.
    """
    result = np.zeros((stiffness.size, 1 + along.size, 4, 6))
    unit, of = np.zeros(6, np.complex128), np.zeros(6)
    for i in range(stiffness.size):
        for lane in range(1 + along.size):
            of[:] = 0.0
            if lane > 0:
                of[along[lane - 1]] = COMPLEX_STEP
            for column in range(6):
                unit[:] = 0.0
                unit[column] = 1.0
                rates = area_rates(
                    unit[0], unit[1], unit[2], unit[3], unit[4], unit[5],
                    complex(stiffness[i], of[0]), complex(constants[i, 0], of[1]), complex(constants[i, 1], of[2]),
                    complex(constants[i, 2], of[3]), complex(constants[i, 3], of[4]), complex(constants[i, 4], of[5]),
                )  # fmt: skip
                for row, rate in enumerate(rates):
                    result[i, lane, row, column] = rate.imag / COMPLEX_STEP if lane > 0 else rate.real
    return result


@equation
def multiply(a: Any, b: Any, into: Any) -> None:
    """Write [A B; 0 1] [F G; 0 1] and its derivatives to into, of such a and b, each (1 + D, 24 LANES); a lane is an area."""
    for d in range(a.shape[0]):
        for row in range(4):
            left, change = a[0, 6 * row * LANES : 6 * (row + 1) * LANES], a[d, 6 * row * LANES : 6 * (row + 1) * LANES]
            for column in range(6):
                own, out = change[column * LANES :], into[d, (6 * row + column) * LANES :]
                moved, right = b[d, column * LANES :], b[0, column * LANES :]
                share = 1.0 if column > 3 else 0.0
                for k in range(LANES):
                    out[k] = (
                        share * own[k] + left[k] * moved[k] + left[LANES + k] * moved[6 * LANES + k]
                        + left[2 * LANES + k] * moved[12 * LANES + k] + left[3 * LANES + k] * moved[18 * LANES + k]
                    )  # fmt: skip
                if d > 0:
                    for k in range(LANES):
                        out[k] += (
                            change[k] * right[k] + change[LANES + k] * right[6 * LANES + k]
                            + change[2 * LANES + k] * right[12 * LANES + k] + change[3 * LANES + k] * right[18 * LANES + k]
                        )  # fmt: skip


@compiled
def hold(matrices: Any, dt: Any) -> Any:
    """(M, 1 + D, 4, 6): [F_i, b_i, g_i] of x+ = F x + b u + g e with u and e held over dt, and its derivatives.

    matrices: [A_i, B_i, G_i] and its derivatives. exp([A B; 0 0] dt) by scaling to a norm of at most 1/2, a Taylor series and
    squaring, differentiated step by step; each area by itself: its numbers do not depend on which other areas are computed.
    """
    result = np.empty_like(matrices)
    areas, many = matrices.shape[0], matrices.shape[1]
    scaled, now, following = np.zeros((many, 24 * LANES)), np.zeros((many, 24 * LANES)), np.zeros((many, 24 * LANES))
    squarings = np.zeros(LANES, np.int64)
    for begin in range(0, areas, LANES):
        lanes = min(LANES, areas - begin)
        for k in range(lanes):
            norm = 1e-300  # elements one by one: numba takes seconds to compile the same by arrays
            for row in range(4):
                across = 0.0
                for column in range(6):
                    across += abs(matrices[begin + k, 0, row, column] * dt)
                norm = max(norm, across)
            squarings[k] = max(0, int(np.ceil(np.log2(norm))) + 1)
            for d in range(many):
                for at in range(24):
                    scaled[d, at * LANES + k] = matrices[begin + k, d, at // 6, at % 6] * dt / 2.0 ** squarings[k]
        now[:] = 0.0
        for term in range(TERMS, -1, -1):  # S now / k + 1, with S = [A B; 0 0]
            if term < TERMS:
                multiply(scaled, now, following)
                for d in range(many):
                    for j in range(24 * LANES):
                        now[d, j] = following[d, j] / (term + 1.0)
            for row in range(4):
                for k in range(LANES):
                    now[0, 7 * row * LANES + k] += 1.0
        for step in range(squarings.max()):  # [F G; 0 1]^2
            multiply(now, now, following)
            for d in range(many):
                for at in range(24):
                    for k in range(LANES):
                        if step < squarings[k]:
                            now[d, at * LANES + k] = following[d, at * LANES + k]
        for k in range(lanes):
            for d in range(many):
                for at in range(24):
                    result[begin + k, d, at // 6, at % 6] = now[d, at * LANES + k]
    return result


def rows_of(stiffness: Array, constants: Array, dt: float, along: Sequence[int] = ()) -> Array:
    """[F_i, b_i, g_i] of areas with stiffness (...) and constants (..., 5), and D derivatives: (..., 1 + D, 4, 6).

    along, constants: as in `area_matrices`.
    """
    matrices = area_matrices(stiffness.ravel(), constants.reshape(-1, 5), np.array(along, int))
    return np.asarray(hold(matrices, dt).reshape(*stiffness.shape, 1 + len(along), 4, 6))


@compiled
def by_all(held: Any, v: Any, x: Any, slope: Any, start: Any, neighbour: Any, link: Any, closed: Any, ties: int) -> Any:
    """Derivatives (B, 4 N, 8 N + E) of the states after a step: by states, references, loads, slopes, inertias and droops.

    held (B, N, 4, 4, 6): `rows_of` along stiffness, inertia and droop; v (B, N, 6): what they act on; x (B, 4 N). slope
    (B, 2E) to closed: of the sides of the E ties.
    """
    n = held.shape[1]
    found = np.zeros((x.shape[0], 4 * n, 8 * n + ties))
    for b in range(x.shape[0]):
        for i in range(n):
            for r in range(4):
                row, area = found[b, 4 * i + r], held[b, i]
                gain, by_stiffness, by_inertia, by_droop = area[0, r, 5], 0.0, 0.0, 0.0
                for c in range(6):
                    by_stiffness += area[1, r, c] * v[b, i, c]
                    by_inertia += area[2, r, c] * v[b, i, c]
                    by_droop += area[3, r, c] * v[b, i, c]
                for c in range(4):
                    row[4 * i + c] = area[0, r, c]
                row[4 * n + i], row[5 * n + i] = area[0, r, 4], -gain
                row[6 * n + ties + i], row[7 * n + ties + i] = by_inertia, by_droop
                for side in range(start[i], start[i + 1]):
                    if closed[side]:
                        row[4 * neighbour[side]] = slope[b, side] * gain
                        row[6 * n + link[side]] = by_stiffness + gain * x[b, 4 * neighbour[side]]
    return found


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
