"""Transient flow of a real gas in a pipe: scalar equations and the compiled drivers that join them.

Shaheen 2024, sec. II, in the physical form behind (5): with velocity v = m z R T / (A p) and its gradient

    v_s = (z R T / (A p)) m_s + v (alpha_1 T_s / T - alpha_2 p_s / p)

mass, momentum and energy (1)-(3) with the identity (4) read

    p_t = -v p_s - rho a^2 v_s + a^2 alpha_1 (q + w v) / (C_p T A)
    m_t = -v m_s - m v_s - A p_s - w
    T_t = -v T_s - (a^2 alpha_1 / C_p) v_s + a^2 alpha_2 (q + w v) / (C_p p A)

Collected in p_s, m_s, T_s this is the matrix (6) but for its entry A_21, which as printed lacks the pressure gradient and
squares the wrong alpha: it must be A - m^2 alpha_2 R T z / (A p^2). Then the eigenvalues are v, v + a, v - a.

The boundary node follows the outgoing characteristics: of the rates that one-sided differences give, the inlet (p, T
prescribed) keeps p_t - rho a v_t of the wave that leaves against the flow, and the outlet (m prescribed) keeps
p_t + rho a v_t and T_t - (alpha_1 / (rho C_p)) p_t of the waves that leave with it.

The pipe is horizontal. Everything holds, and is analytic, for turbulent flow from inlet to outlet (m > 0), where
v |v| = v^2; so it takes complex numbers as well. For m <= 0 the logarithm of Colebrook and White has no real value: the
rates are NaN, never plausible numbers. Limits on the mass flow keep simulations and filters away from there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.dual import dual
from fusion_sfdia.derivatives.equation import compiled, equation
from fusion_sfdia.models.gas_pipeline.natural_gas import Gas

Array = NDArray[Any]

PRESSURE_SCALE = 1e7  # Pa, and
TEMPERATURE_SCALE = 300.0  # K: those of the gas polynomials, of powers
POWERS_OF_PRESSURE = 6  # 1 to 6 and
POWERS_OF_TAU = 6  # 0 to 6
LN10 = float(np.log(10.0))


class PipelineParameters(NamedTuple):
    """Parameters of pipe, surroundings and gas in the equations, in SI."""

    length: float  # m
    diameter: float  # m
    roughness: float  # m
    ambient: float  # K
    heat_transfer: float  # W/(m2 K)
    viscosity: float  # Pa s
    gas_constant: float  # J/(kg K), specific
    z: Array  # (6, 7): z = 1 + sum z[i-1, j] (p / 1e7 Pa)^i (300 K / T - 1)^j
    cp0: Array  # (3,) J/(kg K): ideal-gas heat capacity = sum cp0[k] (T / 300 K - 1)^k
    friction: float = 0.0  # Darcy friction factor; 0 for that of Colebrook and White, from the roughness


UNKNOWN = ("roughness", "ambient", "heat_transfer", "gas_constant")  # which may be given for each state


@equation
def with_unknown(c: PipelineParameters, theta: Any) -> PipelineParameters:
    """The parameters with other values theta (4,) of those in UNKNOWN."""
    return PipelineParameters(
        c.length, c.diameter, theta[0], theta[1], theta[2], c.viscosity, theta[3], c.z, c.cp0, c.friction
    )  # fmt: skip


@equation
def compressibility(p: Any, T: Any, c: PipelineParameters | Gas) -> tuple[Any, Any, Any, Any]:
    """z, alpha_1 = 1 + (T/z) z_T, alpha_2 = 1 - (p/z) z_p, and sum_i z_i''(tau) x^i / i; x = p / 1e7 Pa, tau = 300 K / T."""
    sums = no_powers(p)
    for i in range(POWERS_OF_PRESSURE):
        sums = with_power(i, p, T, sums, c)
    return of_powers(T, sums)


@equation
def no_powers(p: Any) -> tuple[Any, Any, Any, Any, Any]:
    """x, z, x z_x, z_tau and sum_i z_i''(tau) x^i / i of an ideal gas: what `with_power` adds to."""
    x = p / PRESSURE_SCALE
    return x, 1.0 + 0.0 * x, 0.0 * x, 0.0 * x, 0.0 * x


@equation
def with_power(
    i: int, p: Any, T: Any, sums: tuple[Any, Any, Any, Any, Any], c: PipelineParameters | Gas
) -> tuple[Any, Any, Any, Any, Any]:
    """x^(i + 2), and the sums of `no_powers` with the term in x^(i + 1), whose factor is a polynomial in tau - 1."""
    power, z, p_z_p, z_tau, curvature = sums
    y = TEMPERATURE_SCALE / T - 1.0
    value, first, second = c.z[i, POWERS_OF_TAU] + 0.0 * y, 0.0 * y, 0.0 * y  # of the factor, d/dtau, (d/dtau)^2 / 2
    for k in range(POWERS_OF_TAU):
        second = second * y + first
        first = first * y + value
        value = value * y + c.z[i, POWERS_OF_TAU - 1 - k]
    return (
        power * (p / PRESSURE_SCALE),
        z + power * value,
        p_z_p + (i + 1.0) * power * value,
        z_tau + power * first,
        curvature + 2.0 / (i + 1.0) * power * second,
    )


@equation
def of_powers(T: Any, sums: tuple[Any, Any, Any, Any, Any]) -> tuple[Any, Any, Any, Any]:
    """What `compressibility` returns, from its sums over all powers."""
    _, z, p_z_p, z_tau, curvature = sums
    return z, 1.0 - TEMPERATURE_SCALE / T * z_tau / z, 1.0 - p_z_p / z, curvature


@equation
def heat_capacity(T: Any, curvature: Any, c: PipelineParameters | Gas) -> Any:
    """C_p = C_p0(T) - T int_0^p v_TT dp in J/(kg K), with v = z R T / p: C_p0 - R tau^2 sum_i z_i''(tau) x^i / i."""
    tau = TEMPERATURE_SCALE / T
    warmth = T / TEMPERATURE_SCALE - 1.0
    return c.cp0[0] + warmth * (c.cp0[1] + warmth * c.cp0[2]) - c.gas_constant * tau * tau * curvature


@equation
def gas(p: Any, T: Any, c: PipelineParameters | Gas) -> tuple[Any, Any, Any, Any]:
    """z, alpha_1, alpha_2 and C_p, of one equation of state: heat capacity and compressibility cannot contradict each other."""
    z, alpha_1, alpha_2, curvature = compressibility(p, T, c)
    return z, alpha_1, alpha_2, heat_capacity(T, curvature, c)


@equation
def wave_speed_squared(p: Any, rho: Any, T: Any, alpha_1: Any, alpha_2: Any, cp: Any) -> Any:
    """a_s^2 = (d p / d rho)_s, m2/s2 (Shaheen 2024, below (5))."""
    return p / (rho * (alpha_2 - p / (rho * cp * T) * alpha_1 * alpha_1))


@equation
def friction_factor(m: Any, c: PipelineParameters) -> Any:
    """Darcy f of Colebrook and White, 1/sqrt f = -2 log10(eps/(3.7 d) + 2.51/(Re sqrt f)), Re = 4 m / (pi d mu).

    Two steps in 1/sqrt f from 10 (f = 0.01) by Householder's method of order 3, whose error goes with the fourth power: exact
    to 1e-15 from 1 kg/s in the paper's pipe. One logarithm is taken; in the first step it grows by ln(after/before) = 2 artanh
    s, s = (after - before)/(after + before), whose series to s^19 leaves 1e-14 where 1/sqrt f is between 6 and 17. A friction
    factor among the parameters replaces it for any turbulent flow; the logarithm makes that NaN for m <= 0, too.
    """
    inside = friction_start(m, c)
    return friction_from(m, inside, np.log(inside), c)


@equation
def friction_start(m: Any, c: PipelineParameters) -> Any:
    """Of what `friction_factor` takes the logarithm: eps/(3.7 d) + 2.51/(Re sqrt f) at 1/sqrt f = 10, or m where f is given."""
    if c.friction > 0.0:
        return 1.0 * m
    return c.roughness / (3.7 * c.diameter) + 2.51 * np.pi * c.diameter * c.viscosity / (4.0 * m) * 10.0


@equation
def friction_from(m: Any, inside: Any, logarithm: Any, c: PipelineParameters) -> Any:
    """`friction_factor` from what `friction_start` gives, and its logarithm: apart from it, this takes arithmetic alone."""
    if c.friction > 0.0:
        return c.friction + 0.0 * logarithm
    b = 2.51 * np.pi * c.diameter * c.viscosity / (4.0 * m)
    root, slope = 10.0 + 0.0 * b, b / inside
    change = friction_change(root, slope, logarithm)
    y = slope * change  # the change of `inside` over it
    s = y / (2.0 + y)
    artanh = 0.0 * s
    for k in range(10):
        artanh = artanh * (s * s) + 1.0 / (19.0 - 2.0 * k)
    root = root + change
    root = root + friction_change(root, b / (inside + inside * y), logarithm + 2.0 * s * artanh)
    return 1.0 / (root * root)


@equation
def friction_change(root: Any, slope: Any, logarithm: Any) -> Any:
    """Householder's step of order 3 from 1/sqrt f towards F = 1/sqrt f + 2/ln(10) ln(inside) = 0 (Householder 1970).

    slope: q = d ln(inside) / d(1/sqrt f). The derivatives of F are 1 + k, -k q and 2 k q^2 with k = 2/ln(10) q.
    """
    k = 2.0 / LN10 * slope
    error = root + 2.0 / LN10 * logarithm
    g, first = slope * error, 1.0 + k
    return -error * (6.0 * first * first + 3.0 * g * k) / (6.0 * first * first * first + g * k * (6.0 * first + 2.0 * g))


@equation
def flow(p: Any, m: Any, T: Any, f: Any, known: tuple[Any, ...], c: PipelineParameters) -> tuple[Any, ...]:
    """v, rho, a^2, alpha_1, alpha_2, C_p, w and a^2 (q + w v) / (C_p A), with known = compressibility(p, T, c)."""
    z, alpha_1, alpha_2, curvature = known
    cp = heat_capacity(T, curvature, c)
    area = 0.25 * np.pi * c.diameter * c.diameter
    rho = p / (z * c.gas_constant * T)
    v = m / (rho * area)
    a2 = wave_speed_squared(p, rho, T, alpha_1, alpha_2, cp)
    w = 0.125 * f * rho * v * v * np.pi * c.diameter
    q = -np.pi * c.diameter * c.heat_transfer * (T - c.ambient)
    return v, rho, a2, alpha_1, alpha_2, cp, w, a2 * (q + w * v) / (cp * area)


@equation
def rates_along(
    p: Any, m: Any, T: Any, p_s: Any, m_s: Any, T_s: Any, local: tuple[Any, ...], c: PipelineParameters
) -> tuple[Any, Any, Any]:
    """p_t (Pa/s), m_t (kg/s2), T_t (K/s) with gradients p_s, m_s, T_s, and local = flow(p, m, T, ...)."""
    v, rho, a2, alpha_1, alpha_2, cp, w, source = local
    area = 0.25 * np.pi * c.diameter * c.diameter
    v_s = m_s / (rho * area) + v * (alpha_1 * T_s / T - alpha_2 * p_s / p)
    p_t = -v * p_s - rho * a2 * v_s + alpha_1 * source / T
    m_t = -v * m_s - m * v_s - area * p_s - w
    T_t = -v * T_s - a2 * alpha_1 / cp * v_s + alpha_2 * source / p
    return p_t, m_t, T_t


@equation
def rates(p: Any, m: Any, T: Any, p_s: Any, m_s: Any, T_s: Any, f: Any, c: PipelineParameters) -> tuple[Any, ...]:
    """p_t (Pa/s), m_t (kg/s2), T_t (K/s), and v, rho, a^2, alpha_1, alpha_2, C_p for the boundaries; f = friction_factor."""
    local = flow(p, m, T, f, compressibility(p, T, c), c)
    p_t, m_t, T_t = rates_along(p, m, T, p_s, m_s, T_s, local, c)
    v, rho, a2, alpha_1, alpha_2, cp, _, _ = local
    return p_t, m_t, T_t, v, rho, a2, alpha_1, alpha_2, cp


@equation
def acceleration(p: Any, T: Any, local: tuple[Any, ...], c: PipelineParameters) -> Any:
    """v_t, m/s2, of a node with local = rates(...)."""
    p_t, m_t, T_t, v, rho, _, alpha_1, alpha_2, _ = local
    area = 0.25 * np.pi * c.diameter * c.diameter
    return m_t / (rho * area) + v * (alpha_1 * T_t / T - alpha_2 * p_t / p)


@equation
def inlet_rates(
    p: Any, T: Any, local: tuple[Any, ...], p_given: Any, T_given: Any, c: PipelineParameters
) -> tuple[Any, Any, Any]:
    """Rates at the inlet, where p_t and T_t are given; m_t from the wave v - a. local: `rates` there without a boundary."""
    p_t, _, _, v, rho, a2, alpha_1, alpha_2, _ = local
    v_t = acceleration(p, T, local, c) + (p_given - p_t) / (rho * np.sqrt(a2))
    area = 0.25 * np.pi * c.diameter * c.diameter
    return p_given, rho * area * (v_t - v * (alpha_1 * T_given / T - alpha_2 * p_given / p)), T_given


@equation
def outlet_rates(p: Any, T: Any, local: tuple[Any, ...], m_given: Any, c: PipelineParameters) -> tuple[Any, Any, Any]:
    """Rates at the outlet, where m_t is given; p_t and T_t from the waves v + a and v. local: `rates` without a boundary."""
    p_t, _, T_t, v, rho, a2, alpha_1, alpha_2, cp = local
    a, v_t = np.sqrt(a2), acceleration(p, T, local, c)
    area = 0.25 * np.pi * c.diameter * c.diameter
    kappa = alpha_1 / (rho * cp)
    entropy = T_t - kappa * p_t
    per_p = v * (alpha_1 * kappa / T - alpha_2 / p)
    p_out = (p_t + rho * a * (v_t - m_given / (rho * area) - v * alpha_1 * entropy / T)) / (1.0 + rho * a * per_p)
    return p_out, m_given, entropy + kappa * p_out


# The driver takes states in lanes of up to LANES, (3n, LANES) with the lane last, and a node's operands lie in one flat array
# `w` at known distances: the compiler vectorises the loops over lanes, and a lane has the bits that it has alone. The equations
# are inlined where they are called: `rates` stands in each driver once, as most of the time of its compilation is theirs.
LANES = 64
ROOM = 19  # rows of w


@compiled
def slope(lanes: int, x: Any, given: Any, c: PipelineParameters, stencil: Array, w: Any, out: Any) -> None:
    """Write to out (3n, LANES) dx/dt of states [p, m, T], with the rates `given` (3, LANES) at the boundaries (p, T in, m out).

    w (ROOM LANES,) is workspace for a node's p, m, T, p_s, m_s, T_s, f, given rates and what `rates` returns.
    """
    n = x.shape[0] // 3
    for i in range(n):
        first = min(max(i - 2, 0), n - 5)
        row = i if i < 2 else (2 if i < n - 2 else i - n + 5)
        for v in range(3):
            at = v * n + first
            for k in range(lanes):
                w[v * LANES + k] = x[v * n + i, k]
                w[(7 + v) * LANES + k] = given[v, k]
                w[(3 + v) * LANES + k] = (
                    stencil[row, 0] * x[at, k]
                    + stencil[row, 1] * x[at + 1, k]
                    + stencil[row, 2] * x[at + 2, k]
                    + stencil[row, 3] * x[at + 3, k]
                    + stencil[row, 4] * x[at + 4, k]
                )
        for k in range(lanes):
            w[6 * LANES + k] = friction_start(w[LANES + k], c)
        for k in range(lanes):  # by itself: a logarithm is no vector instruction
            w[10 * LANES + k] = np.log(w[6 * LANES + k])
        for k in range(lanes):
            w[6 * LANES + k] = friction_from(w[LANES + k], w[6 * LANES + k], w[10 * LANES + k], c)
        for k in range(lanes):
            (
                w[10 * LANES + k], w[11 * LANES + k], w[12 * LANES + k], w[13 * LANES + k], w[14 * LANES + k],
                w[15 * LANES + k], w[16 * LANES + k], w[17 * LANES + k], w[18 * LANES + k],
            ) = rates(
                w[k], w[LANES + k], w[2 * LANES + k], w[3 * LANES + k], w[4 * LANES + k], w[5 * LANES + k],
                w[6 * LANES + k], c,
            )  # fmt: skip
        if i == 0 or i == n - 1:
            for k in range(lanes):
                local = (
                    w[10 * LANES + k], w[11 * LANES + k], w[12 * LANES + k], w[13 * LANES + k], w[14 * LANES + k],
                    w[15 * LANES + k], w[16 * LANES + k], w[17 * LANES + k], w[18 * LANES + k],
                )  # fmt: skip
                if i == 0:
                    w[10 * LANES + k], w[11 * LANES + k], w[12 * LANES + k] = inlet_rates(
                        w[k], w[2 * LANES + k], local, w[7 * LANES + k], w[8 * LANES + k], c
                    )
                else:
                    w[10 * LANES + k], w[11 * LANES + k], w[12 * LANES + k] = outlet_rates(
                        w[k], w[2 * LANES + k], local, w[9 * LANES + k], c
                    )
        for v in range(3):
            for k in range(lanes):
                out[v * n + i, k] = w[(10 + v) * LANES + k]


@compiled
def advance(states: Any, inputs: Any, theta: Any, dt: float, substeps: int, c: PipelineParameters, stencil: Array) -> Array:
    """RK4 for a batch of states (B, 3n), inputs (B, 3) = (p_in, T_in, m_out) that the boundary reaches at the end of dt.

    theta: the parameters UNKNOWN, (1, 4) for all states, or (B, 4), with which each state is taken by itself.
    """
    size = states.shape[1]
    n = size // 3
    result: Array = np.empty_like(states)
    x, at = np.empty((size, LANES), states.dtype), np.empty((size, LANES), states.dtype)
    rate, total = np.empty((size, LANES), states.dtype), np.empty((size, LANES), states.dtype)
    given, w = np.empty((3, LANES), states.dtype), np.empty(ROOM * LANES, states.dtype)
    h = dt / substeps
    together = LANES if theta.shape[0] == 1 else 1
    for b in range(0, states.shape[0], together):
        lanes = min(together, states.shape[0] - b)
        d = with_unknown(c, theta[min(b, theta.shape[0] - 1)])
        for k in range(lanes):
            for j in range(size):
                x[j, k] = states[b + k, j]
            given[0, k] = (inputs[b + k, 0] - x[0, k]) / dt
            given[1, k] = (inputs[b + k, 1] - x[2 * n, k]) / dt
            given[2, k] = (inputs[b + k, 2] - x[2 * n - 1, k]) / dt
        for _ in range(substeps):
            for stage in range(4):
                ahead = 1.0 if stage == 3 else 0.5
                weight = 2.0 if 0 < stage < 3 else 1.0
                for j in range(size):
                    for k in range(lanes):
                        at[j, k] = x[j, k] if stage == 0 else x[j, k] + ahead * h * rate[j, k]
                slope(lanes, at, given, d, stencil, w, rate)
                for j in range(size):
                    for k in range(lanes):
                        total[j, k] = rate[j, k] if stage == 0 else total[j, k] + weight * rate[j, k]
            for j in range(size):
                for k in range(lanes):
                    x[j, k] += h / 6.0 * total[j, k]
        for k in range(lanes):
            for j in range(size):
                result[b + k, j] = x[j, k]
    return result


# Derivatives take two passes. In the first the lanes are the nodes of one state: each node's rates depend on its own p, m, T,
# their gradients, the rates given at the boundaries and the parameters, and dual numbers give these few derivatives. In the
# second, the chain rule through stencil and stages, the lanes are columns of the Jacobian, so few that they stay in the cache.
EIGHT = 8  # lanes: loops over nodes are filled up to a multiple, since what is left over takes a lane at a time
COLUMNS = 16  # lanes of the second pass
OWN = 9  # directions before those of the parameters


@equation
def taken(w: Any, value: int, slope: int, k: int) -> Any:
    """The dual number of a lane k whose value and slope are in these rows of w."""
    return dual(w[value * LANES + k], w[slope * LANES + k])


@equation
def put(w: Any, value: int, slope: int, k: int, number: Any) -> None:
    """Write a dual number of a lane k to w, its value and slope to these rows."""
    w[value * LANES + k] = number.value
    w[slope * LANES + k] = number.slope


@equation
def sums_of(w: Any, k: int) -> tuple[Any, ...]:
    """The sums over powers of the pressure of a lane k: see `local_derivatives`."""
    return taken(w, 30, 35, k), taken(w, 31, 36, k), taken(w, 32, 37, k), taken(w, 33, 38, k), taken(w, 34, 39, k)


@compiled
def local_derivatives(
    x: Any, given: Any, theta: Any, which: Any, c: PipelineParameters, stencil: Array, w: Any, rate: Any, J: Any
) -> None:
    """Write to rate (3n,) dx/dt as `slope`, and to J (9 + p, 3, n) the derivatives of each node's rates by its p, m, T, their
    gradients, the rates given at the boundaries and the parameters `which` (p,) of theta (4,).

    w (40 LANES,) is workspace for up to LANES nodes: p, m, T, p_s, m_s, T_s, f and its slope, what `flow` returns and its
    slopes, the rates and their slopes, the sums over powers of the pressure and their slopes. A loop over lanes becomes vector
    instructions only where loops in it are short: these sums are taken power by power.
    """
    n = x.shape[0] // 3
    of = np.empty(OWN + 4)
    for begin in range(0, n, LANES):
        nodes = min(LANES, n - begin)
        lanes = (nodes + EIGHT - 1) // EIGHT * EIGHT
        for k in range(lanes):
            i = min(begin + k, n - 1)
            first = max(min(i - 2, n - 5), 0)
            row = i - first
            for v in range(3):
                at = v * n + first
                w[v * LANES + k] = x[v * n + i]
                w[(3 + v) * LANES + k] = (
                    stencil[row, 0] * x[at]
                    + stencil[row, 1] * x[at + 1]
                    + stencil[row, 2] * x[at + 2]
                    + stencil[row, 3] * x[at + 3]
                    + stencil[row, 4] * x[at + 4]
                )
        for a in range(OWN + which.shape[0]):
            for j in range(OWN + 4):
                of[j] = 0.0
            of[a if a < OWN else OWN + which[a - OWN]] = 1.0
            unknown = dual(theta[0], of[9]), dual(theta[1], of[10]), dual(theta[2], of[11]), dual(theta[3], of[12])
            e = with_unknown(c, unknown)
            of_p, of_m, of_T = of[0], of[1], of[2]
            of_f = 1.0 if a == 1 or of[OWN] else 0.0  # friction depends on m and, of the parameters, on the roughness
            if a == 0 or of[OWN]:
                for k in range(lanes):
                    put(w, 6, 7, k, friction_factor(dual(w[LANES + k], 1.0 if a == 0 else 0.0), e))
            if a == 0 or a == 2:
                for j in range(POWERS_OF_PRESSURE):
                    for k in range(lanes):
                        p, T = dual(w[k], of_p), dual(w[2 * LANES + k], of_T)
                        sums = no_powers(p)
                        if j > 0:
                            sums = sums_of(w, k)
                        power, z, p_z_p, z_tau, curvature = with_power(j, p, T, sums, e)
                        put(w, 30, 35, k, power)
                        put(w, 31, 36, k, z)
                        put(w, 32, 37, k, p_z_p)
                        put(w, 33, 38, k, z_tau)
                        put(w, 34, 39, k, curvature)
            elif a == 1 or a == OWN:
                for k in range(35 * LANES, 40 * LANES):
                    w[k] = 0.0
            if a < 3 or a >= OWN:
                for k in range(lanes):
                    p, m, T = dual(w[k], of_p), dual(w[LANES + k], of_m), dual(w[2 * LANES + k], of_T)
                    f = dual(w[6 * LANES + k], of_f * w[7 * LANES + k])
                    v, rho, a2, alpha_1, alpha_2, cp, loss, source = flow(p, m, T, f, of_powers(T, sums_of(w, k)), e)
                    put(w, 8, 16, k, v)
                    put(w, 9, 17, k, rho)
                    put(w, 10, 18, k, a2)
                    put(w, 11, 19, k, alpha_1)
                    put(w, 12, 20, k, alpha_2)
                    put(w, 13, 21, k, cp)
                    put(w, 14, 22, k, loss)
                    put(w, 15, 23, k, source)
            elif a == 3:  # on gradients and given rates it does not depend
                for k in range(16 * LANES, 24 * LANES):
                    w[k] = 0.0
            for k in range(lanes):
                p_t, m_t, T_t = rates_along(
                    dual(w[k], of_p), dual(w[LANES + k], of_m), dual(w[2 * LANES + k], of_T),
                    dual(w[3 * LANES + k], of[3]), dual(w[4 * LANES + k], of[4]), dual(w[5 * LANES + k], of[5]),
                    (
                        taken(w, 8, 16, k), taken(w, 9, 17, k), taken(w, 10, 18, k), taken(w, 11, 19, k),
                        taken(w, 12, 20, k), taken(w, 13, 21, k), taken(w, 14, 22, k), taken(w, 15, 23, k),
                    ), e,
                )  # fmt: skip
                put(w, 24, 27, k, p_t)
                put(w, 25, 28, k, m_t)
                put(w, 26, 29, k, T_t)
            for k in range(nodes):
                i = begin + k
                if i == 0 or i == n - 1:
                    here = (
                        taken(w, 24, 27, k), taken(w, 25, 28, k), taken(w, 26, 29, k), taken(w, 8, 16, k), taken(w, 9, 17, k),
                        taken(w, 10, 18, k), taken(w, 11, 19, k), taken(w, 12, 20, k), taken(w, 13, 21, k),
                    )  # fmt: skip
                    p, T = dual(w[k], of_p), dual(w[2 * LANES + k], of_T)
                    if i == 0:
                        p_t, m_t, T_t = inlet_rates(p, T, here, dual(given[0], of[6]), dual(given[1], of[7]), e)
                    else:
                        p_t, m_t, T_t = outlet_rates(p, T, here, dual(given[2], of[8]), e)
                    put(w, 24, 27, k, p_t)
                    put(w, 25, 28, k, m_t)
                    put(w, 26, 29, k, T_t)
                for v in range(3):
                    J[a, v, i] = w[(27 + v) * LANES + k]
                    if a == 0:
                        rate[v * n + i] = w[(24 + v) * LANES + k]


@compiled
def directional(J: Any, stencil: Array, dgiven: Any, dtheta: Any, parameters: int, along: Any, rate: Any) -> None:
    """Write to rate (3n COLUMNS,) the derivatives of dx/dt along columns: changes `along` (3n COLUMNS,) of the states, of the
    rates given (3 COLUMNS,) and of the first `parameters` of the parameters (p COLUMNS,); J: `local_derivatives`. A node's rows
    of p, m, T follow each other, so that those of its stencil are at known distances.
    """
    n = along.shape[0] // (3 * COLUMNS)
    for i in range(n):
        first = max(min(i - 2, n - 5), 0)  # in this order the compiler sees that it is not negative
        row = i - first
        d0, d1, d2, d3, d4 = stencil[row, 0], stencil[row, 1], stencil[row, 2], stencil[row, 3], stencil[row, 4]
        near, own = along[3 * COLUMNS * first : 3 * COLUMNS * (first + 5)], along[3 * COLUMNS * i : 3 * COLUMNS * (i + 1)]
        into = rate[3 * COLUMNS * i : 3 * COLUMNS * (i + 1)]
        pp, pm, pT, pp_s, pm_s, pT_s = J[0, 0, i], J[1, 0, i], J[2, 0, i], J[3, 0, i], J[4, 0, i], J[5, 0, i]
        mp, mm, mT, mp_s, mm_s, mT_s = J[0, 1, i], J[1, 1, i], J[2, 1, i], J[3, 1, i], J[4, 1, i], J[5, 1, i]
        Tp, Tm, TT, Tp_s, Tm_s, TT_s = J[0, 2, i], J[1, 2, i], J[2, 2, i], J[3, 2, i], J[4, 2, i], J[5, 2, i]
        for k in range(COLUMNS):
            p, m, T = own[k], own[COLUMNS + k], own[2 * COLUMNS + k]
            p_s = (
                d0 * near[k] + d1 * near[3 * COLUMNS + k] + d2 * near[6 * COLUMNS + k]
                + d3 * near[9 * COLUMNS + k] + d4 * near[12 * COLUMNS + k]
            )  # fmt: skip
            m_s = (
                d0 * near[COLUMNS + k] + d1 * near[4 * COLUMNS + k] + d2 * near[7 * COLUMNS + k]
                + d3 * near[10 * COLUMNS + k] + d4 * near[13 * COLUMNS + k]
            )  # fmt: skip
            T_s = (
                d0 * near[2 * COLUMNS + k] + d1 * near[5 * COLUMNS + k] + d2 * near[8 * COLUMNS + k]
                + d3 * near[11 * COLUMNS + k] + d4 * near[14 * COLUMNS + k]
            )  # fmt: skip
            into[k] = pp * p + pm * m + pT * T + pp_s * p_s + pm_s * m_s + pT_s * T_s
            into[COLUMNS + k] = mp * p + mm * m + mT * T + mp_s * p_s + mm_s * m_s + mT_s * T_s
            into[2 * COLUMNS + k] = Tp * p + Tm * m + TT * T + Tp_s * p_s + Tm_s * m_s + TT_s * T_s
        for v in range(3):
            if i == 0 or i == n - 1:
                for j in range(3):
                    for k in range(COLUMNS):
                        into[v * COLUMNS + k] += J[6 + j, v, i] * dgiven[j * COLUMNS + k]
            for j in range(parameters):
                for k in range(COLUMNS):
                    into[v * COLUMNS + k] += J[OWN + j, v, i] * dtheta[j * COLUMNS + k]


@compiled
def tangents_of_stages(
    states: Any, inputs: Any, theta: Any, which: Any, dt: float, c: PipelineParameters, stencil: Array, reached: Array, J: Array
) -> None:
    """Write to `reached` (B, 3n) the states as by `advance`, and to J (B, substeps, 4, 9 + p, 3, n) the derivatives of the
    rates in each stage: see `local_derivatives`.
    """
    size, substeps = states.shape[1], J.shape[1]
    n = size // 3
    x, at, rate, total = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    given, w = np.empty(3), np.empty(40 * LANES)
    h = dt / substeps
    for b in range(states.shape[0]):
        own = theta[min(b, theta.shape[0] - 1)]
        for i in range(size):
            x[i] = at[i] = states[b, i]
            total[i] = 0.0
        given[0] = (inputs[b, 0] - x[0]) / dt
        given[1] = (inputs[b, 1] - x[2 * n]) / dt
        given[2] = (inputs[b, 2] - x[2 * n - 1]) / dt
        for part in range(substeps):
            for stage in range(4):
                ahead = 1.0 if stage == 2 else 0.5  # of the next stage
                weight = 2.0 if 0 < stage < 3 else 1.0
                local_derivatives(at, given, own, which, c, stencil, w, rate, J[b, part, stage])
                for i in range(size):
                    total[i] += weight * rate[i]
                    at[i] = x[i] + ahead * h * rate[i]
            for i in range(size):
                x[i] += h / 6.0 * total[i]
                at[i], total[i] = x[i], 0.0
        for i in range(size):  # by arrays numba takes seconds more
            reached[b, i] = x[i]


@compiled
def chain_of_stages(J: Array, columns: Array, dt: float, stencil: Array, result: Array) -> None:
    """Write to result (B, 3n, M) the derivatives of `advance_tangent` by the chain rule, from J of `tangents_of_stages`."""
    runs, substeps, n, count = J.shape[0], J.shape[1], J.shape[5], columns.shape[0]
    size, parameters = 3 * n, J.shape[3] - OWN
    dx, along = np.empty(size * COLUMNS), np.empty(size * COLUMNS)
    drate, dtotal = np.empty(size * COLUMNS), np.empty(size * COLUMNS)
    dgiven, dtheta = np.empty(3 * COLUMNS), np.empty(parameters * COLUMNS)
    h = dt / substeps
    for b in range(runs):
        for begin in range(0, count, COLUMNS):
            lanes = min(COLUMNS, count - begin)
            for i in range(size * COLUMNS):
                dx[i] = dtotal[i] = 0.0
            for i in range(3 * COLUMNS):
                dgiven[i] = 0.0
            for i in range(parameters * COLUMNS):
                dtheta[i] = 0.0
            for k in range(lanes):
                j = columns[begin + k]
                if j < size:
                    dx[(3 * (j % n) + j // n) * COLUMNS + k] = 1.0
                    if j == 0:
                        dgiven[k] = -1.0 / dt
                    elif j == 2 * n:
                        dgiven[COLUMNS + k] = -1.0 / dt
                    elif j == 2 * n - 1:
                        dgiven[2 * COLUMNS + k] = -1.0 / dt
                elif j < size + 3:
                    dgiven[(j - size) * COLUMNS + k] = 1.0 / dt
                else:  # the last columns, one for each
                    dtheta[(begin + k - count + parameters) * COLUMNS + k] = 1.0
            for i in range(size * COLUMNS):
                along[i] = dx[i]
            changing = parameters if columns[begin + lanes - 1] >= size + 3 else 0
            for part in range(substeps):
                for stage in range(4):
                    ahead = 1.0 if stage == 2 else 0.5  # of the next stage
                    weight = 2.0 if 0 < stage < 3 else 1.0
                    directional(J[b, part, stage], stencil, dgiven, dtheta, changing, along, drate)
                    for i in range(size * COLUMNS):
                        dtotal[i] += weight * drate[i]
                    if stage < 3:
                        for i in range(size * COLUMNS):
                            along[i] = dx[i] + ahead * h * drate[i]
                for i in range(size * COLUMNS):
                    dx[i] += h / 6.0 * dtotal[i]
                    along[i] = dx[i]
                    dtotal[i] = 0.0
            for v in range(3):
                for i in range(n):
                    for k in range(lanes):
                        result[b, v * n + i, begin + k] = dx[(3 * i + v) * COLUMNS + k]


def advance_tangent(
    states: Any, inputs: Any, theta: Any, columns: Any, dt: float, substeps: int, c: PipelineParameters, stencil: Array
) -> tuple[Array, Array]:
    """States (B, 3n) as by `advance`, and their derivatives (B, 3n, M) with respect to those of (states, inputs, parameters
    UNKNOWN) whose positions are `columns` (M,), in ascending order, by the chain rule through the stages.
    """
    B, size = states.shape
    which = columns[columns >= size + 3] - (size + 3)
    reached, result = np.empty((B, size)), np.empty((B, size, columns.size))
    J = np.empty((B, substeps, 4, OWN + which.size, 3, size // 3))
    tangents_of_stages(states, inputs, theta, which, dt, c, stencil, reached, J)
    chain_of_stages(J, columns, dt, stencil, result)
    return reached, result
