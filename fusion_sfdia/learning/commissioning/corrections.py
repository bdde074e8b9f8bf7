"""A plant at other values of what it does not know: its parameters, errors of its inputs, offsets along directions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.secants import secants
from fusion_sfdia.plant.uncertainty import Uncertainty

Array = NDArray[Any]

STEPS = 4  # of Newton: values change by a few per cent, and each step squares the relative error


def at_values(plant: Plant, theta: Array, sd: Array) -> Plant:
    """The plant at the values theta (p,) of its parameters, with the standard deviations sd (p,), in their units.

    It is built anew where the plant states how; the noise, the sensors and the spread of the first state stay.
    """
    known = plant.uncertainty
    parameters = tuple(
        replace(p, nominal=float(value), sd=float(spread)) for p, value, spread in zip(known.parameters, theta, sd, strict=True)
    )
    if known.rebuild is not None:
        rebuild = partial(known.rebuild, **{p.name: p.nominal for p in parameters})
        other = rebuild()
        there = replace(plant, step=other.step, output=other.output, x0=other.x0, numerics=other.numerics)
        stated = {"inputs": known.inputs, "disturbances": known.disturbances, "considered": known.considered}
        return replace(there, uncertainty=secants(there, parameters, rebuild, at_rest=known.at_rest, **stated))
    fixed = _Fixed(known, np.asarray(theta, dtype=float), len(plant.states))
    there = replace(
        plant,
        step=fixed.step,
        output=plant.output if known.output is None else fixed.output,
        numerics=replace(
            plant.numerics,
            step_jacobian=None if known.step_jacobian is None else fixed.step_jacobian,
            output_jacobian=plant.numerics.output_jacobian if known.output_jacobian is None else fixed.output_jacobian,
        ),
        uncertainty=replace(known, parameters=parameters),
    )
    return replace(there, x0=_rest(there)) if known.at_rest else there


def _rest(plant: Plant) -> Array:
    """The steady state (n,) near x0 under the usual input, by Newton's method."""
    x, u = plant.x0, plant.input_at(0.0)
    for _ in range(STEPS):
        slope = plant.step_jacobian_at(0.0, x, u, plant.dt) - np.eye(x.size)
        x, _ = plant.guard(x - np.linalg.solve(slope, plant.step(0.0, x, u, plant.dt) - x))
    return x


@dataclass(frozen=True, eq=False)
class _Fixed:
    """The functions of a plant of n states at the values theta (p,) of its parameters."""

    known: Uncertainty
    theta: Array
    n: int

    def step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        assert self.known.step is not None
        return self.known.step(t_start, x, u, dt, self._at(x))

    def output(self, t: float, x: Array, u: Array) -> Array:
        assert self.known.output is not None
        return self.known.output(t, x, u, self._at(x))

    def step_jacobian(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        assert self.known.step_jacobian is not None
        return self.known.step_jacobian(t_start, x, u, dt, self._at(x))[..., : self.n]

    def output_jacobian(self, t: float, x: Array, u: Array) -> Array:
        assert self.known.output_jacobian is not None
        return self.known.output_jacobian(t, x, u, self._at(x))[..., : self.n]

    def _at(self, x: Array) -> Array:
        return np.broadcast_to(self.theta, (*x.shape[:-1], self.theta.size))


@dataclass(frozen=True, eq=False)
class ConstantCorrection:
    """Constant corrections of a model: of its inputs (m,), its states (n,) over one nominal dt, its readings (N,).

    x+ = f(x, u + input, dt) + state dt / dt_nominal,    y = h(x, u + input) + reading.
    """

    input: Array
    state: Array
    reading: Array
    dt: float

    def step(self, step: Callable[..., Array], t_start: float, x: Array, u: Array, dt: float, *theta: Array) -> Array:
        return step(t_start, x, u + self.input, dt, *theta) + self.state * (dt / self.dt)

    def output(self, output: Callable[..., Array], t: float, x: Array, u: Array, *theta: Array) -> Array:
        return output(t, x, u + self.input, *theta) + self.reading

    def of_step(self, function: Callable[..., Array], t_start: float, x: Array, u: Array, dt: float, *theta: Array) -> Array:
        """A Jacobian of the step."""
        return function(t_start, x, u + self.input, dt, *theta)

    def of_output(self, function: Callable[..., Array], t: float, x: Array, u: Array, *theta: Array) -> Array:
        """A Jacobian of the output."""
        return function(t, x, u + self.input, *theta)


def with_offset(plant: Plant, offset: ConstantCorrection) -> Plant:
    """The plant with constant corrections, at all values of its parameters."""
    known, (of_step, of_output) = plant.uncertainty, plant.jacobians
    uncertainty = replace(
        known,
        step=known.step and partial(offset.step, known.step),
        output=known.output and partial(offset.output, known.output),
        step_jacobian=known.step_jacobian and partial(offset.of_step, known.step_jacobian),
        output_jacobian=known.output_jacobian and partial(offset.of_output, known.output_jacobian),
        rebuild=known.rebuild and partial(_rebuilt, known.rebuild, offset),
    )
    numerics = replace(
        plant.numerics,
        step_jacobian=of_step and partial(offset.of_step, of_step),
        output_jacobian=of_output and partial(offset.of_output, of_output),
    )
    return replace(
        plant,
        step=partial(offset.step, plant.step),
        output=partial(offset.output, plant.output),
        numerics=numerics,
        uncertainty=uncertainty,
    )


def _rebuilt(rebuild: Callable[..., Plant], offset: ConstantCorrection, **values: float) -> Plant:
    return with_offset(rebuild(**values), offset)
