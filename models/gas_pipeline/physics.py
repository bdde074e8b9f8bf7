"""Pipe and flow of the plant `gas-pipeline`: parameters, steady state, largest step, semi-discrete equations on arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fusion_sfdia.models.gas_pipeline import equations
from fusion_sfdia.models.gas_pipeline.equations import PipelineParameters
from fusion_sfdia.models.gas_pipeline.natural_gas import PRESSURES, TEMPERATURES, natural_gas
from fusion_sfdia.plant.physics import Physics
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

INLET_PRESSURE = 8.4e6  # Pa, Shaheen 2024, sec. IV-A
INLET_TEMPERATURE = 303.15  # K, the same
FLOW = (1.0, 2000.0)  # kg/s, our choice: turbulent, and from inlet to outlet
STENCIL = np.array(  # times 12 ds: Shaheen 2024, below (8)
    [[-25.0, 48, -36, 16, -3], [-3, -10, 18, -6, 1], [1, -8, 0, 8, -1], [-1, 6, -18, 10, 3], [3, -16, 36, -48, 25]]
)


def pipeline_parameters(**changes: Any) -> PipelineParameters:
    """The paper's pipe (Shaheen 2024, Table II) with our viscosity and gas; `changes` replaces single values (SI).

    friction: a Darcy friction factor (four times Fanning's) that replaces the one computed from the roughness.
    """
    gas = natural_gas()
    values: dict[str, Any] = {
        "length": 150e3,
        "diameter": 1.4,
        "roughness": 0.016e-3,
        "ambient": 278.15,
        "heat_transfer": 2.84,
        "viscosity": 1.25e-5,  # our choice
        "gas_constant": gas.gas_constant,
        "z": gas.z,
        "cp0": gas.cp0,
        "friction": 0.0,  # from the roughness
    }
    unknown = sorted(set(changes) - set(values))
    if unknown:
        raise ValueError(f"unknown pipeline parameters {', '.join(unknown)}; known: {', '.join(values)}")
    return require_parameters(PipelineParameters(**(values | changes)))


def require_parameters(c: PipelineParameters) -> PipelineParameters:
    """Return c, or raise ValueError for values that no pipe has; 0 is valid for a smooth or an insulated pipe.

    A friction factor of 1 or more is refused as a mistake: Colebrook and White give at most 0.1.
    """
    for name, value in c._asdict().items():
        least = 0.0 if name in {"roughness", "heat_transfer", "friction"} else np.finfo(float).tiny
        if np.ndim(value) == 0 and not (np.isfinite(value) and value >= least):
            raise ValueError(f"pipeline parameter {name} is {value}; it must be positive and finite (SI)")
    if c.friction >= 1:
        raise ValueError(f"pipeline parameter friction is {c.friction}; expected a Darcy factor below 1, such as 0.01, or 0")
    shape = (equations.POWERS_OF_PRESSURE, equations.POWERS_OF_TAU + 1)
    if np.shape(c.z) != shape or np.shape(c.cp0) != (3,):
        raise ValueError(f"gas coefficients z {np.shape(c.z)}, cp0 {np.shape(c.cp0)}; expected {shape} and (3,), see `gas`")
    return c


def steady_state(
    nodes: int,
    flow: float,
    parameters: PipelineParameters,
    pressure: float = INLET_PRESSURE,
    temperature: float = INLET_TEMPERATURE,
) -> Array:
    """State (3 nodes,) at constant mass flow (kg/s) from the inlet's Pa and K: integrated along the pipe to 1e-12.

    A p_s + m v_s = -w and v (T_s - kappa p_s) = the heating term, with v_s as in `equations` at m_s = 0. Raises
    ArithmeticError where the pressure leaves the gas model before the outlet, or the flow reaches the speed of sound.
    """
    c = parameters
    area = np.pi / 4 * c.diameter**2

    def along(s: float, y: Array) -> Array:
        p, T = y
        p_t, m_t, T_t, v, rho, _, alpha_1, alpha_2, cp = equations.rates(
            p, flow, T, 0.0, 0.0, 0.0, equations.friction_factor(flow, c), c
        )
        kappa = alpha_1 / (rho * cp)
        matrix = np.array([[area - flow * v * alpha_2 / p, flow * v * alpha_1 / T], [-kappa * v, v]])
        solution: Array = np.linalg.solve(matrix, np.array([m_t, T_t - kappa * p_t]))
        return solution

    def leaves(s: float, y: Array) -> float:
        return float(y[0] - PRESSURES[0])

    def chokes(s: float, y: Array) -> float:
        _, _, _, v, _, a2, *_ = equations.rates(y[0], flow, y[1], 0.0, 0.0, 0.0, equations.friction_factor(flow, c), c)
        return float(np.sqrt(a2) - v)

    leaves.terminal = chokes.terminal = True  # type: ignore[attr-defined]
    where = np.linspace(0.0, c.length, nodes)
    start = np.array([pressure, temperature])
    if not chokes(0.0, start) > 0:
        raise ArithmeticError(f"no steady state at {flow:g} kg/s: it enters at the speed of sound; lower the flow")
    found = solve_ivp(along, (0.0, c.length), start, "DOP853", t_eval=where, rtol=1e-12, atol=1e-9, events=(leaves, chokes))
    if found.y.shape[1] != nodes:
        raise ArithmeticError(
            f"no steady state at {flow:g} kg/s: the pressure falls below {PRESSURES[0]:g} Pa, or the flow chokes, before the "
            "outlet; lower the flow or shorten the pipe"
        )
    return np.concatenate([found.y[0], np.full(nodes, flow), found.y[1]])


def initial_state(nodes: int, flow: float, parameters: PipelineParameters) -> Array:
    """The steady state (3 nodes,) at that flow (kg/s); ValueError with the largest possible flow."""
    if not FLOW[0] <= flow <= FLOW[1]:
        raise ValueError(f"a flow of {flow:g} kg/s; the model holds from {FLOW[0]:g} to {FLOW[1]:g} kg/s")
    if (found := _carried(nodes, flow, parameters)) is not None:
        return found
    low, high = FLOW[0], flow
    if _carried(nodes, low, parameters) is None:
        most = f"not even {low:g} kg/s; shorten or widen the pipe"
    else:
        while high - low > 1e-3 * low:
            middle = float(np.sqrt(low * high))
            carries = _carried(nodes, middle, parameters) is not None
            low, high = (middle, high) if carries else (low, middle)
        most = f"at most {low:.4g} kg/s; give a smaller outlet_flow, or shorten or widen the pipe"
    raise ValueError(
        f"no steady state at {flow:g} kg/s in a pipe of {parameters.length:g} m and {parameters.diameter:g} m across from "
        f"{INLET_PRESSURE:g} Pa: its pressure or temperature leaves the gas model before the outlet. It carries {most}"
    )


def _carried(nodes: int, flow: float, parameters: PipelineParameters) -> Array | None:
    """The steady state; None where none exists within the limits of the gas model."""
    try:
        with np.errstate(all="ignore"):
            x = steady_state(nodes, float(flow), parameters)
    except (ArithmeticError, ValueError):  # the pressure leaves the gas model, or the flow reaches the speed of sound
        return None
    p, T = x[:nodes], x[2 * nodes :]
    inside = np.all((p >= PRESSURES[0]) & (p <= PRESSURES[1]) & (T >= TEMPERATURES[0]) & (T <= TEMPERATURES[1]))
    return x if inside else None


def courant_step(nodes: int, parameters: PipelineParameters, x: Array) -> float:
    """Largest step (s) by Courant, Friedrichs and Lewy (9).

    At the fastest sound in the gas model's box and twice the largest velocity of x, so that it holds all along a transient.
    """
    c = parameters
    p, T = np.meshgrid(np.linspace(*PRESSURES, 31), np.linspace(*TEMPERATURES, 31))
    z, alpha_1, alpha_2, cp = equations.gas(p, T, c)
    sound = np.sqrt(equations.wave_speed_squared(p, p / (z * c.gas_constant * T), T, alpha_1, alpha_2, cp)).max()
    z, *_ = equations.gas(x[:nodes], x[2 * nodes :], c)
    velocity = x[nodes : 2 * nodes] * z * c.gas_constant * x[2 * nodes :] / (np.pi / 4 * c.diameter**2 * x[:nodes])
    return float(c.length / (nodes - 1) / (sound + 2 * velocity.max()))


def signals(nodes: int, x: Array) -> tuple[Signal, ...]:
    """The states' names, units, nominal values and limits: those of the gas model, and of flow from inlet to outlet."""
    limits = (PRESSURES, FLOW, TEMPERATURES)
    return tuple(
        Signal(f"{letter}_{i}", unit, float(x[v * nodes + i]), *limits[v])
        for v, (letter, unit) in enumerate((("p", "Pa"), ("m", "kg/s"), ("T", "K")))
        for i in range(nodes)
    )


def pipeline_physics(nodes: int, parameters: PipelineParameters, flow: float = 300.0) -> Physics:
    """The semi-discrete equations on arrays (..., 3 nodes), nominally at rest at that flow (kg/s).

    Inputs are the rates at which the boundary values change.

    These are the scalar equations of the compiled drivers; tests compare both.
    """
    first = np.clip(np.arange(nodes) - 2, 0, nodes - 5)
    derivative = np.zeros((nodes, nodes))
    for i in range(nodes):
        derivative[i, first[i] : first[i] + 5] = STENCIL[i - first[i]] / (12 * parameters.length / (nodes - 1))

    def f(t: float, x: Array, z: Array, u: Array, c: PipelineParameters) -> Array:
        p, m, T = (x[..., v * nodes : (v + 1) * nodes] for v in range(3))
        local = (p, m, T, p @ derivative.T, m @ derivative.T, T @ derivative.T, equations.friction_factor(m, c))
        inner = equations.rates(*local, c)
        first, last = (tuple(a[..., end] for a in inner) for end in (0, -1))
        inlet = equations.inlet_rates(p[..., 0], T[..., 0], first, u[..., 0], u[..., 1], c)
        outlet = equations.outlet_rates(p[..., -1], T[..., -1], last, u[..., 2], c)
        edge = p.shape[:-1]
        parts = [
            np.concatenate([np.broadcast_to(a, edge)[..., None], r[..., 1:-1], np.broadcast_to(b, edge)[..., None]], axis=-1)
            for a, r, b in zip(inlet, inner[:3], outlet, strict=True)
        ]
        return np.concatenate(parts, axis=-1)

    x = initial_state(nodes, flow, parameters)
    return Physics(
        name="gas-pipeline",
        states=signals(nodes, x),
        inputs=(Signal("p_inlet_rate", "Pa/s"), Signal("T_inlet_rate", "K/s"), Signal("m_outlet_rate", "kg/s2")),
        f=f,
        parameters=parameters,
    )
