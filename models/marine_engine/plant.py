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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.differentiable import Differentiable
from fusion_sfdia.derivatives.equation import batch_rows
from fusion_sfdia.models.marine_engine import equations
from fusion_sfdia.models.marine_engine.equations import ALGEBRAIC, STATES, EngineParameters
from fusion_sfdia.models.marine_engine.equilibrium import engine_variables, equilibrium, follows_law
from fusion_sfdia.models.marine_engine.faults import EngineFault, parameter_schedule
from fusion_sfdia.models.marine_engine.modules import engine_modules
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.physics import UNIT, decay_rates, engine_physics
from fusion_sfdia.plant.discretise import discretise
from fusion_sfdia.plant.plant import Plant, Structure, Truth, with_same_states
from fusion_sfdia.plant.signals import Sensor
from fusion_sfdia.plant.uncertainty import PriorSpread, Uncertainty

Array = NDArray[Any]

LONGEST_STEP = 0.005  # s: errors of at most 4e-4 in a load step from 100 to 80 %
FINER = 4  # substeps of the high-fidelity model in one of the model
INITIAL = 0.01  # standard deviation of x0, relative; our choice
PROCESS = (1e-3, 1e-3, 1e-4)  # standard deviation of the process noise in 0.01 s, relative; our choice
QUANTITY = {"f": "fuel", "p": "pressure", "T": "temperature", "t": "torque"}
SPREAD = {
    "load": PriorSpread(
        "W s3",
        0.05,
        0.02,
        "a propeller law holds for one draught and weather; hull fouling takes 5 to 15 % between dockings",
    ),
    "heat": PriorSpread(
        "J/kg", 0.015, 0.0, "heating values of marine distillates differ by a percent, the share released by another"
    ),
    "turbine_area": PriorSpread(
        "m2", 0.03, 1e-4, "deposits narrow the nozzle ring by some percent between cleanings; our choice"
    ),
    "turbocharger_efficiency": PriorSpread(
        "1", 0.02, 1e-4, "a fouled compressor loses a few percent between washings; our choice"
    ),
    "T_cooler": PriorSpread("K", 3.0, 0.5, "sea water and valves of the cooler; our choice"),
}
FUEL_SETTING = 0.01  # standard deviation of the rack's error, of full load; our choice
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
MEANING = {  # of the variables that are measured, and of the parameters that are not known
    "fuel": "fuel injected per cycle",
    "p_cylinder": "cylinder pressure",
    "T_cylinder": "cylinder temperature",
    "torque": "engine torque",
    "p_receiver": "exhaust receiver pressure",
    "T_receiver": "exhaust receiver temperature",
    "T_turbine": "temperature after the turbine",
    "p_charge": "charge-air pressure",
    "T_charge": "charge-air temperature",
    "T_compressor": "temperature after the compressor",
    "load": "load of the propeller",
    "heat": "heating value of the fuel",
    "turbine_area": "effective area of the turbine",
    "turbocharger_efficiency": "efficiency of the turbocharger",
    "T_cooler": "temperature of the charge-air cooler",
}
CHECK = {  # of these parameters
    "load": "Check the hull and the propeller for fouling, and the weather at that time.",
    "heat": "Check the bunker delivery note, and have a fuel sample analysed.",
    "turbine_area": "Check the turbine's nozzle ring for deposits and damage.",
    "turbocharger_efficiency": "Check the compressor for fouling; wash it if it is fouled.",
    "T_cooler": "Check the charge-air cooler's water flow, water temperature and valves.",
}
PICKS = np.array([(*STATES, *ALGEBRAIC).index(v) for v in SENSORS.values()])
SUBSYSTEMS = {  # variables of each
    "fuel pump": ("fuel",),
    "thermomechanical process": ("p_cylinder", "T_cylinder", "torque"),
    "exhaust gas path": ("p_receiver", "T_receiver", "T_turbine"),
    "air path": ("p_charge", "T_charge", "T_compressor"),
}


def marine_engine(
    *,
    load: float = 1.0,
    dt: float = 0.01,
    noise: float = 0.05,
    slip: str = "law",
    parameters: EngineParameters | None = None,
    process_faults: Sequence[EngineFault] = (),
    substeps: int = 1,
) -> Plant:
    """Return the engine as a plant with the states fuel (kg), p_receiver (Pa), p_charge (Pa).

    Parameters
    ----------
    load : float, default 1
        Fuel setting of x0 and of the nominal values, 0.2 to 1.
    dt : float, default 0.01
        Seconds between readings; the exponential midpoint rule divides it into the fewest equal steps of at most 5 ms, times
        `substeps`.
    noise : float, default 0.05
        Bound of each sensor's error over its nominal value (K24: 0.05, 0.01 to 0.1 in Fig. 5; K22: 0.03).
    slip : str, default "law"
        "law" or "constant".
    parameters : EngineParameters, optional
        Of another engine.
    process_faults : sequence of EngineFault, default ()
        Of an engine that starts from a healthy steady state; such a plant is a truth for the detectors of a healthy one.
    substeps : int, default 1
        Factor on the number of steps within dt.

    Returns
    -------
    Plant
        Of Kougiatsos and Reppa 2024 (K24) and Kougiatsos 2022 (K22).

    Raises
    ------
    ValueError
        For settings that do not fit.
    ArithmeticError
        Where there is no equilibrium.

    Examples
    --------
    >>> from fusion_sfdia.plants import marine_engine
    >>> [state.name for state in marine_engine(load=0.8).states]
    ['fuel', 'p_receiver', 'p_charge']
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
            Sensor(
                name,
                v,
                UNIT[v[0]],
                bound=noise * float(nominal[v]),
                owner=owner[v],
                quantity=QUANTITY[v[0]],
                meaning=MEANING[v],
            )
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
    step = Differentiable(model.step, model.step_and_jacobian)
    output = Differentiable(model.output, model.output_and_jacobian)
    return replace(
        plant,
        step=step,
        output=output,
        numerics=replace(plant.numerics, step_jacobian=step.jacobian, output_jacobian=output.jacobian),
        truth=Truth(finer=partial(with_same_states, finer)),
        structure=Structure(modules=engine_modules(c, slip, nominal)),
        uncertainty=Uncertainty() if process_faults else _uncertainty(model, c),
    )


@dataclass(frozen=True, eq=False)
class _Compiled:
    """The functions of the plant by the compiled drivers; parameters_at: the parameters as a function of time (s)."""

    parameters_at: Callable[[float], EngineParameters]
    law: bool
    substeps: int

    def _parts(self, dt: float) -> int:
        return self.substeps * max(1, int(np.ceil(dt / LONGEST_STEP - 1e-9)))

    def step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        return self.step_at(t_start, x, u, dt, self._nominal(t_start))

    def output(self, t: float, x: Array, u: Array) -> Array:
        return self.output_at(t, x, u, self._nominal(t))

    def step_and_jacobian(self, t_start: float, x: Array, u: Array, dt: float) -> tuple[Array, Array]:
        ahead, by_all = self._step_tangent(t_start, x, u, dt, self._nominal(t_start), 0)
        return ahead, by_all[..., : len(STATES)]

    def output_and_jacobian(self, t: float, x: Array, u: Array) -> tuple[Array, Array]:
        y, by_all = self._output_tangent(t, x, u, self._nominal(t), 0)
        return y, by_all[..., : len(STATES)]

    def step_at(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        batch, states, inputs, parameters = _rows(x, u, theta, np.result_type(x, u, theta))
        c = self.parameters_at(t_start)
        result: Array = equations.advance(states, inputs, parameters, float(dt), self._parts(dt), c, self.law)
        return result.reshape(*batch, len(STATES))

    def output_at(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        batch, states, _, parameters = _rows(x, u, theta, np.result_type(x, u, theta))
        z = equations.algebraic(states, parameters, self.parameters_at(t), self.law)
        return np.concatenate([states, z], axis=-1)[:, PICKS].reshape(*batch, PICKS.size)

    def step_and_jacobian_at(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> tuple[Array, Array]:
        return self._step_tangent(t_start, x, u, dt, theta, theta.shape[-1])

    def output_and_jacobian_at(self, t: float, x: Array, u: Array, theta: Array) -> tuple[Array, Array]:
        return self._output_tangent(t, x, u, theta, theta.shape[-1])

    def _step_tangent(self, t_start: float, x: Array, u: Array, dt: float, theta: Array, count: int) -> tuple[Array, Array]:
        batch, states, inputs, parameters = _rows(x, u, theta, float)
        c = self.parameters_at(t_start)
        found = equations.advance_tangent(states, inputs, parameters, count, float(dt), self._parts(dt), c, self.law)
        ahead, by_all = (a.reshape(*batch, *a.shape[1:]) for a in found)
        return ahead, by_all

    def _output_tangent(self, t: float, x: Array, u: Array, theta: Array, count: int) -> tuple[Array, Array]:
        batch, states, _, parameters = _rows(x, u, theta, float)
        found = equations.variables_tangent(states, parameters, count, self.parameters_at(t), self.law)
        y, by_all = (a[:, PICKS].reshape(*batch, PICKS.size, *a.shape[2:]) for a in found)
        return y, by_all

    def _nominal(self, t: float) -> Array:
        return equations.unknown_of(self.parameters_at(t))


def _uncertainty(model: _Compiled, c: EngineParameters) -> Uncertainty:
    """What is not known of the engine.

    full_injection is not declared: it only multiplies the fuel setting, whose error is. At a steady load the estimates of load
    and turbine area have the correlation -0.96, of the heat of the fuel and the error of its setting -0.80.
    """
    parameters = [
        replace(SPREAD[name].parameter(name, float(getattr(c, name))), meaning=MEANING[name], check=CHECK[name])
        for name in equations.UNKNOWN
    ]
    step = Differentiable(model.step_at, model.step_and_jacobian_at)
    output = Differentiable(model.output_at, model.output_and_jacobian_at)
    errors = {"fuel_setting": FUEL_SETTING}
    return Uncertainty(tuple(parameters), step, output, step.jacobian, output.jacobian, inputs=errors, at_rest=True)


def _rows(x: Array, u: Array, theta: Array, kind: Any) -> tuple[Any, ...]:
    """The batch, then states, inputs and parameters of that type (B, ...); of parameters for all (1, 5)."""
    batch = x.shape[:-1]
    if u.shape[:-1] != batch or theta.ndim > 1:
        batch = np.broadcast_shapes(batch, u.shape[:-1], theta.shape[:-1])
    of_parameters = batch_rows(theta, batch if theta.ndim > 1 else (), kind)
    return batch, batch_rows(x, batch, kind), batch_rows(u, batch, kind), of_parameters
