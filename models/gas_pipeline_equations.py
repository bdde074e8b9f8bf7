"""Transient flow of a real gas in a pipe: scalar equations and the compiled drivers that join them.

Shaheen 2024, sec. II, in the physical form behind (5): with velocity v = m z R T / (A p) and its gradient

    v_s = (z R T / (A p)) m_s + v (alpha_1 T_s / T - alpha_2 p_s / p)

mass, momentum and energy (1)-(3) with the identity (4) read

    p_t = -v p_s - rho a^2 v_s + a^2 alpha_1 (q + w v) / (C_p T A)
    m_t = -v m_s - m v_s - A p_s - w
    T_t = -v T_s - (a^2 alpha_1 / C_p) v_s + a^2 alpha_2 (q + w v) / (C_p p A)

Collected in p_s, m_s, T_s this is the matrix (6) but for its entry A_21, which as printed lacks the pressure gradient and
squares the wrong alpha: it must be A - m^2 alpha_2 R T z / (A p^2). Then the eigenvalues are v, v + a, v - a.

The boundary node follows what leaves the pipe: with r the rates that the one-sided differences give, the inlet (p, T
prescribed) keeps p_t - rho a v_t of the wave that runs out against the flow, the outlet (m prescribed) keeps
p_t + rho a v_t and T_t - (alpha_1 / (rho C_p)) p_t of those that run out with it.

The pipe is horizontal. Everything holds, and is analytic, for turbulent flow from inlet to outlet (m > 0), where
v |v| = v^2; so it takes complex numbers as well. For m <= 0 the logarithm of Colebrook and White has no real value: the
rates are NaN, never plausible numbers. Limits on the mass flow keep simulations and filters away from there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.equation import compiled, equation
from fusion_sfdia.models.natural_gas import Gas

Array = NDArray[Any]

PRESSURE_SCALE = 1e7  # Pa, and
TEMPERATURE_SCALE = 300.0  # K: those of the gas polynomials, of powers
POWERS_OF_PRESSURE = 6  # 1 to 6 and
POWERS_OF_TAU = 6  # 0 to 6
LN10 = float(np.log(10.0))


class PipelineParameters(NamedTuple):
    """What the equations need to know of pipe, surroundings and gas, in SI."""

    length: float  # m
    diameter: float  # m
    roughness: float  # m
    ambient: float  # K
    heat_transfer: float  # W/(m2 K)
    viscosity: float  # Pa s
    gas_constant: float  # J/(kg K), specific
    z: Array  # (6, 7): z = 1 + sum z[i-1, j] (p / 1e7 Pa)^i (300 K / T - 1)^j
    cp0: Array  # (3,) J/(kg K): ideal-gas heat capacity = sum cp0[k] (T / 300 K - 1)^k


@equation
def gas(p: Any, T: Any, c: PipelineParameters | Gas) -> tuple[Any, Any, Any, Any]:
    """z, alpha_1 = 1 + (T/z) z_T, alpha_2 = 1 - (p/z) z_p, C_p in J/(kg K), of one equation of state.

    C_p = C_p0(T) - T int_0^p v_TT dp with v = z R T / p, which for tau = 300 K / T is
    C_p0 - R sum_i z_i''(tau) tau^2 x^i / i: heat capacity and compressibility cannot contradict each other.
    """
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
    warmth = T / TEMPERATURE_SCALE - 1.0
    cp = c.cp0[0] + warmth * (c.cp0[1] + warmth * c.cp0[2]) - c.gas_constant * tau * tau * curvature
    return z, 1.0 - tau * z_tau / z, 1.0 - p_z_p / z, cp


@equation
def wave_speed_squared(p: Any, rho: Any, T: Any, alpha_1: Any, alpha_2: Any, cp: Any) -> Any:
    """a_s^2 = (d p / d rho)_s, m2/s2 (Shaheen 2024, below (5))."""
    return p / (rho * (alpha_2 - p / (rho * cp * T) * alpha_1 * alpha_1))


@equation
def friction_factor(m: Any, c: PipelineParameters) -> Any:
    """Darcy f of Colebrook and White, 1/sqrt f = -2 log10(eps/(3.7 d) + 2.51/(Re sqrt f)), Re = 4 m / (pi d mu).

    Three Newton steps in 1/sqrt f from 10 (f = 0.01): exact to 1e-12 from 10 kg/s in the paper's pipe, to 1e-10 at 1 kg/s;
    cheaper than an explicit formula and two steps.
    """
    reynolds = 4.0 * m / (np.pi * c.diameter * c.viscosity)
    rough = c.roughness / (3.7 * c.diameter)
    b = 2.51 / reynolds
    root = 10.0 + 0.0 * reynolds
    for _ in range(3):
        inside = rough + b * root
        root = root - (root + 2.0 / LN10 * np.log(inside)) / (1.0 + 2.0 / LN10 * b / inside)
    return 1.0 / (root * root)


@equation
def rates(p: Any, m: Any, T: Any, p_s: Any, m_s: Any, T_s: Any, c: PipelineParameters) -> tuple[Any, ...]:
    """p_t (Pa/s), m_t (kg/s2), T_t (K/s), and v, v_t, rho, a, alpha_1, alpha_2, C_p for the boundaries."""
    z, alpha_1, alpha_2, cp = gas(p, T, c)
    area = 0.25 * np.pi * c.diameter * c.diameter
    rho = p / (z * c.gas_constant * T)
    v = m / (rho * area)
    a2 = wave_speed_squared(p, rho, T, alpha_1, alpha_2, cp)
    w = 0.125 * friction_factor(m, c) * rho * v * v * np.pi * c.diameter
    q = -np.pi * c.diameter * c.heat_transfer * (T - c.ambient)
    v_s = m_s / (rho * area) + v * (alpha_1 * T_s / T - alpha_2 * p_s / p)
    source = a2 * (q + w * v) / (cp * area)
    p_t = -v * p_s - rho * a2 * v_s + alpha_1 * source / T
    m_t = -v * m_s - m * v_s - area * p_s - w
    T_t = -v * T_s - a2 * alpha_1 / cp * v_s + alpha_2 * source / p
    v_t = m_t / (rho * area) + v * (alpha_1 * T_t / T - alpha_2 * p_t / p)
    return p_t, m_t, T_t, v, v_t, rho, np.sqrt(a2), alpha_1, alpha_2, cp


@equation
def inlet_rates(
    p: Any, m: Any, T: Any, p_s: Any, m_s: Any, T_s: Any, p_given: Any, T_given: Any, c: PipelineParameters
) -> tuple[Any, Any, Any]:
    """Rates at the inlet, where p_t and T_t are given; m_t from the wave v - a."""
    p_t, _, _, v, v_t, rho, a, alpha_1, alpha_2, _ = rates(p, m, T, p_s, m_s, T_s, c)
    v_t = v_t + (p_given - p_t) / (rho * a)
    area = 0.25 * np.pi * c.diameter * c.diameter
    return p_given, rho * area * (v_t - v * (alpha_1 * T_given / T - alpha_2 * p_given / p)), T_given


@equation
def outlet_rates(
    p: Any, m: Any, T: Any, p_s: Any, m_s: Any, T_s: Any, m_given: Any, c: PipelineParameters
) -> tuple[Any, Any, Any]:
    """Rates at the outlet, where m_t is given; p_t and T_t from the waves v + a and v."""
    p_t, _, T_t, v, v_t, rho, a, alpha_1, alpha_2, cp = rates(p, m, T, p_s, m_s, T_s, c)
    area = 0.25 * np.pi * c.diameter * c.diameter
    kappa = alpha_1 / (rho * cp)
    entropy = T_t - kappa * p_t
    per_p = v * (alpha_1 * kappa / T - alpha_2 / p)
    p_out = (p_t + rho * a * (v_t - m_given / (rho * area) - v * alpha_1 * entropy / T)) / (1.0 + rho * a * per_p)
    return p_out, m_given, entropy + kappa * p_out


@compiled
def slope(x: Any, given: Any, c: PipelineParameters, stencil: Array, out: Any) -> None:
    """Write to out dx/dt of one state x (3n,) = [p, m, T], with the rates given at the boundaries (p_in, T_in, m_out)."""
    n = x.shape[0] // 3
    for i in range(n):
        first = min(max(i - 2, 0), n - 5)
        row = i if i < 2 else (2 if i < n - 2 else i - n + 5)
        p_s, m_s, T_s = 0.0 * x[0], 0.0 * x[0], 0.0 * x[0]
        for k in range(5):
            d = stencil[row, k]
            p_s += d * x[first + k]
            m_s += d * x[n + first + k]
            T_s += d * x[2 * n + first + k]
        p, m, T = x[i], x[n + i], x[2 * n + i]
        if i == 0:
            p_t, m_t, T_t = inlet_rates(p, m, T, p_s, m_s, T_s, given[0], given[1], c)
        elif i == n - 1:
            p_t, m_t, T_t = outlet_rates(p, m, T, p_s, m_s, T_s, given[2], c)
        else:
            p_t, m_t, T_t, _, _, _, _, _, _, _ = rates(p, m, T, p_s, m_s, T_s, c)
        out[i], out[n + i], out[2 * n + i] = p_t, m_t, T_t


@compiled
def advance(states: Any, inputs: Any, dt: float, substeps: int, c: PipelineParameters, stencil: Array) -> Array:
    """RK4 for a batch of states (B, 3n), inputs (B, 3) = (p_in, T_in, m_out) that the boundary reaches at the end of dt."""
    size = states.shape[1]
    n = size // 3
    result: Array = states.copy()
    given = np.empty(3, states.dtype)
    k1, k2 = np.empty(size, states.dtype), np.empty(size, states.dtype)
    k3, k4 = np.empty(size, states.dtype), np.empty(size, states.dtype)
    h = dt / substeps
    for b in range(states.shape[0]):
        x = result[b]
        given[0] = (inputs[b, 0] - x[0]) / dt
        given[1] = (inputs[b, 1] - x[2 * n]) / dt
        given[2] = (inputs[b, 2] - x[2 * n - 1]) / dt
        for _ in range(substeps):
            slope(x, given, c, stencil, k1)
            slope(x + 0.5 * h * k1, given, c, stencil, k2)
            slope(x + 0.5 * h * k2, given, c, stencil, k3)
            slope(x + h * k3, given, c, stencil, k4)
            for j in range(size):
                x[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
    return result


@compiled
def tangent_slope(x: Any, given: Any, dx: Any, dgiven: Any, c: PipelineParameters, stencil: Array, k: Any, dk: Any) -> None:
    """Write to k dx/dt (3n,) as `slope`, and to dk (3n, M) its derivative along the columns of dx (3n, M), dgiven (3, M).

    Each node depends on its own p, m, T and their gradients: nine complex steps at most give its small Jacobian, which is
    exact to rounding; the stencil does the rest.
    """
    n = x.shape[0] // 3
    columns = dx.shape[1]
    tiny = 1e-30
    local = np.empty(9, np.complex128)
    gradient = np.empty((3, columns))
    for i in range(n):
        first = min(max(i - 2, 0), n - 5)
        row = i if i < 2 else (2 if i < n - 2 else i - n + 5)
        gradient[:] = 0.0
        for v in range(3):
            local[v] = x[v * n + i]
            s = 0.0
            for near in range(5):
                d = stencil[row, near]
                s += d * x[v * n + first + near]
                for j in range(columns):
                    gradient[v, j] += d * dx[v * n + first + near, j]
            local[3 + v] = s
            local[6 + v] = given[v]
            dk[v * n + i] = 0.0
        last = 9 if i == 0 or i == n - 1 else 6
        for a in range(last):
            local[a] += 1j * tiny
            if i == 0:
                r0, r1, r2 = inlet_rates(local[0], local[1], local[2], local[3], local[4], local[5], local[6], local[7], c)
            elif i == n - 1:
                r0, r1, r2 = outlet_rates(local[0], local[1], local[2], local[3], local[4], local[5], local[8], c)
            else:
                r0, r1, r2, _, _, _, _, _, _, _ = rates(local[0], local[1], local[2], local[3], local[4], local[5], c)
            local[a] = local[a].real
            if a == 0:
                k[i], k[n + i], k[2 * n + i] = r0.real, r1.real, r2.real
            j0, j1, j2 = r0.imag / tiny, r1.imag / tiny, r2.imag / tiny
            for j in range(columns):
                along = dx[a * n + i, j] if a < 3 else (gradient[a - 3, j] if a < 6 else dgiven[a - 6, j])
                dk[i, j] += j0 * along
                dk[n + i, j] += j1 * along
                dk[2 * n + i, j] += j2 * along


@compiled
def advance_tangent(states: Any, inputs: Any, dt: float, substeps: int, c: PipelineParameters, stencil: Array) -> Array:
    """Jacobians (B, 3n, 3n) of `advance` with respect to the states, by the chain rule through its stages."""
    size = states.shape[1]
    n = size // 3
    result = np.empty((states.shape[0], size, size))
    given = np.empty(3)
    ks, dks = np.empty((4, size)), np.empty((4, size, size))
    weights = np.array([0.0, 0.5, 0.5, 1.0])
    h = dt / substeps
    for b in range(states.shape[0]):
        x = states[b].copy()
        given[0] = (inputs[b, 0] - x[0]) / dt
        given[1] = (inputs[b, 1] - x[2 * n]) / dt
        given[2] = (inputs[b, 2] - x[2 * n - 1]) / dt
        dx = np.eye(size)
        dgiven = np.zeros((3, size))
        dgiven[0, 0] = dgiven[1, 2 * n] = dgiven[2, 2 * n - 1] = -1.0 / dt
        for _ in range(substeps):
            for s in range(4):
                if s == 0:
                    tangent_slope(x, given, dx, dgiven, c, stencil, ks[0], dks[0])
                else:
                    g = weights[s] * h
                    tangent_slope(x + g * ks[s - 1], given, dx + g * dks[s - 1], dgiven, c, stencil, ks[s], dks[s])
            x = x + h / 6.0 * (ks[0] + 2.0 * ks[1] + 2.0 * ks[2] + ks[3])
            dx = dx + h / 6.0 * (dks[0] + 2.0 * dks[1] + 2.0 * dks[2] + dks[3])
        result[b] = dx
    return result
