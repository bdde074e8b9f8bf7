"""Physics advanced over a step: algebraic variables, Runge-Kutta 4 and the exponential midpoint rule, and their derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.any_time import ANY_TIME
from fusion_sfdia.derivatives import straight_line_kernels
from fusion_sfdia.derivatives.equation import complex_step_jacobian, plain
from fusion_sfdia.derivatives.straight_line import Program, record, uses
from fusion_sfdia.derivatives.straight_line_kernels import ALGEBRAIC_TOLERANCE, MAX_SWEEPS
from fusion_sfdia.plant.physics import Physics

Array = NDArray[Any]


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
            return found[0]
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
            return found[0]
        return self._at(theta)._output(t, _of_batch(x, theta), u)

    def _output(self, t: float, x: Array, u: Array) -> Array:
        z = solve_algebraic(self.physics, t, x, u)
        return np.concatenate([np.broadcast_to(x, (*z.shape[:-1], x.shape[-1])), z], axis=-1)[..., self.picks]

    def step_and_jacobian_at(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> tuple[Array, Array]:
        """`step_at`, and its derivatives (..., n, n + m + p) with respect to x, u and theta; of a program."""
        return self._required(self._advanced(t_start, x, u, dt, theta, _all(x, u, theta)), t_start, x, u)

    def output_and_jacobian_at(self, t: float, x: Array, u: Array, theta: Array) -> tuple[Array, Array]:
        """The same of the readings, (..., N) and (..., N, n + m + p)."""
        return self._required(self._read(t, x, u, theta, _all(x, u, theta)), t, x, u)

    def _required(self, found: tuple[Array, Array] | None, t: float, x: Array, u: Array) -> tuple[Array, Array]:
        """What has been found; otherwise the ArithmeticError of the algebraic variables that do not settle."""
        if found is None:
            complex_step_jacobian(lambda p: solve_algebraic(self.physics, t, p, np.expand_dims(u, -2)), x)
            raise ArithmeticError(f"the algebraic variables of {self.physics.name!r} do not settle within a step")
        return found

    def _advanced(self, t: float, x: Array, u: Array, dt: float, theta: Array, width: int) -> tuple[Array, Array] | None:
        """The step by the program and its derivatives (..., n, width); None without one."""
        return self._found(t, (x, u, theta), (float(dt), self.substeps, np.arange(x.shape[-1])), width)

    def _read(self, t: float, x: Array, u: Array, theta: Array, width: int) -> tuple[Array, Array] | None:
        """The same of the readings (..., N)."""
        return self._found(t, (x, u, theta), (0.0, 0, self.picks), width)

    def _found(
        self, t: float, values: tuple[Array, Array, Array], step: tuple[float, int, Array], width: int
    ) -> tuple[Array, Array] | None:
        """The variables that a step over some time, in substeps, ends with, by their places; None without a program."""
        if (program := self.program) is None or not all(map(_real, values)):
            return None
        batch, x, u, theta = _as_rows(*values)
        dt, substeps, picks = step
        found, by, settled = straight_line_kernels.advance(
            self._number(t), x, u, theta, dt, substeps, *self._constants, program, picks, width
        )
        return _of_shape(batch, found, by) if settled else None

    @cached_property
    def _timeless(self) -> bool:
        return self.program is not None and not uses(self.program, 0)

    def _number(self, t: Any) -> float:
        """The time t (s) for the program: of any time 0, where it does not use it."""
        return 0.0 if t is ANY_TIME and self._timeless else float(t)

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
        return self.with_jacobian(t_start, x, u, dt)[1]

    def with_jacobian(self, t_start: float, x: Array, u: Array, dt: float) -> tuple[Array, Array]:
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
        return self.with_jacobian(t, x, u)[1]

    def with_jacobian(self, t: float, x: Array, u: Array) -> tuple[Array, Array]:
        model = self.model
        return model._required(model._read(t, x, u, model.nominal, x.shape[-1]), t, x, u)


def _by_theta(function: Any, unknown: tuple[str, ...], c: Any, t: float, x: Array, z: Array, u: Array, theta: Array) -> Array:
    """Evaluate f or phi with other values theta (..., p) of the parameters `unknown`."""
    values = {name: theta[..., j][()] for j, name in enumerate(unknown)}
    found: Array = function(t, x, z, u, c._replace(**values) if unknown else c)
    return found


def _all(x: Array, u: Array, theta: Array) -> int:
    """The number of derivatives with respect to all of these."""
    return int(x.shape[-1] + u.shape[-1] + theta.shape[-1])


def _of_shape(batch: tuple[int, ...], value: Array, by: Array) -> tuple[Array, Array]:
    """Value (B, n) and derivatives (B, n, w) of the batch."""
    if len(batch) == 1:
        return value, by
    return value.reshape(*batch, *value.shape[1:]), by.reshape(*batch, *by.shape[1:])


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
    return plain(a if a.ndim == 2 else a.reshape(1 if a.ndim == 1 else math.prod(batch), a.shape[-1]))


def _of_batch(x: Array, theta: Array) -> Array:
    """States x (..., n) with the batch of the parameters theta (..., p), too."""
    return np.broadcast_to(x, (*np.broadcast_shapes(x.shape[:-1], theta.shape[:-1]), x.shape[-1]))
