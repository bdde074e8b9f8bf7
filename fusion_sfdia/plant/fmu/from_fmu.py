"""A plant from a Functional Mock-up Unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, shown, whole
from fusion_sfdia.common.references import did_you_mean
from fusion_sfdia.derivatives.equation import difference_jacobian, step_of_change
from fusion_sfdia.plant.augment import joined
from fusion_sfdia.plant.fmu.handle import Fmu, digest_of
from fusion_sfdia.plant.fmu.interface import MODEL_EXCHANGE, Interface, Variable, read_interface
from fusion_sfdia.plant.plant import Numerics, Plant
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty

Array = NDArray[Any]
MEMORY = 1e-3  # of what two steps change: largest difference to the same steps, the second from set states
Stated = Mapping[str, Any] | float  # by name, or a share of the nominal value of each
TYPES = {"Real": float, "Float64": float, "Boolean": bool, "String": str}  # all others are integers


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


def table_of(what: str, given: Mapping[str, Any] | None) -> dict[str, Any]:
    """An argument by names, {} for None; ValueError for anything else."""
    if not isinstance(given, Mapping | None):
        raise ValueError(f"{what} is {shown(given)}; expected values by name, {{name: value}}")
    return dict(given or {})


def start_of(interface: Interface, values: Mapping[str, Any]) -> tuple[tuple[str, int, Any], ...]:
    """The setter of FMPy, value reference and value of each start value; ValueError for one that cannot be set."""
    found = []
    for v in interface.of("start value", values):
        value, kind = values[v.name], TYPES.get(v.kind, int)
        if not v.given or "[" in v.kind:
            raise ValueError(
                f"{interface}: {v.name!r} ({v.causality}, {v.kind}) has no start value that can be set; leave it out"
            )
        if not isinstance(value, str if kind is str else int | float | np.number):
            raise ValueError(f"{interface}: the start value of {v.name!r} is {shown(value)}; expected one of type {v.kind}")
        setter = "Integer" if v.kind == "Enumeration" and interface.version == 2 else v.kind
        found.append((f"set{'Int64' if setter == 'Enumeration' else setter}", v.reference, kind(value)))
    return tuple(found)


def fields_of_sensors(interface: Interface, stated: Stated) -> dict[str, dict[str, Any]]:
    """The fields of each sensor by its name; those of a share have none but "measures" and "share"."""
    if not isinstance(stated, Mapping):
        share = number("sensors", stated)
        outputs = [v.name for v in interface.of("sensor", interface.outputs) if v.continuous]
        return {name: {"measures": name, "share": share} for name in outputs}
    return {name: {"measures": name, **_table("sensor", name, value, "sigma", Sensor)} for name, value in stated.items()}


def sensor_of(interface: Interface, name: str, stated: Mapping[str, Any], v: Variable, value: float) -> Sensor:
    """The sensor that reads a variable, whose value at the start is given."""
    given = dict(stated)
    if (share := given.pop("share", None)) is not None:
        given["sigma"] = share * _scale(interface, "sensors", v, value)
    return Sensor(name, **{"unit": v.unit, "quantity": v.quantity, **given})


def states_of(interface: Interface, variables: list[Variable], x0: Array, **stated: Stated) -> tuple[Signal, ...]:
    """The signals of the states; stated: initial_sigma and process_sigma."""
    sigmas: list[dict[str, Any]] = [{} for _ in variables]
    for what, given in stated.items():
        if isinstance(given, Mapping):
            interface.of("state", given)
            if missing := [v.name for v in variables if v.name not in given]:
                raise ValueError(
                    f"{what} has no value for the states {', '.join(missing)} of {interface}; expected a standard deviation "
                    "for each state in its unit, or one number for all: a share of each nominal value"
                )
        for sigma, v, value in zip(sigmas, variables, x0, strict=True):
            sigma[what] = (
                given[v.name] if isinstance(given, Mapping) else number(what, given) * _scale(interface, what, v, value)
            )
    return tuple(
        Signal(v.name, v.unit, float(value), v.low, v.high, **sigma)
        for v, value, sigma in zip(variables, x0, sigmas, strict=True)
    )


def parameters_of(interface: Interface, stated: Mapping[str, Any], start: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """The parameters that are not known exactly, about their start values."""
    found = []
    for v in interface.of("unknown parameter", stated):
        nominal = start.get(v.name, v.start)
        if v.causality != "parameter" or v.kind not in ("Real", "Float64") or nominal is None:
            raise ValueError(
                f"{interface}: {v.name!r} ({v.causality}, {v.kind}) is no real parameter with a start value; expected one for "
                "unknown, inputs with an error stand in input_errors"
            )
        given = _table("unknown parameter", v.name, stated[v.name], "sd", Parameter)
        found.append(Parameter(v.name, **{"unit": v.unit, "nominal": float(nominal), "low": v.low, "high": v.high, **given}))
    return tuple(found)


def _table(what: str, name: str, value: Any, usual: str, kind: type) -> dict[str, Any]:
    """The fields of a table, or of a number that stands for the usual one; ValueError for an unknown field."""
    if not isinstance(value, Mapping):
        return {usual: number(f"{usual} of {what} {name!r}", value)}
    known = [f.name for f in fields(kind) if f.name != "name"]
    if wrong := [key for key in value if key not in known]:
        raise ValueError(f"{what} {name!r} has {wrong[0]!r}; {did_you_mean(wrong[0], known)}expected of: {', '.join(known)}")
    return dict(value)


def _scale(interface: Interface, what: str, v: Variable, value: float) -> float:
    """The nominal value of a variable, or the size of its value at the start."""
    scale = v.scale or abs(float(value))
    if not (scale > 0 and np.isfinite(scale)):
        raise ValueError(
            f"{interface} states no nominal value of {v.name!r}, which is {value:g} at the start; give {what} by name, "
            f"{{{v.name!r}: a standard deviation in {v.unit}, ...}}"
        )
    return scale


@dataclass(frozen=True, eq=False)
class ModelExchange:
    """dx/dt = f(t, x, u; theta), y = h(t, x, u; theta) of an FMU for model exchange, and Runge-Kutta 4 of both.

    nominal, sd (p,): of theta, the parameters that are not known exactly. The derivatives are exact, those of Runge-Kutta 4:
    its tangent X = dx/d(x, u) follows dX/dt = A X + B dU with A = df/dx and B = df/du of the FMU. Those with respect to theta
    are central differences.
    """

    fmu: Fmu
    substeps: int
    nominal: Array
    sd: Array

    def rates(self, t: float, x: Array, u: Array) -> Array:
        """dx/dt (..., n)."""
        return self.fmu.each("derivatives", (len(self.fmu.states),), x, u, self.nominal, t)

    def step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        return self.step_at(t_start, x, u, dt, self.nominal)

    def output(self, t: float, x: Array, u: Array) -> Array:
        return self.output_at(t, x, u, self.nominal)

    def output_at(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        return self.fmu.each("readings", (len(self.fmu.outputs),), x, u, theta, t)

    def step_at(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        return self.fmu.each("advanced", (len(self.fmu.states),), x, u, theta, t_start, dt, self.substeps)

    def step_jacobian(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        return self._step_tangent(t_start, x, u, dt, self.nominal)[..., : x.shape[-1]]

    def output_jacobian(self, t: float, x: Array, u: Array) -> Array:
        return self._output_tangent(t, x, u, self.nominal)[..., : x.shape[-1]]

    def step_jacobian_at(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        """With respect to x, u and theta, side by side (..., n, n + m + p)."""
        by_theta = self._differences(lambda q: self.step_at(t_start, x[..., None, :], u[..., None, :], dt, q), x, u, theta)
        return np.concatenate([self._step_tangent(t_start, x, u, dt, theta), by_theta], axis=-1)

    def output_jacobian_at(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        """The same of the readings (..., N, n + m + p)."""
        by_theta = self._differences(lambda q: self.output_at(t, x[..., None, :], u[..., None, :], q), x, u, theta)
        return np.concatenate([self._output_tangent(t, x, u, theta), by_theta], axis=-1)

    def _step_tangent(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        shape = x.shape[-1], x.shape[-1] + u.shape[-1]
        return self.fmu.each("advanced_tangent", shape, x, u, theta, t_start, dt, self.substeps)

    def _output_tangent(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        return self.fmu.each("output_tangents", (len(self.fmu.outputs), x.shape[-1] + u.shape[-1]), x, u, theta, t)

    def _differences(self, function: Callable[[Array], Array], x: Array, u: Array, theta: Array) -> Array:
        batch = np.broadcast_shapes(*(a.shape[:-1] for a in (x, u, theta)))
        return difference_jacobian(function, np.broadcast_to(theta, (*batch, theta.shape[-1])), self.sd)


@dataclass(frozen=True, eq=False)
class CoSimulation:
    """A step of an FMU for co-simulation from states that are set, by its own solver, and its outputs.

    Derivatives are central differences, wider than usual by (tolerance / eps)^(1/3), as the solver errs by its tolerance.
    nominal (p,): of the parameters theta that are not known exactly. scale (n + m + p,): a size of states, inputs and
    parameters that matters.
    """

    fmu: Fmu
    nominal: Array
    scale: Array

    def step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        return self.step_at(t_start, x, u, dt, self.nominal)

    def output(self, t: float, x: Array, u: Array) -> Array:
        return self.output_at(t, x, u, self.nominal)

    def step_at(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        return self.fmu.each("ahead", (len(self.fmu.states),), x, u, theta, t_start, dt)

    def output_at(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        return self.fmu.each("outputs_at", (len(self.fmu.outputs),), x, u, theta, t)

    def step_jacobian(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        return difference_jacobian(lambda p: self.step(t_start, p, u[..., None, :], dt), x, self._wide[: x.shape[-1]])

    def output_jacobian(self, t: float, x: Array, u: Array) -> Array:
        return difference_jacobian(lambda p: self.output(t, p, u[..., None, :]), x, self._wide[: x.shape[-1]])

    def step_jacobian_at(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        """With respect to x, u and theta, side by side (..., n, n + m + p)."""
        return self._by_all(lambda p, v, q: self.step_at(t_start, p, v, dt, q), x, u, theta)

    def output_jacobian_at(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        """The same of the readings (..., N, n + m + p)."""
        return self._by_all(lambda p, v, q: self.output_at(t, p, v, q), x, u, theta)

    def _by_all(self, function: Callable[[Array, Array, Array], Array], x: Array, u: Array, theta: Array) -> Array:
        n, m = x.shape[-1], u.shape[-1]
        z = joined(joined(x, u), theta)
        return difference_jacobian(lambda w: function(w[..., :n], w[..., n : n + m], w[..., n + m :]), z, self._wide)

    @property
    def _wide(self) -> Array:
        return np.asarray(self.scale * (self.fmu.interface.tolerance / np.finfo(float).eps) ** (1 / 3))
