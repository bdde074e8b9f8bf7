"""Discretised plants from continuous physics: algebraic variables, Runge-Kutta 4 and the exponential midpoint rule."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core import straight_line_kernels
from fusion_sfdia.core.arguments import floats, number
from fusion_sfdia.core.equation import complex_step_jacobian, difference_jacobian
from fusion_sfdia.core.linear import constant, picked
from fusion_sfdia.core.physics import Physics
from fusion_sfdia.core.plant import FROM_STATES, Plant
from fusion_sfdia.core.plant_groups import Numerics, Truth
from fusion_sfdia.core.signals import Sensor
from fusion_sfdia.core.straight_line import Program, record
from fusion_sfdia.core.straight_line_kernels import ALGEBRAIC_TOLERANCE, MAX_SWEEPS
from fusion_sfdia.core.uncertainty import Parameter, Uncertainty

Array = NDArray[Any]

LARGEST_CHANGE = 0.1  # of a deviation within a step: the error of a step's noise variance, see `largest_step`


def runge_kutta_4(slope: Callable[[float, Array], Array], t_start: float, x: Array, dt: float) -> Array:
    """One step of the classical fourth-order method (Shaheen 2024, sec. II-B)."""
    k1 = slope(t_start, x)
    k2 = slope(t_start + dt / 2, x + dt / 2 * k1)
    k3 = slope(t_start + dt / 2, x + dt / 2 * k2)
    k4 = slope(t_start + dt, x + dt * k3)
    advanced: Array = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return advanced


def exponential_midpoint(slope: Callable[[float, Array], Array], t_start: float, x: Array, dt: float, decay: Array) -> Array:
    """One step of x' = -a x + h by x+ = e^(-a dt) x + (1 - e^(-a dt)) / a h_mid; h_mid is h after half a step with h held.

    decay: a (n,) in 1/s, all positive. The rule is of second order, and exact for constant h however stiff a is (Hochbruck and
    Ostermann 2010, sec. 2.2). With h at the beginning in place of h_mid it is exponential Euler (ETD1), of first order.
    """
    middle = x - np.expm1(-decay * dt / 2) / decay * slope(t_start, x)
    h = slope(t_start + dt / 2, middle) + decay * middle
    advanced: Array = x - np.expm1(-decay * dt) / decay * (h - decay * x)
    return advanced


def solve_algebraic(physics: Physics, t: float, x: Array, u: Array) -> Array:
    """Return z (..., k) with z = phi(t, x, z, u, c), by fixed-point sweeps from the nominal values.

    A variable has settled when a sweep changes it by at most 1e-13 of its value or its nominal value, whichever is larger: a
    variable that is zero by cancellation never settles relative to itself. Real and imaginary parts must both have settled:
    otherwise a Jacobian by the complex step would be that of a sweep, not of the solution. Raises ArithmeticError with the
    names of the variables that do not settle.
    """
    nominal = np.array([s.nominal for s in physics.algebraic], dtype=float)
    scale = np.maximum(np.abs(nominal), 1e-300)
    batch = np.broadcast_shapes(x.shape[:-1], u.shape[:-1])
    z = np.broadcast_to(nominal, (*batch, nominal.size)).astype(np.result_type(x, u, float))
    if physics.phi is None:
        return z
    for _ in range(MAX_SWEEPS):
        new = physics.phi(t, x, z, u, physics.parameters)
        unsettled = np.abs(new.real - z.real) > ALGEBRAIC_TOLERANCE * np.maximum(np.abs(new.real), scale)
        if np.iscomplexobj(new):
            largest = np.max(np.abs(new.imag), axis=-1, keepdims=True)
            unsettled |= np.abs(new.imag - z.imag) > ALGEBRAIC_TOLERANCE * largest
        z = new
        if not np.any(unsettled):
            return z
    culprits = [s.name for s, bad in zip(physics.algebraic, np.any(unsettled.reshape(-1, z.shape[-1]), 0), strict=True) if bad]
    raise ArithmeticError(
        f"the algebraic variables {', '.join(culprits)} of {physics.name!r} did not settle in {MAX_SWEEPS} sweeps; "
        "write phi so that its sweeps contract, or start from other nominal values"
    )


@dataclass(frozen=True, eq=False)
class Integrated:
    """The functions of a plant that integrates physics with N sensors and p parameters that are not known exactly.

    picks (N,): positions among the states and algebraic variables. unknown (p,): names of the parameters. Real numbers take the
    straight-line program of f and phi, where it can be recorded; others, such as complex ones, f and phi themselves.
    """

    physics: Physics
    picks: Array
    substeps: int
    decay: Array | None
    unknown: tuple[str, ...] = ()

    @cached_property
    def nominal(self) -> Array:
        """Values of the parameters `unknown` (p,) in the physics."""
        return np.array([getattr(self.physics.parameters, name) for name in self.unknown])

    @cached_property
    def program(self) -> Program | None:
        """The program of f and phi; None where they cannot be recorded."""
        physics = self.physics
        f, phi = (partial(_by_theta, g, self.unknown, physics.parameters) for g in (physics.f, physics.phi))
        usual = [np.array([s.nominal for s in group]) for group in (physics.states, physics.algebraic, physics.inputs)]
        return record(f, None if physics.phi is None else phi, [*usual, self.nominal])

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """Rates of decay, empty for Runge-Kutta 4, and nominal values of the algebraic variables."""
        return (
            np.empty(0) if self.decay is None else np.array(self.decay, dtype=float),
            np.array([s.nominal for s in self.physics.algebraic], dtype=float),
        )

    def slope(self, t: float, x: Array, u: Array) -> Array:
        return self.physics.f(t, x, solve_algebraic(self.physics, t, x, u), u, self.physics.parameters)

    def step_at(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        if (found := self._advanced(t_start, x, u, dt, theta, 0)) is not None:
            return found
        return self._at(theta)._step(t_start, _of_batch(x, theta), u, dt)

    def _step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        part = dt / self.substeps
        for i in range(self.substeps):
            if self.decay is None:
                x = runge_kutta_4(lambda s, p: self.slope(s, p, u), t_start + i * part, x, part)
            else:
                x = exponential_midpoint(lambda s, p: self.slope(s, p, u), t_start + i * part, x, part, self.decay)
        return x

    def output_at(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        if (found := self._read(t, x, u, theta, 0)) is not None:
            return found
        return self._at(theta)._output(t, _of_batch(x, theta), u)

    def _output(self, t: float, x: Array, u: Array) -> Array:
        z = solve_algebraic(self.physics, t, x, u)
        return np.concatenate([np.broadcast_to(x, (*z.shape[:-1], x.shape[-1])), z], axis=-1)[..., self.picks]

    def step_jacobian_at(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        """Derivatives (..., n, n + m + p) with respect to x, u and theta; of a program."""
        return self._required(
            self._advanced(t_start, x, u, dt, theta, x.shape[-1] + u.shape[-1] + theta.shape[-1]), t_start, x, u
        )

    def output_jacobian_at(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        """The same of the readings (..., N, n + m + p)."""
        return self._required(self._read(t, x, u, theta, x.shape[-1] + u.shape[-1] + theta.shape[-1]), t, x, u)

    def _required(self, found: Array | None, t: float, x: Array, u: Array) -> Array:
        """What has been found; otherwise the ArithmeticError of the algebraic variables that do not settle."""
        if found is None:
            complex_step_jacobian(lambda p: solve_algebraic(self.physics, t, p, np.expand_dims(u, -2)), x)
            raise ArithmeticError(f"the algebraic variables of {self.physics.name!r} do not settle within a step")
        return found

    def _advanced(self, t: float, x: Array, u: Array, dt: float, theta: Array, width: int) -> Array | None:
        """The step by the program, where width is 0, or its derivatives (..., n, width); None without one."""
        if (program := self.program) is None or not all(map(_real, (x, u, theta))):
            return None
        batch, x, u, theta = _as_rows(x, u, theta)
        decay, nominal = self._constants
        ahead, tangent, settled = straight_line_kernels.advance(
            float(t), x, u, theta, float(dt), self.substeps, decay, nominal, width, program
        )
        found: Array = tangent if width else ahead
        return found.reshape(*batch, *found.shape[1:]) if settled else None

    def _read(self, t: float, x: Array, u: Array, theta: Array, width: int) -> Array | None:
        """The same of the readings (..., N)."""
        if (program := self.program) is None or not all(map(_real, (x, u, theta))):
            return None
        batch, x, u, theta = _as_rows(x, u, theta)
        y, by, settled = straight_line_kernels.read(float(t), x, u, theta, self.picks, self._constants[1], width, program)
        found: Array = by if width else y
        return found.reshape(*batch, *found.shape[1:]) if settled else None

    def _at(self, theta: Array) -> Integrated:
        if theta is self.nominal:
            return self
        values = {name: theta[..., j] for j, name in enumerate(self.unknown)}
        return replace(self, physics=replace(self.physics, parameters=self.physics.parameters._replace(**values)))


@dataclass(frozen=True, eq=False)
class IntegratedStep:
    """The step of a plant, with its own Jacobian where it is a program."""

    model: Integrated

    def __call__(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        return self.model.step_at(t_start, x, u, dt, self.model.nominal)

    @property
    def jacobian(self) -> Callable[[float, Array, Array, float], Array] | None:
        return None if self.model.program is None else self._jacobian

    def _jacobian(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        model = self.model
        return model._required(model._advanced(t_start, x, u, dt, model.nominal, x.shape[-1]), t_start, x, u)


@dataclass(frozen=True, eq=False)
class IntegratedOutput:
    """The output of a plant, with its own Jacobian where it is a program."""

    model: Integrated

    def __call__(self, t: float, x: Array, u: Array) -> Array:
        return self.model.output_at(t, x, u, self.model.nominal)

    @property
    def jacobian(self) -> Callable[[float, Array, Array], Array] | None:
        return None if self.model.program is None else self._jacobian

    def _jacobian(self, t: float, x: Array, u: Array) -> Array:
        model = self.model
        return model._required(model._read(t, x, u, model.nominal, x.shape[-1]), t, x, u)


def _by_theta(function: Any, unknown: tuple[str, ...], c: Any, t: float, x: Array, z: Array, u: Array, theta: Array) -> Array:
    """Evaluate f or phi with other values theta (..., p) of the parameters `unknown`."""
    values = {name: theta[..., j][()] for j, name in enumerate(unknown)}
    found: Array = function(t, x, z, u, c._replace(**values) if unknown else c)
    return found


def _real(a: Array) -> bool:
    """Whether this is an array of real numbers, not one that records what is done with it."""
    return type(a) is np.ndarray and a.dtype.kind != "c"


def _as_rows(x: Array, u: Array, theta: Array) -> tuple[tuple[int, ...], Array, Array, Array]:
    """The batch of arrays (..., n) and each as a matrix (B, n), or (1, n) where it is the same for the whole batch."""
    shapes = {a.shape[:-1] for a in (x, u, theta) if a.ndim > 1}
    batch = shapes.pop() if len(shapes) == 1 else np.broadcast_shapes(*shapes)
    return batch, _rows(x, batch), _rows(u, batch), _rows(theta, batch)


def _rows(a: Array, batch: tuple[int, ...]) -> Array:
    if a.shape[:-1] not in ((), batch):
        a = np.broadcast_to(a, (*batch, a.shape[-1]))
    rows = a.reshape(1 if a.ndim == 1 else math.prod(batch), a.shape[-1])
    ready = rows.flags.c_contiguous and rows.flags.writeable and rows.dtype == np.float64
    return rows if ready else np.array(rows, dtype=float)  # one type of arguments, so that nothing is compiled twice


def _of_batch(x: Array, theta: Array) -> Array:
    """States x (..., n) with the batch of the parameters theta (..., p), too."""
    return np.broadcast_to(x, (*np.broadcast_shapes(x.shape[:-1], theta.shape[:-1]), x.shape[-1]))


def _require_rates(physics: Physics, x0: Array, u: Array) -> None:
    """Raise ValueError unless f and phi give one number for each state and algebraic variable: RK4 would broadcast others."""
    x = np.broadcast_to(x0, (2, 1, x0.size)).copy()
    z = np.broadcast_to([s.nominal for s in physics.algebraic], (2, 1, len(physics.algebraic))).astype(float)
    for what, like, kind in (("phi", z, "algebraic variable"), ("f", x, "state")):
        function = getattr(physics, what)
        if function is None:
            continue
        try:
            with np.errstate(all="ignore"):
                found = np.shape(function(0.0, x, z, u[None], physics.parameters))
        except ArithmeticError:
            continue  # fails at x0: left to the runs
        fits = found[-1:] == like.shape[-1:] and len(found) <= 3 and np.broadcast_shapes(found, like.shape) == like.shape
        if not fits:
            raise ValueError(
                f"{what} of {physics.name!r} gives shape {found} for states {x.shape}; expected {like.shape}: one number for "
                f"each {kind}, with a batch as leading axes (np.stack([...], axis=-1))"
            )


def largest_step(model: Integrated, dt: float, x0: Array, scale: Array, u: Array) -> float:
    """Largest step (s) for which a step's noise is that of the process: max(dt, 0.1 / |D^-1 A D|), A = df/dx at x0.

    A step dt' adds Q dt' to the covariance; the physics adds the integral of exp(A s) Q exp(A' s) over the step. To first order
    they differ by (A Q + Q A') dt'^2 / 2, at most |D^-1 A D| dt' of Q in units D = diag(scale) of the states. With 0.1 that is
    a tenth of the variance, a twentieth of sigma. The error of a substep of Runge-Kutta 4 is then 0.1^5 / 120 of a deviation,
    far within its stability (2.78). The result is inf for a pure integrator, whose noise is exact. A dt that the user chose is
    always admitted.
    """
    with np.errstate(all="ignore"):
        try:
            a = difference_jacobian(lambda p: model.slope(0.0, p, u), x0, scale)
        except ArithmeticError:
            return dt
        change = a / scale[:, None] * scale
        if not np.all(np.isfinite(change)):
            return dt
        return float(np.maximum(dt, LARGEST_CHANGE / np.linalg.norm(change, 2)))


def discretise(
    physics: Physics,
    sensors: Sequence[Sensor],
    *,
    dt: float,
    x0: Array = FROM_STATES,
    initial_cov: Array = FROM_STATES,
    process_cov: Array = FROM_STATES,
    substeps: int = 1,
    process_bound: Array | None = None,
    operation: Callable[[float], Array] | None = None,
    decay: Array | None = None,
    max_dt: float | None = None,
    unknown: Sequence[Parameter] = (),
    input_errors: Mapping[str, float] | None = None,
) -> Plant:
    """Return the plant that integrates physics by RK4 with held inputs; each sensor reads a state or an algebraic variable.

    x0 (n,), covariances (n,) or (n, n) in SI, by default from the signals of the states as in `Plant`; dt in seconds, divided
    into `substeps`. decay: rates a (n,) of states that follow x' = -a x + h, in 1/s; with them the plant is integrated by the
    exponential midpoint rule. max_dt: the longest step at once (s), None for `largest_step`; `diagnose` divides longer gaps
    into steps of dt. process_bound, operation: as in `Plant` and `Truth`. unknown: those of physics.parameters that are not
    known exactly, by their names; f and phi then get each as an array (...) of the batch. input_errors: as `inputs` of
    `Uncertainty`. Raises ValueError for a sensor of an unknown variable, f or phi of another shape, less than one substep, a
    rate that is not positive and an unknown parameter that physics.parameters does not have.
    """
    if substeps < 1:
        raise ValueError(f"substeps is {substeps}; a step of {physics.name!r} takes at least 1")
    names = [s.name for s in (*physics.states, *physics.algebraic)]
    if wrong := [s.name for s in sensors if s.measures not in names]:
        raise ValueError(f"sensors {', '.join(wrong)} measure no variable of {physics.name!r}; variables: {', '.join(names)}")
    picks = np.array([names.index(s.measures) for s in sensors])
    n = len(physics.states)
    if decay is not None and not (np.shape(decay) == (n,) and np.all(np.isfinite(decay)) and np.all(decay > 0)):
        raise ValueError(f"decay of {physics.name!r} is {decay}; expected {n} positive rates in 1/s, one a state")
    model = Integrated(physics, picks, substeps, decay, _names_of(physics, tuple(unknown)))
    x0 = floats(f"x0 of {physics.name!r}", [s.nominal for s in physics.states] if x0 is None else x0)
    u = np.array([s.nominal for s in physics.inputs]) if operation is None else floats("the input of operation", operation(0.0))
    fits = x0.shape == (n,) and u.shape == (len(physics.inputs),)  # Plant refuses what does not
    if fits:
        _require_rates(physics, x0, u)
    only_states = bool(np.all(picks < n))
    selection = np.eye(n)[picks[picks < n]]
    plant = Plant(
        name=physics.name,
        states=physics.states,
        inputs=physics.inputs,
        sensors=tuple(sensors),
        step=IntegratedStep(model),
        output=partial(picked, picks) if only_states else IntegratedOutput(model),
        dt=dt,
        x0=x0,
        initial_cov=initial_cov,
        process_cov=process_cov,
        process_bound=process_bound,
        numerics=Numerics(
            output_jacobian=partial(constant, selection) if only_states else None,
            max_dt=np.inf if max_dt is None else number("max_dt", max_dt),
        ),
        truth=Truth(operation=operation),
        uncertainty=_uncertainty(model, tuple(unknown), input_errors or {}),
    )
    if max_dt is not None:
        return plant
    longest = largest_step(model, dt, x0, plant.state_scale, u)
    return replace(plant, numerics=replace(plant.numerics, max_dt=longest))


def _names_of(physics: Physics, unknown: tuple[Parameter, ...]) -> tuple[str, ...]:
    """The names of the parameters; ValueError for those that the physics does not have, or at another value."""
    c = physics.parameters
    for p in unknown:
        fields = getattr(c, "_fields", ())
        if p.name not in fields:
            raise ValueError(
                f"unknown has {p.name!r}, which the parameters of {physics.name!r} do not; they are "
                f"{', '.join(fields) or 'no NamedTuple'}"
            )
        if getattr(c, p.name) != p.nominal:
            raise ValueError(
                f"parameter {p.name!r} is nominally {p.nominal}, but {getattr(c, p.name)} in the physics; give both alike"
            )
    return tuple(p.name for p in unknown)


def _uncertainty(model: Integrated, unknown: tuple[Parameter, ...], input_errors: Mapping[str, float]) -> Uncertainty:
    """The model at other values of its physics' parameters."""
    if not (unknown or input_errors):
        return Uncertainty()
    recorded = model.program is not None
    return Uncertainty(
        unknown,
        model.step_at if unknown else None,
        model.output_at if unknown else None,
        model.step_jacobian_at if recorded else None,
        model.output_jacobian_at if recorded else None,
        inputs=input_errors,
    )
