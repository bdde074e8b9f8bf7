"""The plant `gas-pipeline`: 150 km of high-pressure natural gas under transient flow (Shaheen 2024, sec. II and IV).

State [p_0 .. p_{n-1}, m_0 .., T_0 ..] at n equally spaced nodes, with a sensor for each. The pressure and temperature at the
inlet and the mass flow at the outlet are inputs: their values at the end of a step, which they approach linearly within the
step. A high-fidelity model on a finer grid therefore takes the same dt in more substeps, not a smaller dt with a held input:
gas_pipeline(nodes=81, stations=21) has the sensors of gas_pipeline(), and `coarse_state` picks its 63 states.

Misprints and omissions of the paper, and the corrections used here:
- (6), A_21: see equations.py. theta = pi is a horizontal pipe, as here. "log" in Colebrook-White is log10 and f the Darcy
  factor; R is the specific gas constant. D in (8) needs one block for each of p, m, T, and boundary rows.
- Boundary rows by one-sided differences are stable with 41 nodes and unstable with 81 (an eigenvalue of +0.007/s):
  characteristic conditions are used instead.
- The fits, composition and viscosity of the gas are not given: see natural_gas.py, and 1.25e-5 Pa s. The demand f(t) is not
  given in numbers either: `demand` is our choice, with ramps slow enough (300 s and more) not to ring on 21 nodes.
- Table III gives noise in MPa, kg/s, K. "Standard deviation of the process noise 10 % lower than that of the measurement
  noise" is 0.9 sigma as printed, 0.1 sigma if "10 % of" is meant; both have a name. In the scenarios the paper's filters have
  the first, compared with the second, which is nearer to most of Table IV; "tenth" is the plant's default. P = I in the
  paper's units is named "identity".
- N_s = L / ds = 20, but there are 21 nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number
from fusion_sfdia.derivatives.differentiable import Differentiable
from fusion_sfdia.derivatives.equation import batch_rows
from fusion_sfdia.models.gas_pipeline import equations
from fusion_sfdia.models.gas_pipeline.equations import PipelineParameters
from fusion_sfdia.models.gas_pipeline.natural_gas import PRESSURES, TEMPERATURES
from fusion_sfdia.models.gas_pipeline.physics import (
    FLOW,
    INLET_PRESSURE,
    INLET_TEMPERATURE,
    STENCIL,
    courant_step,
    initial_state,
    pipeline_parameters,
    require_parameters,
    signals,
)
from fusion_sfdia.models.gas_pipeline.unknown import INPUT_ERRORS, unknown_of, unknown_parameters
from fusion_sfdia.plant.plant import Numerics, Plant, Truth
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Uncertainty, by_states_alone

Array = NDArray[Any]

SIGMA = {  # Pa, kg/s, K: Shaheen 2024, Table III
    "high": (50.0, 0.25, 0.15),
    "moderate": (500.0, 2.5, 1.5),
    "low": (1000.0, 10.0, 6.0),
}
PROCESS_NOISE = {"tenth": 0.1, "nine-tenths": 0.9}  # of the sensors' sigma, see above
IDENTITY = (1e6, 1.0, 1.0)  # Pa, kg/s, K: one of each of the paper's units
FINER = 4  # cells of the high-fidelity model in one of the grid: errors are 4^4 times smaller
DENSE_NODES = 600  # about 200 MB with all intermediate results
QUANTITIES = ("pressure", "mass flow", "temperature")


def demand(t: float) -> float:
    """Demand at the outlet, kg/s, our choice: 300 to 450 within 600 s, to 350 between 1800 and 2700 s, by cosine ramps."""

    def ramp(start: float, stop: float) -> float:
        return 0.5 * (1.0 - float(np.cos(np.pi * np.clip((t - start) / (stop - start), 0.0, 1.0))))

    return 300.0 + 150.0 * ramp(0.0, 600.0) - 100.0 * ramp(1800.0, 2700.0)


def gas_pipeline(
    *,
    nodes: int = 21,
    dt: float = 10.0,
    substeps: int | None = None,
    stations: int | None = None,
    snr: str = "moderate",
    process_noise: str = "tenth",
    initial: str = "noise",
    outlet_flow: Callable[[float], float] | float | None = None,
    parameters: PipelineParameters | None = None,
) -> Plant:
    """Return the pipeline as a plant.

    Parameters
    ----------
    nodes : int, default 21
        Of the grid, at least 7.
    dt : float, default 10
        Seconds between readings.
    substeps : int, optional
        Of RK4 in dt; None for the fewest that (9) allows.
    stations : int, optional
        Places with sensors, at every k-th node, named as on the coarse grid; None for all nodes.
    snr : str, default "moderate"
        "high", "moderate" or "low" (Table III).
    process_noise : str, default "tenth"
        "tenth" or "nine-tenths" of sigma.
    initial : str, default "noise"
        "noise" for P0 = R, "identity" for one squared unit of the paper (MPa, kg/s, K).
    outlet_flow : callable or float, optional
        Demand at the outlet in kg/s, as a number or a function of time (s); the initial state is the steady state for its value
        at 0. None for `demand`.
    parameters : PipelineParameters, optional
        From pipeline_parameters(...), with a roughness or a friction factor.

    Returns
    -------
    Plant
        With pressure, mass flow and temperature at the nodes as states.

    Raises
    ------
    ValueError
        For too few substeps, with the limit, and for a flow that no pipe of these parameters carries in steady state, with the
        largest possible flow.

    Examples
    --------
    >>> from fusion_sfdia.plants import gas_pipeline
    >>> plant = gas_pipeline()
    >>> len(plant.states), len(plant.sensors), plant.dt
    (63, 63, 10.0)
    """
    c = pipeline_parameters() if parameters is None else require_parameters(parameters)
    for what, value, known in (
        ("snr", snr, SIGMA), ("process_noise", process_noise, PROCESS_NOISE), ("initial", initial, ("noise", "identity")),
    ):  # fmt: skip
        if value not in known:
            raise ValueError(f"{what} is {value!r}; known: {', '.join(known)}")
    stations = nodes if stations is None else stations
    if nodes < 7 or stations < 2 or (nodes - 1) % (stations - 1):
        raise ValueError(
            f"{nodes} nodes with {stations} stations; expected at least 7 nodes and stations at every k-th of them"
        )
    if not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt is {dt} s; it must be positive and finite")
    asked = demand if outlet_flow is None else outlet_flow
    flow = asked if callable(asked) else partial(_constant, number("outlet_flow", asked))
    first = number("outlet_flow at 0 s", flow(0.0))
    x0 = initial_state(nodes, first, c)
    limit = courant_step(nodes, c, x0)
    needed = int(np.ceil(dt / limit - 1e-9))
    count = needed if substeps is None else substeps
    if count < needed:
        raise ValueError(
            f"dt = {dt:g} s in {count} substeps with {nodes} nodes breaks the CFL condition: the largest admissible step "
            f"is {limit:.4g} s; use substeps={needed}, a smaller dt or fewer nodes"
        )
    stencil = STENCIL / (12 * c.length / (nodes - 1))
    every = (nodes - 1) // (stations - 1)
    picks = (np.arange(3)[:, None] * nodes + np.arange(stations) * every).ravel()
    sigma = np.array(SIGMA[snr])
    model = _Pipe(nodes, count, picks, c, stencil)
    finer = partial(
        gas_pipeline, nodes=FINER * (nodes - 1) + 1, dt=dt, stations=stations, snr=snr, process_noise=process_noise,
        initial=initial, outlet_flow=outlet_flow, parameters=c,
    )  # fmt: skip
    step = Differentiable(model.step, model.step_and_jacobian)
    step_at = Differentiable(model.step_at, model.step_and_jacobian_at)
    return Plant(
        name="gas-pipeline",
        states=signals(nodes, x0),
        inputs=(
            Signal("p_inlet", "Pa", INLET_PRESSURE, *PRESSURES),
            Signal("T_inlet", "K", INLET_TEMPERATURE, *TEMPERATURES),
            Signal("m_outlet", "kg/s", first, *FLOW),
        ),
        sensors=tuple(
            Sensor(
                f"{letter}_{i}", f"{letter}_{i * every}", unit, sigma=float(sigma[v]), owner="pipe", quantity=QUANTITIES[v],
                meaning=f"{QUANTITIES[v]} at station {i}",
            )
            for v, (letter, unit) in enumerate((("p", "Pa"), ("m", "kg/s"), ("T", "K")))
            for i in range(stations)
        ),
        step=step,
        output=model.output,
        dt=dt,
        x0=x0,
        initial_cov=np.repeat((sigma if initial == "noise" else np.array(IDENTITY)) ** 2, nodes),
        process_cov=np.repeat((PROCESS_NOISE[process_noise] * sigma) ** 2, nodes),
        printed_process_noise=PROCESS_NOISE["nine-tenths"],
        numerics=Numerics(step.jacobian, model.output_jacobian, max_dt=limit * count),
        truth=Truth(operation=partial(_operation, dt, flow), finer=partial(_finer, finer, nodes)),
        uncertainty=Uncertainty(
            unknown_parameters(c), step_at, None, step_at.jacobian, model.output_jacobian_at, inputs=INPUT_ERRORS, at_rest=True
        ),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Pipe:
    """The functions of the plant; count: substeps; picks (N,): positions of the measured states."""

    nodes: int
    count: int
    picks: Array
    c: PipelineParameters
    stencil: Array

    def step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        return self._advance(equations.advance, x, u, dt, self.nominal)[0]

    def step_and_jacobian(self, t_start: float, x: Array, u: Array, dt: float) -> tuple[Array, Array]:
        require_dense(self.nodes)
        ahead, by_x = self._advance(equations.advance_tangent, x, u, dt, self.nominal, np.arange(x.shape[-1]))
        return ahead, by_x

    @cached_property
    def unknown(self) -> Array:
        """Positions (p,) in equations.UNKNOWN of the parameters theta."""
        return unknown_of(self.c)

    @cached_property
    def nominal(self) -> Array:
        """Nominal values (4,) of equations.UNKNOWN."""
        return np.array([getattr(self.c, name) for name in equations.UNKNOWN])

    def step_at(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        return self._advance(equations.advance, x, u, dt, self._of(theta))[0]

    def step_and_jacobian_at(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> tuple[Array, Array]:
        require_dense(self.nodes)
        states_and_inputs = x.shape[-1] + u.shape[-1]
        columns = np.concatenate([np.arange(states_and_inputs), states_and_inputs + self.unknown])
        ahead, by_all = self._advance(equations.advance_tangent, x, u, dt, self._of(theta), columns)
        return ahead, by_all

    def _of(self, theta: Array) -> Array:
        """The parameters equations.UNKNOWN (..., 4) with the values theta (..., p)."""
        found = np.broadcast_to(self.nominal, (*theta.shape[:-1], self.nominal.size)).astype(theta.dtype)
        found[..., self.unknown] = theta
        return found

    def output_jacobian_at(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        return by_states_alone(self._readout, u, theta)

    def output(self, t: float, x: Array, u: Array) -> Array:
        return x.copy() if self._all_read else x[..., self.picks]

    @cached_property
    def _all_read(self) -> bool:
        """Whether the readings are the states, in their order."""
        return np.array_equal(self.picks, np.arange(3 * self.nodes))

    def output_jacobian(self, t: float, x: Array, u: Array) -> Array:
        return self._readout

    @cached_property
    def _readout(self) -> Array:
        require_dense(self.nodes)
        selection = np.zeros((self.picks.size, 3 * self.nodes))
        selection[np.arange(self.picks.size), self.picks] = 1.0
        return selection

    def _advance(self, function: Any, x: Array, u: Array, dt: float, theta: Array, *which: Array) -> list[Array]:
        """What the function of states, inputs and parameters theta, (4,) for all or (..., 4), with a row for each, returns."""
        rows = [x, u, theta]
        shapes = {a.shape[:-1] for a in rows} - {()}
        kind, batch = np.result_type(*rows, float), shapes.pop() if len(shapes) == 1 else np.broadcast_shapes(*shapes)
        flat = [batch_rows(a, batch if a.ndim > 1 or a is not theta else (), kind) for a in rows]
        found = function(*flat, *which, float(dt), self.count, self.c, self.stencil)
        return [a.reshape(*batch, *a.shape[1:]) for a in (found if which else (found,))]


def _finer(model: Callable[[], Plant], nodes: int) -> tuple[Plant, Callable[[Array], Array]]:
    return model(), partial(coarse_state, stations=nodes)


def _constant(flow: float, t: float) -> float:
    return flow


def _operation(dt: float, flow: Callable[[float], float], t: float) -> Array:
    return np.array([INLET_PRESSURE, INLET_TEMPERATURE, flow(t + dt)])


def require_dense(nodes: int) -> None:
    """Raise ValueError where (n, n) matrices would fill the memory."""
    if nodes > DENSE_NODES:
        raise ValueError(
            f"Jacobians of {3 * nodes} states are dense and too large here; use the ensemble filter, which needs none, "
            f"or at most {DENSE_NODES} nodes"
        )


def coarse_state(x: Array, stations: int) -> Array:
    """The state (..., 3 stations) at the stations of a fine state (..., 3 nodes); ValueError for stations that are no nodes."""
    nodes = x.shape[-1] // 3
    if x.shape[-1] != 3 * nodes or stations < 2 or (nodes - 1) % (stations - 1):
        raise ValueError(f"a state of {x.shape[-1]} values has no {stations} stations; expected nodes = 1 + k (stations - 1)")
    fine = x.reshape(*x.shape[:-1], 3, nodes)
    return fine[..., :: (nodes - 1) // (stations - 1)].reshape(*x.shape[:-1], 3 * stations)
