"""The functions of a plant that an FMU gives: step, output and their derivatives, for batches, which are looped over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import difference_jacobian
from fusion_sfdia.plant.augment import joined
from fusion_sfdia.plant.fmu.handle import Fmu

Array = NDArray[Any]


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
