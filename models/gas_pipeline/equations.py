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

from fusion_sfdia.core.equation import compiled, equation
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
    x = p / PRESSURE_SCALE
    tau = TEMPERATURE_SCALE / T
    y = tau - 1.0
    power = x
    z = 1.0 + 0.0 * x
    p_z_p = 0.0 * x
    z_tau = 0.0 * x
    curvature = 0.0 * x
    for i in range(POWERS_OF_PRESSURE):
        value, first, second = c.z[i, POWERS_OF_TAU] + 0.0 * y, 0.0 * y, 0.0 * y  # of the row, d/dtau, (d/dtau)^2 / 2
        for k in range(POWERS_OF_TAU):
            second = second * y + first
            first = first * y + value
            value = value * y + c.z[i, POWERS_OF_TAU - 1 - k]
        z = z + power * value
        p_z_p = p_z_p + (i + 1.0) * power * value
        z_tau = z_tau + power * first
        curvature = curvature + 2.0 / (i + 1.0) * power * second
        power = power * x
    return z, 1.0 - tau * z_tau / z, 1.0 - p_z_p / z, curvature


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

    Three Newton steps in 1/sqrt f from 10 (f = 0.01): exact to 1e-12 from 10 kg/s in the paper's pipe, to 1e-10 at 1 kg/s.
    One logarithm is taken; from step to step it grows by ln(after/before) = 2 artanh s, s = (after - before)/(after + before),
    whose series to s^19 leaves 1e-14 where 1/sqrt f is between 6 and 17. A friction factor among the parameters replaces it
    for any turbulent flow; the logarithm makes that NaN for m <= 0, too.
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
    rough = c.roughness / (3.7 * c.diameter)
    root = 10.0 + 0.0 * b
    root = root - (root + 2.0 / LN10 * logarithm) / (1.0 + 2.0 / LN10 * b / inside)
    for _ in range(2):
        before = inside
        inside = rough + b * root
        s = (inside - before) / (inside + before)
        artanh = 0.0 * s
        for k in range(10):
            artanh = artanh * s * s + 1.0 / (19.0 - 2.0 * k)
        logarithm = logarithm + 2.0 * s * artanh
        root = root - (root + 2.0 / LN10 * logarithm) / (1.0 + 2.0 / LN10 * b / inside)
    return 1.0 / (root * root)


@equation
def friction_near(f: Any, m: Any, c: PipelineParameters) -> Any:
    """`friction_factor` by one Newton step in 1/sqrt f from a value f at m and c, or at such that differ by next to nothing.

    There the step does not depend on where it begins, so that a complex step of m or c gives the derivatives of f.
    """
    if c.friction > 0.0:
        return c.friction + 0.0 * np.log(m)
    b = 2.51 * np.pi * c.diameter * c.viscosity / (4.0 * m)
    root = 1.0 / np.sqrt(f)
    inside = c.roughness / (3.7 * c.diameter) + b * root
    root = root - (root + 2.0 / LN10 * np.log(inside)) / (1.0 + 2.0 / LN10 * b / inside)
    return 1.0 / (root * root)


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


@compiled
def tangent_slope(
    x: Any, given: Any, dx: Any, dgiven: Any, theta: Any, which: Any, c: PipelineParameters, stencil: Array, k: Any, dk: Any
) -> None:
    """Write to k dx/dt (3n,) as `slope`, and to dk (3n, M) its derivative along the columns of dx (3n, M), dgiven (3, M), the
    last with respect to the parameters `which` (p,) of theta (4,).

    Each node depends on its own p, m, T, their gradients and the parameters: a complex step of each gives its small Jacobian,
    which is exact to rounding; the stencil does the rest. The polynomials of the gas, most of the work, depend on p and T,
    and `flow` does not depend on gradients. All else is complex throughout, so that it is compiled for one type.
    """
    n, variables = x.shape[0] // 3, 9 + which.shape[0]
    columns = dx.shape[1]
    own = columns - variables  # a parameter, 9 + j among the variables, has the column own + 9 + j
    tiny = 1e-30
    local, at = np.empty(9, np.complex128), np.empty(4, np.complex128)
    gradient = np.empty((3, columns))
    for j in range(4):
        at[j] = theta[j]
    of_gas, usual = (0j, 0j, 0j, 0j), (0j, 0j, 0j, 0j, 0j, 0j, 0j, 0j)  # compressibility and flow where they do not change
    for i in range(n):
        first = min(max(i - 2, 0), n - 5)
        row = i if i < 2 else (2 if i < n - 2 else i - n + 5)
        for v in range(3):
            for j in range(columns):
                gradient[v, j] = 0.0
                dk[v * n + i, j] = 0.0
            local[v] = x[v * n + i]
            s = 0.0
            for near in range(5):
                d = stencil[row, near]
                s += d * x[v * n + first + near]
                for j in range(columns):
                    gradient[v, j] += d * dx[v * n + first + near, j]
            local[3 + v] = s
            local[6 + v] = given[v]
        p, T = local[0].real, local[2].real
        still = friction_factor(local[1].real, c)
        for a in range(variables):
            if 6 <= a < 9 and 0 < i < n - 1:
                continue
            if a < 9:
                local[a] += 1j * tiny
            else:
                at[which[a - 9]] += 1j * tiny
            e = with_unknown(c, at)
            f = friction_near(still, local[1], e) if a == 1 or a >= 9 else still + 0j
            known, flows = of_gas, usual
            if a == 0:
                known = compressibility(local[0], T, c)
            elif a == 2:
                known = compressibility(p, local[2], c)
            if a < 3 or a >= 9:
                flows = flow(local[0], local[1], local[2], f, known, e)
            r0, r1, r2 = rates_along(local[0], local[1], local[2], local[3], local[4], local[5], flows, e)
            if a == 0:
                of_gas = known[0].real + 0j, known[1].real + 0j, known[2].real + 0j, known[3].real + 0j
                usual = (
                    flows[0].real + 0j, flows[1].real + 0j, flows[2].real + 0j, flows[3].real + 0j,
                    flows[4].real + 0j, flows[5].real + 0j, flows[6].real + 0j, flows[7].real + 0j,
                )  # fmt: skip
            here = r0, r1, r2, flows[0], flows[1], flows[2], flows[3], flows[4], flows[5]
            if i == 0:
                r0, r1, r2 = inlet_rates(local[0], local[2], here, local[6], local[7], e)
            elif i == n - 1:
                r0, r1, r2 = outlet_rates(local[0], local[2], here, local[8], e)
            j0, j1, j2 = r0.imag / tiny, r1.imag / tiny, r2.imag / tiny
            if a == 0:
                k[i], k[n + i], k[2 * n + i] = r0.real, r1.real, r2.real
            if a >= 9:
                at[which[a - 9]] = theta[which[a - 9]]
                dk[i, own + a] += j0
                dk[n + i, own + a] += j1
                dk[2 * n + i, own + a] += j2
                continue
            local[a] = local[a].real
            along = dx[a * n + i] if a < 3 else (gradient[a - 3] if a < 6 else dgiven[a - 6])
            for j in range(columns):
                dk[i, j] += j0 * along[j]
                dk[n + i, j] += j1 * along[j]
                dk[2 * n + i, j] += j2 * along[j]


@compiled
def advance_tangent(
    states: Any, inputs: Any, theta: Any, which: Any, dt: float, substeps: int, c: PipelineParameters, stencil: Array
) -> Array:
    """Derivatives (B, 3n, 3n + 3 + p) of `advance` with respect to states, inputs and the parameters `which` (p,), by the chain
    rule through its stages.
    """
    size = states.shape[1]
    n, width = size // 3, size + 3 + which.shape[0]
    result = np.zeros((states.shape[0], size, width))
    x, at, rate, total = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    along, drate, dtotal = np.empty((size, width)), np.empty((size, width)), np.empty((size, width))
    given, dgiven = np.empty(3), np.zeros((3, width))
    dgiven[0, 0] = dgiven[1, 2 * n] = dgiven[2, 2 * n - 1] = -1.0 / dt
    dgiven[0, size] = dgiven[1, size + 1] = dgiven[2, size + 2] = 1.0 / dt
    h = dt / substeps
    for b in range(states.shape[0]):
        own = theta[min(b, theta.shape[0] - 1)]
        d = with_unknown(c, own)
        dx = result[b]
        for i in range(size):
            x[i] = states[b, i]
            dx[i, i] = 1.0
        given[0] = (inputs[b, 0] - x[0]) / dt
        given[1] = (inputs[b, 1] - x[2 * n]) / dt
        given[2] = (inputs[b, 2] - x[2 * n - 1]) / dt
        for _ in range(substeps):
            for stage in range(4):
                ahead = 1.0 if stage == 3 else 0.5
                weight = 2.0 if 0 < stage < 3 else 1.0
                for i in range(size):
                    at[i] = x[i] if stage == 0 else x[i] + ahead * h * rate[i]
                    for j in range(width):
                        along[i, j] = dx[i, j] if stage == 0 else dx[i, j] + ahead * h * drate[i, j]
                tangent_slope(at, given, along, dgiven, own, which, d, stencil, rate, drate)
                for i in range(size):
                    total[i] = rate[i] if stage == 0 else total[i] + weight * rate[i]
                    for j in range(width):
                        dtotal[i, j] = drate[i, j] if stage == 0 else dtotal[i, j] + weight * drate[i, j]
            for i in range(size):
                x[i] += h / 6.0 * total[i]
                for j in range(width):
                    dx[i, j] += h / 6.0 * dtotal[i, j]
    return result
