"""The plant `marine-engine`: mean-value model of a four-stroke marine diesel engine with turbocharger (K24, appendix).

Kougiatsos and Reppa 2024, "A distributed cyber-physical framework for sensor fault diagnosis of marine internal combustion
engines". Equations and their misprints: equations.py. Parameters and their provenance: parameters.toml. Four subsystems with
ten sensors, S(I){j} the j-th sensor of subsystem I:

    fuel pump                 S(1){1} fuel
    thermomechanical process  S(2){1} p_cylinder, S(2){2} T_cylinder, S(2){3} torque
    exhaust gas path          S(3){1} p_receiver, S(3){2} T_receiver, S(3){3} T_turbine
    air path                  S(4){1} p_charge,   S(4){2} T_charge,   S(4){3} T_compressor

The input is the fuel setting u, 1 at full load. Noise is uniform within `noise` times each variable's value at the load of x0
and independent from sample to sample. The initial covariance and the process noise of filters are our choice, as the papers
have neither; a recording has process noise on request only. With them a Kalman filter forgets its initial state slowly, with a
time constant of 145 samples, since p_charge hardly moves. Innovations have the predicted variance from the first sample on.
Uniform noise is bounded, however, so that the largest innovations are due to the error of the estimate: their rate is steady
after about 400 samples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.discretise import discretise
from fusion_sfdia.core.modules import Modules, ObserverBound
from fusion_sfdia.core.physics import Physics
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.plant_groups import Structure, Truth, with_same_states
from fusion_sfdia.core.signals import Sensor, Signal
from fusion_sfdia.models.marine_engine import equations
from fusion_sfdia.models.marine_engine.equations import ALGEBRAIC, CONSTANT_SLIP, EQUATIONS, STATES, EngineParameters
from fusion_sfdia.models.marine_engine.equilibrium import LOADS, engine_variables, equilibrium, follows_law
from fusion_sfdia.models.marine_engine.faults import ProcessFault, parameter_schedule
from fusion_sfdia.models.marine_engine.parameters import engine_parameters

Array = NDArray[Any]

LONGEST_STEP = 0.005  # s: errors of at most 4e-4 in a load step from 100 to 80 %
FINER = 4  # substeps of the high-fidelity model in one of the model
INITIAL = 0.01  # standard deviation of x0, relative; our choice
PROCESS = (1e-3, 1e-3, 1e-4)  # standard deviation of the process noise in 0.01 s, relative; our choice
UNIT = {"f": "kg", "p": "Pa", "T": "K", "t": "N m"}
QUANTITY = {"f": "fuel", "p": "pressure", "T": "temperature", "t": "torque"}
SENSORS = {  # sensor: variable, in the order of K24 (29), (34), (44), (50)
    "S(1){1}": "fuel",
    "S(2){1}": "p_cylinder",
    "S(2){2}": "T_cylinder",
    "S(2){3}": "torque",
    "S(3){1}": "p_receiver",
    "S(3){2}": "T_receiver",
    "S(3){3}": "T_turbine",
    "S(4){1}": "p_charge",
    "S(4){2}": "T_charge",
    "S(4){3}": "T_compressor",
}
PICKS = np.array([(*STATES, *ALGEBRAIC).index(v) for v in SENSORS.values()])
SUBSYSTEMS = {  # variables of each
    "fuel pump": ("fuel",),
    "thermomechanical process": ("p_cylinder", "T_cylinder", "torque"),
    "exhaust gas path": ("p_receiver", "T_receiver", "T_turbine"),
    "air path": ("p_charge", "T_charge", "T_compressor"),
}


class Module(NamedTuple):
    """A monitoring module of K24, sec. VII: the variable whose equation it tests and its sensors S(I,q)."""

    variable: str
    sensors: tuple[str, ...]


MODULES = {
    "M(1,1)": Module("fuel", ("S(1){1}",)),
    "M(2,1)": Module("p_cylinder", ("S(2){1}",)),
    "M(2,2)": Module("T_cylinder", ("S(2){2}",)),
    "M(2,3)": Module("torque", ("S(2){2}", "S(2){3}")),
    "M(3,1)": Module("p_receiver", ("S(3){1}", "S(3){2}")),
    "M(3,2)": Module("T_receiver", ("S(3){1}", "S(3){2}")),
    "M(3,3)": Module("T_turbine", ("S(3){1}", "S(3){2}", "S(3){3}")),
    "M(4,1)": Module("p_charge", ("S(4){1}", "S(4){2}")),
    "M(4,2)": Module("T_charge", ("S(4){2}",)),
    "M(4,3)": Module("T_compressor", ("S(4){2}", "S(4){3}")),
}


GAINS = {"fuel": 1.16, "p_receiver": 900.0, "p_charge": 499.98}  # 1/s, gains L of the observers: K24, sec. VII
OBSERVER_BOUNDS = {  # K24, sec. VII; rho < 1 and rho_d < L of the last two contradict their definitions
    "fuel": ObserverBound(1.0, 25.0, 2.0, 20.0),
    "p_receiver": ObserverBound(0.05, 600.0, 900.0, 1000.0),
    "p_charge": ObserverBound(0.03, 500.0, 320.0, 450.0),
}
DRIFT = {"p_receiver": 0.0}  # at a steady load, as in the papers; for a changing load see receiver_drift
LOAD_RANGE = 0.03  # width of the range within which the fuel setting may change, see receiver_drift
RECEIVER_PER_FUEL, RECEIVER_PER_CHARGE = 0.87, 1.25  # A_1 and A_4 over 1 - A_3 there; proved in test_engine_drift
CHARGE_IMBALANCE = 0.3  # upper bound of |g_4 - x_4| there
MARGINS = {  # added to thresholds to reproduce the paper's pattern of modules that fire; our choice
    "p_receiver": 0.037,  # 2.95 noise bounds in all
    **dict.fromkeys(("p_cylinder", "T_cylinder", "torque", "T_receiver", "T_turbine", "T_compressor"), 0.03),
}


def marine_engine(
    *,
    load: float = 1.0,
    dt: float = 0.01,
    noise: float = 0.05,
    slip: str = "law",
    parameters: EngineParameters | None = None,
    process_faults: Sequence[ProcessFault] = (),
    substeps: int = 1,
) -> Plant:
    """Return the engine as a plant with the states fuel (kg), p_receiver (Pa), p_charge (Pa).

    load: fuel setting of x0 and of the nominal values, 0.2 to 1. dt: seconds between readings; the exponential midpoint rule
    divides it into the fewest equal steps of at most 5 ms, times `substeps`. noise: bound of each sensor's error over its
    nominal value (K24: 0.05, 0.01 to 0.1 in Fig. 5; K22: 0.03). slip: "law" or "constant". parameters: of another engine.
    process_faults: of an engine that starts from a healthy steady state; such a plant is a truth for the detectors of a healthy
    one. Raises ValueError for settings that do not fit, ArithmeticError where there is no equilibrium.
    """
    c = engine_parameters() if parameters is None else parameters
    law = follows_law(slip)
    if not (np.isfinite(noise) and noise > 0):
        raise ValueError(f"noise is {noise}; expected a positive share of the nominal values, such as 0.05")
    if not (np.isfinite(dt) and dt > 0) or substeps < 1:
        raise ValueError(f"dt is {dt} s in {substeps} substeps; expected a positive finite time and at least one")
    x0 = equilibrium(load, c, slip)
    nominal = engine_variables(x0, c, slip)
    owner = {variable: subsystem for subsystem, variables in SUBSYSTEMS.items() for variable in variables}
    plant = discretise(
        engine_physics(c, slip, x0, load),
        [
            Sensor(name, v, UNIT[v[0]], bound=noise * float(nominal[v]), owner=owner[v], quantity=QUANTITY[v[0]])
            for name, v in SENSORS.items()
        ],
        dt=dt,
        x0=x0,
        initial_cov=(INITIAL * x0) ** 2,
        process_cov=(np.array(PROCESS) * x0) ** 2 * (dt / 0.01),
        decay=decay_rates(c),
    )
    model = _Compiled(parameter_schedule(c, process_faults, slip), law, substeps)
    finer = partial(
        marine_engine, load=load, dt=dt, noise=noise, slip=slip, parameters=c, process_faults=tuple(process_faults),
        substeps=FINER * substeps,
    )  # fmt: skip
    return replace(
        plant,
        step=model.step,
        output=model.output,
        truth=Truth(finer=partial(with_same_states, finer)),
        structure=Structure(modules=engine_modules(c, slip, nominal)),
    )


@dataclass(frozen=True, eq=False)
class _Compiled:
    """The functions of the plant by the compiled drivers; parameters_at: the parameters as a function of time (s)."""

    parameters_at: Callable[[float], EngineParameters]
    law: bool
    substeps: int

    def step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        parts = self.substeps * max(1, int(np.ceil(dt / LONGEST_STEP - 1e-9)))
        batch = np.broadcast_shapes(x.shape[:-1], u.shape[:-1])
        result: Array = equations.advance(
            rows(x, batch, u.dtype), rows(u, batch, x.dtype), float(dt), parts, self.parameters_at(t_start), self.law
        )
        return result.reshape(*batch, len(STATES))

    def output(self, t: float, x: Array, u: Array) -> Array:
        batch = np.broadcast_shapes(x.shape[:-1], u.shape[:-1])
        flat = rows(x, batch, u.dtype)
        both = np.concatenate([flat, equations.algebraic(flat, self.parameters_at(t), self.law)], axis=-1)
        return both[:, PICKS].reshape(*batch, PICKS.size)


def receiver_drift(c: EngineParameters, dt: float) -> float:
    """Largest change of p_receiver within dt (s), over its nominal value, for any fuel setting within LOAD_RANGE.

    This is the drift of an AdaptiveThreshold for such loads: 0.013 in 0.01 s, for which the threshold of M(3,1) is 2.47 instead
    of 2.22 noise bounds. (The load step from 100 to 80 %, which leaves the usual envelope, changes it by 0.04.)

    With D_i(t) = x_i(t + h) - x_i(t), h <= dt, over nominal values, tau_pd x_3' = g - x_3, tau_TC x_4' = g_4 - x_4, and bounds
    A_i of the slopes dg/dx_i over the envelope:

        |D_1| <= (1 - exp(-dt/tau_X)) LOAD_RANGE        |D_4| <= (1 - exp(-dt/tau_TC)) sup |g_4 - x_4|
        tau_pd d|D_3|/dt <= A_1 |D_1| + A_4 |D_4| - (1 - A_3) |D_3|

    so that |D_3| <= (A_1 |D_1| + A_4 |D_4|) / (1 - A_3) after a steady state.
    """
    fuel, charge = -np.expm1(-dt / c.fuel_delay), -np.expm1(-dt / c.charge_delay)
    return float(RECEIVER_PER_FUEL * LOAD_RANGE * fuel + RECEIVER_PER_CHARGE * CHARGE_IMBALANCE * charge)


def engine_modules(c: EngineParameters, slip: str, nominal: Mapping[str, Any]) -> Modules:
    """The ten monitoring modules of K24 with the gains of its sec. VII."""
    table = engine_equations(slip)
    return Modules(
        equations={v: table[v] for v in (*STATES, *ALGEBRAIC)},
        rates=decay_rates(c),
        nominal={v: float(nominal[v]) for v in (*STATES, *ALGEBRAIC)},
        parameters=c,
        inputs=("fuel_setting",),
        names={module.variable: name for name, module in MODULES.items()},
        gains=GAINS,
        observer_bounds=OBSERVER_BOUNDS,
        margins=MARGINS,
        drift=DRIFT,
        monitor=partial(_monitor, c, follows_law(slip)),
    )


def _monitor(c: EngineParameters, law: bool, *arguments: Any) -> Any:
    return equations.monitor(*arguments, c, law)  # type: ignore[call-arg]


def rows(a: Array, batch: tuple[int, ...], other: Any) -> Array:
    """Return a (..., n), broadcast to the batch, as a contiguous matrix (B, n) of floats or complex numbers."""
    kind = np.result_type(a, other, float)
    return np.ascontiguousarray(np.broadcast_to(a, (*batch, a.shape[-1])), dtype=kind).reshape(-1, a.shape[-1])


def decay_rates(c: EngineParameters) -> Array:
    """1 / tau (3,) of the states, 1/s: A in x' = A x + h is their negative."""
    return 1.0 / np.array([c.fuel_delay, c.receiver_delay, c.charge_delay])


def engine_equations(slip: str) -> Mapping[str, Callable[..., Any]]:
    """The equations of the ten variables, with the slip by its "law" or "constant"."""
    return EQUATIONS if follows_law(slip) else EQUATIONS | CONSTANT_SLIP


def engine_physics(c: EngineParameters, slip: str, x0: Array, load: float) -> Physics:
    """The equations on arrays (..., 3), the reference for the compiled drivers."""
    table = engine_equations(slip)
    scalar = _Scalar(table, {name: equations.variables_of(function) for name, function in table.items()}, decay_rates(c))
    nominal = engine_variables(x0, c, slip)
    width = {"f": (0.1 * c.full_injection, 1.2 * c.full_injection), "p": (c.p_ambient, 2.0 * c.p_charge_nominal)}
    return Physics(
        name="marine-engine",
        states=tuple(Signal(n, UNIT[n[0]], float(nominal[n]), *width[n[0]]) for n in STATES),
        inputs=(Signal("fuel_setting", "1", load, *LOADS),),
        algebraic=tuple(Signal(n, UNIT[n[0]], float(nominal[n]), 0.0) for n in ALGEBRAIC),
        f=scalar.f,
        phi=scalar.phi,
        parameters=c,
    )


@dataclass(frozen=True, eq=False)
class _Scalar:
    """The functions of the physics by the scalar equations; names: their arguments; rates (3,): of the states, 1/s."""

    table: Mapping[str, Callable[..., Any]]
    names: Mapping[str, Sequence[str]]
    rates: Array

    def f(self, t: float, x: Array, z: Array, u: Array, c: EngineParameters) -> Array:
        return np.asarray(self._evaluate(STATES, x, z, u, c) - self.rates * x)

    def phi(self, t: float, x: Array, z: Array, u: Array, c: EngineParameters) -> Array:
        return self._evaluate(ALGEBRAIC, x, z, u, c)

    def _evaluate(self, asked: tuple[str, ...], x: Array, z: Array, u: Array, c: EngineParameters) -> Array:
        known = {"fuel_setting": u[..., 0]} | {n: x[..., i] for i, n in enumerate(STATES)}
        known |= {n: z[..., i] for i, n in enumerate(ALGEBRAIC)}
        values = [self.table[n](*(known[a] for a in self.names[n]), c) for n in asked]
        return np.stack(np.broadcast_arrays(*values), axis=-1)
