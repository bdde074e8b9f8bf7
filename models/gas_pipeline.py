"""The plant `gas-pipeline`: 150 km of high-pressure natural gas under transient flow (Shaheen 2024, sec. II and IV).

State [p_0 .. p_{n-1}, m_0 .., T_0 ..] at n equally spaced nodes, a sensor for each. The pressure and temperature at the
inlet and the mass flow at the outlet are given: as inputs, between whose sampling times they run linearly.

What the paper misprints or leaves out, and what stands here instead:
- (6), A_21: see gas_pipeline_equations. theta = pi is a horizontal pipe, as here. "log" in Colebrook-White is log10 and
  f the Darcy factor; R is the specific gas constant. D in (8) needs one block for each of p, m, T, and boundary rows.
- Boundary rows by plain one-sided differences are unstable on finer grids (41 nodes do, 81 nodes do not settle):
  characteristic conditions stand instead.
- Fits, composition and viscosity of the gas are not given: natural_gas.py, and mu below. Neither is the demand f(t) in
  numbers: smooth ramps of the range of Fig. 4 stand in `demand`.
- Table III gives noise in MPa, kg/s, K. "Standard deviation of the process noise 10 % lower than that of the measurement
  noise" can be read as 0.9 sigma or as 0.1 sigma (a misprint of "10 % of"); both are named, "tenth" is the default
  because its errors are nearer to the published ones. P = I in the paper's units is named "identity".
- N_s = L / ds = 20, but there are 21 nodes.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fusion_sfdia.models import gas_pipeline_equations as equations
from fusion_sfdia.models.gas_pipeline_equations import PipelineParameters
from fusion_sfdia.models.natural_gas import PRESSURES, TEMPERATURES, natural_gas
from fusion_sfdia.plant import Block, Physics, Plant, Sensor, Signal

Array = NDArray[Any]

INLET_PRESSURE = 8.4e6  # Pa, Shaheen 2024, sec. IV-A
INLET_TEMPERATURE = 303.15  # K, the same
FLOW = (1.0, 2000.0)  # kg/s, ours: turbulent, and from inlet to outlet
SIGMA = {  # Pa, kg/s, K: Shaheen 2024, Table III
    "high": (50.0, 0.25, 0.15),
    "moderate": (500.0, 2.5, 1.5),
    "low": (1000.0, 10.0, 6.0),
}
PROCESS_NOISE = {"tenth": 0.1, "nine-tenths": 0.9}  # of the sensors' sigma, see above
IDENTITY = (1e6, 1.0, 1.0)  # Pa, kg/s, K: one of each of the paper's units
STENCIL = np.array(  # times 12 ds: Shaheen 2024, below (8)
    [[-25.0, 48, -36, 16, -3], [-3, -10, 18, -6, 1], [1, -8, 0, 8, -1], [-1, 6, -18, 10, 3], [3, -16, 36, -48, 25]]
)
QUANTITIES = ("pressure", "mass flow", "temperature")


def pipeline_parameters(**changes: Any) -> PipelineParameters:
    """The paper's pipe (Shaheen 2024, Table II) with our viscosity and gas; changes replace single values (SI)."""
    gas = natural_gas()
    values: dict[str, Any] = {
        "length": 150e3,
        "diameter": 1.4,
        "roughness": 0.016e-3,
        "ambient": 278.15,
        "heat_transfer": 2.84,
        "viscosity": 1.25e-5,  # ours
        "gas_constant": gas.gas_constant,
        "z": gas.z,
        "cp0": gas.cp0,
    }
    unknown = sorted(set(changes) - set(values))
    if unknown:
        raise ValueError(f"unknown pipeline parameters {', '.join(unknown)}; known: {', '.join(values)}")
    for name, value in changes.items():
        if np.ndim(value) == 0 and not (np.isfinite(value) and value > 0):
            raise ValueError(f"pipeline parameter {name} is {value}; it must be positive and finite (SI)")
    return PipelineParameters(**(values | changes))


def demand(t: float) -> float:
    """Mass flow asked for at the outlet, kg/s: 300 to 450 in 600 s, back to 350 between 1800 and 2700 s, cosine ramps. Ours."""

    def ramp(start: float, stop: float) -> float:
        return 0.5 * (1.0 - float(np.cos(np.pi * np.clip((t - start) / (stop - start), 0.0, 1.0))))

    return 300.0 + 150.0 * ramp(0.0, 600.0) - 100.0 * ramp(1800.0, 2700.0)


def operation(t: float) -> Array:
    """Input (p_inlet, T_inlet, m_outlet) that the boundary has reached at t + 10 s, the end of the paper's step from t."""
    return np.array([INLET_PRESSURE, INLET_TEMPERATURE, demand(t)])


def steady_state(nodes: int, flow: float, parameters: PipelineParameters) -> Array:
    """State (3 nodes,) at constant mass flow (kg/s): momentum and energy along the pipe, integrated to 1e-12.

    A p_s + m v_s = -w and v (T_s - kappa p_s) = what heats, with v_s as in gas_pipeline_equations at m_s = 0. Raises
    ArithmeticError where the pressure falls out of the gas model before the outlet.
    """
    c = parameters
    area = np.pi / 4 * c.diameter**2

    def along(s: float, y: Array) -> Array:
        p, T = y
        p_t, m_t, T_t, v, _, rho, _, alpha_1, alpha_2, cp = equations.rates(p, flow, T, 0.0, 0.0, 0.0, c)
        kappa = alpha_1 / (rho * cp)
        matrix = np.array([[area - flow * v * alpha_2 / p, flow * v * alpha_1 / T], [-kappa * v, v]])
        solution: Array = np.linalg.solve(matrix, np.array([m_t, T_t - kappa * p_t]))
        return solution

    def leaves(s: float, y: Array) -> float:
        return float(y[0] - PRESSURES[0])

    leaves.terminal = True  # type: ignore[attr-defined]
    where = np.linspace(0.0, c.length, nodes)
    start = np.array([INLET_PRESSURE, INLET_TEMPERATURE])
    found = solve_ivp(along, (0.0, c.length), start, "DOP853", t_eval=where, rtol=1e-12, atol=1e-9, events=leaves)
    if found.y.shape[1] != nodes:
        raise ArithmeticError(
            f"no steady state at {flow:g} kg/s: the pressure falls below {PRESSURES[0]:g} Pa before the outlet; "
            "lower the flow or shorten the pipe"
        )
    return np.concatenate([found.y[0], np.full(nodes, flow), found.y[1]])


def largest_step(nodes: int, parameters: PipelineParameters, x: Array) -> float:
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


def pipeline_physics(nodes: int, parameters: PipelineParameters) -> Physics:
    """The semi-discrete equations on arrays (..., 3 nodes); inputs are the rates at which the boundary values change.

    The same scalar equations as the compiled drivers: what tests hold against each other.
    """
    first = np.clip(np.arange(nodes) - 2, 0, nodes - 5)
    derivative = np.zeros((nodes, nodes))
    for i in range(nodes):
        derivative[i, first[i] : first[i] + 5] = STENCIL[i - first[i]] / (12 * parameters.length / (nodes - 1))

    def f(t: float, x: Array, z: Array, u: Array, c: PipelineParameters) -> Array:
        p, m, T = (x[..., v * nodes : (v + 1) * nodes] for v in range(3))
        local = (p, m, T, p @ derivative.T, m @ derivative.T, T @ derivative.T)
        inner = equations.rates(*local, c)[:3]
        inlet = equations.inlet_rates(*[a[..., 0] for a in local], u[..., 0], u[..., 1], c)  # type: ignore[arg-type, call-arg]
        outlet = equations.outlet_rates(*[a[..., -1] for a in local], u[..., 2], c)  # type: ignore[arg-type, call-arg]
        edge = p.shape[:-1]
        parts = [
            np.concatenate([np.broadcast_to(a, edge)[..., None], r[..., 1:-1], np.broadcast_to(b, edge)[..., None]], axis=-1)
            for a, r, b in zip(inlet, inner, outlet, strict=True)
        ]
        return np.concatenate(parts, axis=-1)

    x = steady_state(nodes, 300.0, parameters)
    return Physics(
        name="gas-pipeline",
        states=signals(nodes, x),
        inputs=(Signal("p_inlet_rate", "Pa/s"), Signal("T_inlet_rate", "K/s"), Signal("m_outlet_rate", "kg/s2")),
        f=f,
        parameters=parameters,
    )


def gas_pipeline(
    *,
    nodes: int = 21,
    dt: float = 10.0,
    substeps: int | None = None,
    stations: int | None = None,
    snr: str = "moderate",
    process_noise: str = "tenth",
    initial: str = "noise",
    parameters: PipelineParameters | None = None,
) -> Plant:
    """Return the pipeline as a plant.

    nodes: of the grid, at least 7. dt: seconds between readings. substeps: of RK4 in dt; None for the fewest that (9)
    allows; too few are a ValueError that names the limit. stations: places with sensors, at every k-th node (None: all),
    named as on the coarse grid. snr: "high", "moderate", "low" (Table III). process_noise: "tenth" or "nine-tenths" of
    sigma. initial: "noise" for P0 = R, "identity" for one squared unit of the paper (MPa, kg/s, K).
    """
    c = parameters or pipeline_parameters()
    for what, value, known in (
        ("snr", snr, SIGMA), ("process_noise", process_noise, PROCESS_NOISE), ("initial", initial, ("noise", "identity")),
    ):  # fmt: skip
        if value not in known:
            raise ValueError(f"{what} is {value!r}; known: {', '.join(known)}")
    stations = stations or nodes
    if nodes < 7 or stations < 2 or (nodes - 1) % (stations - 1):
        raise ValueError(f"{nodes} nodes with {stations} stations; wanted at least 7 nodes and stations at every k-th of them")
    x0 = steady_state(nodes, demand(0.0), c)
    limit = largest_step(nodes, c, x0)
    needed = int(np.ceil(dt / limit - 1e-9))
    if substeps is None:
        substeps = max(needed, 1)
    if substeps < needed:
        raise ValueError(
            f"dt = {dt:g} s in {substeps} substeps with {nodes} nodes breaks the CFL condition: the largest admissible step "
            f"is {limit:.4g} s; use substeps={needed}, a smaller dt or fewer nodes"
        )
    count = substeps
    stencil = STENCIL / (12 * c.length / (nodes - 1))
    every = (nodes - 1) // (stations - 1)
    picks = (np.arange(3)[:, None] * nodes + np.arange(stations) * every).ravel()
    states = signals(nodes, x0)
    sigma = np.array(SIGMA[snr])

    def advance(function: Any, x: Array, u: Array, dt: float) -> Array:
        kind = np.result_type(x, u, float)
        batch = np.broadcast_shapes(x.shape[:-1], u.shape[:-1])
        flat = np.ascontiguousarray(np.broadcast_to(x, (*batch, 3 * nodes)), dtype=kind).reshape(-1, 3 * nodes)
        inputs = np.ascontiguousarray(np.broadcast_to(u, (*batch, 3)), dtype=kind).reshape(-1, 3)
        result: Array = function(flat, inputs, float(dt), count, c, stencil)
        return result.reshape(*batch, *result.shape[1:])

    @cache
    def readout() -> Array:
        selection = np.zeros((picks.size, 3 * nodes))
        selection[np.arange(picks.size), picks] = 1.0
        return selection

    return Plant(
        name="gas-pipeline",
        states=states,
        inputs=(
            Signal("p_inlet", "Pa", INLET_PRESSURE, *PRESSURES),
            Signal("T_inlet", "K", INLET_TEMPERATURE, *TEMPERATURES),
            Signal("m_outlet", "kg/s", demand(0.0), *FLOW),
        ),
        sensors=tuple(
            Sensor(f"{letter}_{i}", f"{letter}_{i * every}", unit, sigma=float(sigma[v]), owner="pipe", quantity=QUANTITIES[v])
            for v, (letter, unit) in enumerate((("p", "Pa"), ("m", "kg/s"), ("T", "K")))
            for i in range(stations)
        ),
        step=lambda t, x, u, dt: advance(equations.advance, x, u, dt),
        output=lambda t, x, u: x[..., picks],
        step_jacobian=lambda t, x, u, dt: advance(equations.advance_tangent, x, u, dt),
        output_jacobian=lambda t, x, u: readout(),
        dt=dt,
        max_dt=limit * count,
        x0=x0,
        initial_cov=np.repeat((sigma if initial == "noise" else np.array(IDENTITY)) ** 2, nodes),
        process_cov=np.repeat((PROCESS_NOISE[process_noise] * sigma) ** 2, nodes),
        operation=operation,
        blocks=(Block("pipe", tuple(s.name for s in states)),),
    )


def coarse_state(x: Array, nodes: int, stations: int) -> Array:
    """The state (..., 3 stations) of a fine state (..., 3 nodes) at the stations."""
    every = (nodes - 1) // (stations - 1)
    fine = x.reshape(*x.shape[:-1], 3, nodes)
    return fine[..., ::every].reshape(*x.shape[:-1], 3 * stations)
