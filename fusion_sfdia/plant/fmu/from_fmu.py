"""A plant from a Functional Mock-up Unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, whole
from fusion_sfdia.derivatives.equation import difference_jacobian, step_of_change
from fusion_sfdia.plant.fmu.functions import CoSimulation, ModelExchange
from fusion_sfdia.plant.fmu.handle import Fmu, digest_of
from fusion_sfdia.plant.fmu.interface import MODEL_EXCHANGE, Interface, Variable, read_interface
from fusion_sfdia.plant.fmu.stated import Stated, fields_of_sensors, parameters_of, sensor_of, start_of, states_of, table_of
from fusion_sfdia.plant.plant import Numerics, Plant
from fusion_sfdia.plant.signals import Signal
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty

Array = NDArray[Any]
MEMORY = 1e-3  # of what two steps change: largest difference to the same steps, the second from set states


def from_fmu(
    path: str | Path,
    *,
    sensors: Stated,
    initial_sigma: Stated,
    process_sigma: Stated,
    dt: float | None = None,
    inputs: Sequence[str] | None = None,
    states: Sequence[str] | None = None,
    start_values: Mapping[str, Any] | None = None,
    unknown: Mapping[str, Any] | None = None,
    input_errors: Mapping[str, float] | None = None,
    kind: str | None = None,
    substeps: int = 1,
    max_dt: float | None = None,
) -> Plant:
    """Return the plant of an FMU of FMI 2.0 or 3.0, with the names, units and limits of its modelDescription.xml.

    Noise, which no FMU states, is given by the names of variables in their units, or as one number, a share of each variable's
    nominal value (where the FMU states none, of its value at the start).

    Parameters
    ----------
    path : str or Path
        The file.
    sensors : mapping or float
        Standard deviation of each reading, {variable: sigma} or {sensor: {"measures": variable, "sigma": sigma, ...}} with
        fields of `Sensor`; a share makes each output a sensor that changes continuously.
    initial_sigma : mapping of str to float, or float
        Of each state, as in `Signal`.
    process_sigma : mapping of str to float, or float
        Of each state, as in `Signal`.
    dt : float, optional
        Seconds between readings, that of the FMU's default experiment unless given.
    inputs : sequence of str, optional
        Those of the plant, all of the FMU by default; others keep their start values.
    states : sequence of str, optional
        Of co-simulation, the memory of the FMU: by default those whose derivatives it states.
    start_values : mapping, optional
        Of parameters, inputs and states in place of the FMU's.
    unknown : mapping, optional
        Parameters that are not known exactly, {name: standard deviation} or {name: {"sd": ..., ...}} with fields of
        `Parameter`.
    input_errors : mapping of str to float, optional
        As `inputs` of `Uncertainty`.
    kind : str, optional
        "model exchange" or "co-simulation", by default the first it has.
    substeps : int, default 1
        Of the integration of model exchange within dt.
    max_dt : float, optional
        The longest step at once in s, as in `discretise`.

    Returns
    -------
    Plant
        It opens the FMU in each process that uses it, from the same file; what fails while it runs is an ArithmeticError.

    Raises
    ------
    MissingPackageError
        Without FMPy.
    ValueError
        For what is no such FMU, for events, unknown variables, and noise that is not stated.

    Notes
    -----
    Model exchange is integrated by Runge-Kutta 4 with held inputs in `substeps` steps, with max_dt, as in `discretise`.
    Jacobians are exact where the FMU gives directional derivatives of the sensors' variables, else central differences.
    Co-simulation is stepped by its own solver, from states that are set in the FMU as it was instantiated: it must be able to
    get and set its state and have no memory beyond `states`. Jacobians are differences as wide as its tolerance asks for.

    Examples
    --------
    >>> from fusion_sfdia.plants import from_fmu
    >>> plant = from_fmu("tanks.fmu", sensors={"level_1": 0.01, "level_2": 0.01}, initial_sigma=0.01,
    ...                  process_sigma=1e-3)  # doctest: +SKIP
    """
    interface, start = read_interface(path, kind), table_of("start_values", start_values)
    of_unknown, errors = table_of("unknown", unknown), table_of("input_errors", input_errors)
    whole(f"{interface}: substeps", substeps, 1)
    step = _time_step(interface, dt)
    of_states, of_inputs = _states(interface, states), _inputs(interface, inputs)
    stated = fields_of_sensors(interface, sensors)
    measured = interface.continuous("sensor", [f["measures"] for f in stated.values()])
    parameters = parameters_of(interface, of_unknown, start)
    fmu = Fmu(
        replace(interface, path=interface.path.resolve(), variables={}),
        digest_of(interface.path),
        states=references(of_states),
        rates=tuple(v.rate for v in of_states if v.rate is not None),
        inputs=references(of_inputs),
        outputs=references(measured),
        parameters=references(interface.of("unknown parameter", [p.name for p in parameters])),
        start=start_of(interface, start),
    )
    theta = np.array([p.nominal for p in parameters])
    x0, u0, y0 = (fmu.initial(what, theta) for what in ("states", "inputs", "outputs"))
    signals = states_of(interface, of_states, x0, initial_sigma=initial_sigma, process_sigma=process_sigma)
    acting = tuple(Signal(v.name, v.unit, float(value), v.low, v.high) for v, value in zip(of_inputs, u0, strict=True))
    instruments = tuple(
        sensor_of(interface, name, stated[name], v, value) for name, v, value in zip(stated, measured, y0, strict=True)
    )
    sds = np.array([p.sd for p in parameters])
    model: ModelExchange | CoSimulation
    if interface.kind == MODEL_EXCHANGE:
        model = ModelExchange(fmu, substeps, theta, sds)
        exact = interface.directional and {v.name for v in measured} <= {*interface.outputs, *interface.states}
    else:
        sizes = [s.initial_sigma or s.process_sigma or 1.0 for s in signals]
        sizes += [errors.get(s.name) or 0.01 * abs(s.nominal) or 1.0 for s in acting]
        model, exact = CoSimulation(fmu, theta, np.array([*sizes, *sds])), True
        _require_no_memory(model, x0, u0, acting, step)
    plant = Plant(
        interface.name,
        signals,
        instruments,
        model.step,
        model.output,
        step,
        acting,
        numerics=Numerics(
            model.step_jacobian if exact else None,
            model.output_jacobian if exact else None,
            max_dt=np.inf if max_dt is None else max_dt,
            fixed_dt=not interface.any_step,
        ),
        uncertainty=_of_unknown(model, parameters, errors, exact),
    )
    if max_dt is not None or isinstance(model, CoSimulation):
        return plant
    by_x = difference_jacobian(lambda x: model.rates(0.0, x, u0), x0, plant.state_scale)
    return replace(plant, numerics=replace(plant.numerics, max_dt=step_of_change(by_x, plant.state_scale, step)))


def _of_unknown(
    model: ModelExchange | CoSimulation, parameters: tuple[Parameter, ...], errors: dict[str, float], differentiated: bool
) -> Uncertainty:
    """The model at other values of its parameters, with its derivatives where it has any."""
    return Uncertainty(
        parameters,
        model.step_at if parameters else None,
        model.output_at if parameters else None,
        model.step_jacobian_at if differentiated else None,
        model.output_jacobian_at if differentiated else None,
        inputs=errors,
    )


def _time_step(interface: Interface, dt: float | None) -> float:
    if dt is None and interface.step is None:
        raise ValueError(f"{interface} states no step of its default experiment; expected dt, the seconds between readings")
    return number("dt", interface.step if dt is None else dt)


def _inputs(interface: Interface, names: Sequence[str] | None) -> list[Variable]:
    """The inputs of the plant."""
    found = interface.continuous("input", interface.inputs if names is None else names)
    if wrong := [v.name for v in found if v.causality != "input"]:
        raise ValueError(f"{interface}: {wrong[0]!r} is no input; expected of: {', '.join(interface.inputs) or 'none'}")
    return found


def _states(interface: Interface, names: Sequence[str] | None) -> list[Variable]:
    """The states of the plant; ValueError where there are none, or where co-simulation cannot be stepped from them."""
    exchanged = interface.kind == MODEL_EXCHANGE
    if exchanged and names is not None and tuple(names) != interface.states:
        raise ValueError(
            f"{interface} has the states {', '.join(interface.states)}, all of which a plant needs; leave states out"
        )
    if not exchanged and not interface.get_and_set:
        raise ValueError(
            f"{interface} cannot get and set its state, so that no filter can step it from an estimate; expected "
            "canGetAndSetFMUstate = true: export it as model exchange, or as co-simulation with that capability"
        )
    if not (found := interface.continuous("state", interface.states if names is None else names)):
        cure = "a plant needs at least one" if exchanged else "name them: states=[...]"
        raise ValueError(f"{interface} states no continuous states; {cure}")
    if not exchanged and (fixed := [v.name for v in found if not v.given]):
        raise ValueError(
            f"{interface}: the start of its state {fixed[0]!r} cannot be set; expected states with initial = exact or approx: "
            "export it as model exchange"
        )
    return found


def _require_no_memory(model: CoSimulation, x0: Array, u0: Array, inputs: Sequence[Signal], dt: float) -> None:
    """Raise ValueError where two steps differ from the same steps of which the second begins from the states that are set.

    From x0, with each input moved by a tenth of its size. Two solver runs of one model may differ by its tolerance.
    """
    u = np.clip(u0 + 0.1 * np.where(u0 != 0, np.abs(u0), 1.0), [s.low for s in inputs], [s.high for s in inputs])
    fmu, tolerance = model.fmu, model.fmu.interface.tolerance
    through = fmu.each("twice", (x0.size + len(fmu.outputs),), x0, u, model.nominal, 0.0, dt)
    x = model.step(dt, model.step(0.0, x0, u, dt), u, dt)
    apart, before = (np.concatenate([x, model.output(t, x, u)]) for t, x in ((2 * dt, x), (0.0, x0)))
    allowed = MEMORY * np.abs(through - before) + 10 * tolerance * np.maximum(np.abs(before), np.abs(through))
    if np.any(wrong := ~(np.abs(through - apart) <= allowed)):
        k = int(np.argmax(wrong))
        which = f"state {k + 1}" if k < x0.size else f"sensor {k - x0.size + 1}"
        raise ValueError(
            f"{fmu.interface} has a memory beyond its states: two steps in a row and the same from set states differ by "
            f"{abs(through[k] - apart[k]):.2g} in {which}; expected none: name the others (states=[...]) or export it as model "
            "exchange"
        )


def references(variables: Sequence[Variable]) -> tuple[int, ...]:
    """Their value references."""
    return tuple(v.reference for v in variables)
