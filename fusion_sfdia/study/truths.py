"""The plant that makes the readings, where it differs from the model: parameters, inputs and equations, over time.

Each stands for the high-fidelity model of a plant, where it has one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import difference_jacobian
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.plant import Numerics, Plant, Structure
from fusion_sfdia.plant.uncertainty import Disturbance, Uncertainty, error_of

Array = NDArray[Any]

PULSE = 20  # rows
PROFILES = ("constant", "pulse", "step", "ramp")


class Unknown(NamedTuple):
    """Something that a plant declares as uncertain, a parameter or the error of an input, and from which size a later change of
    it counts (standard deviations of `Uncertainty.changes` where the plant states them), in its unit.
    """

    name: str
    sd: float
    change: float


def declared(plant: Plant) -> tuple[Unknown, ...]:
    """The parameters and errors of inputs that a plant declares, frozen ones too."""
    known = plant.uncertainty
    named = [*((p.name, p.sd) for p in known.parameters), *((error_of(name), sd) for name, sd in known.inputs.items())]
    return tuple(Unknown(name, sd, known.changes.get(name, sd)) for name, sd in named)


class Variation(NamedTuple):
    """A difference of the real plant from the model: of what, how far at most, and from when on.

    of: the name of an `Unknown`. size: in its unit. profile: "constant" from the start, else from `onset` (s) for `length` (s):
    a "pulse" of `PULSE` steps, a "step", or a "ramp" that reaches the size at its end and goes back at once.
    """

    of: str
    size: float
    profile: str = "constant"
    onset: float = 0.0
    length: float = np.inf

    def at(self, t: float, dt: float) -> float:
        """The difference in the step that begins at t (s)."""
        since = t - self.onset + 1e-9 * dt
        if self.profile == "constant":
            return self.size
        length = PULSE * dt if self.profile == "pulse" else self.length
        if not 0 <= since < length:
            return 0.0
        return self.size * min((since + dt) / length, 1.0) if self.profile == "ramp" else self.size


@dataclass(frozen=True, eq=False)
class _Varied:
    """Step and output of a plant with variations, and one state whose rate is a factor of that of its equation."""

    plant: Plant
    variations: tuple[Variation, ...]
    rates: Array = field(default_factory=lambda: np.ones(()))  # (n,) or 1

    @cached_property
    def names(self) -> tuple[list[str], list[str]]:
        """Of the parameters, and of the errors of the inputs."""
        return [p.name for p in self.plant.uncertainty.parameters], [error_of(s.name) for s in self.plant.inputs]

    def _at(self, t: float) -> tuple[Array, Array]:
        """The parameters theta (p,), within their limits, and the errors of the inputs (m,)."""
        parameters, errors = self.names
        off = dict.fromkeys([*parameters, *errors], 0.0)
        for v in self.variations:
            off[v.of] += v.at(t, self.plant.dt)
        theta = [min(max(p.nominal + off[p.name], p.low), p.high) for p in self.plant.uncertainty.parameters]
        return np.array(theta), np.array([off[name] for name in errors])

    def step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        theta, errors = self._at(t_start)
        at = self.plant.uncertainty.step
        acting = u + errors
        ahead = self.plant.step(t_start, x, acting, dt) if at is None else at(t_start, x, acting, dt, theta)
        return np.asarray(x + self.rates * (ahead - x))

    def output(self, t: float, x: Array, u: Array) -> Array:
        theta, errors = self._at(t - self.plant.dt)
        at = self.plant.uncertainty.output
        return self.plant.output(t, x, u + errors) if at is None else at(t, x, u + errors, theta)


def varied(plant: Plant, variations: Sequence[Variation], rates: Array | None = None) -> Plant:
    """The plant that differs by these variations; rates (n,): factors on what each state changes in a step.

    ValueError for the name of nothing that the plant declares.
    """
    known = [u.name for u in declared(plant)]
    if unknown := [v.of for v in variations if v.of not in known]:
        raise ValueError(
            f"plant {plant.name!r} declares no {unknown[0]!r} as uncertain; declared: {', '.join(known) or 'nothing'}"
        )
    model = _Varied(plant, tuple(variations), np.ones(()) if rates is None else np.asarray(rates, float))
    return replace(
        plant,
        step=model.step,
        output=model.output,
        numerics=Numerics(max_dt=plant.numerics.max_dt, fixed_dt=plant.numerics.fixed_dt),
        structure=Structure(),
        uncertainty=Uncertainty(),
    )


def finest(plant: Plant) -> Plant:
    """The high-fidelity model of a plant in the plant's operation, or the plant itself where it has none."""
    model = plant if plant.truth.finer is None else plant.truth.finer()[0]
    return replace(model, truth=replace(model.truth, finer=None, operation=plant.truth.operation))


def trending(first: Plant, last: Plant, seconds: float) -> Plant:
    """A plant that is `first` at 0 s and changes steadily into `last`, which it is from `seconds` on.

    f = (1 - w) f_first + w f_last and h alike, w = t / seconds: parameters that go from the one to the other, exactly where
    the model is linear in them.
    """
    if not 0 < seconds < np.inf:
        raise ValueError(f"a plant changes within {seconds} s; expected a positive time")
    start, end = finest(first), finest(last)
    model = _Trend(start, end, seconds)
    numerics = replace(start.numerics, step_jacobian=None, output_jacobian=None)
    return replace(start, step=model.step, output=model.output, numerics=numerics, structure=Structure())


@dataclass(frozen=True, eq=False)
class _Trend:
    """The functions of a plant that changes."""

    first: Plant
    last: Plant
    seconds: float

    def share(self, t: float) -> float:
        return float(np.clip(t / self.seconds, 0.0, 1.0))

    def step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        w = self.share(t_start)
        return (1 - w) * self.first.step(t_start, x, u, dt) + w * self.last.step(t_start, x, u, dt)

    def output(self, t: float, x: Array, u: Array) -> Array:
        w = self.share(t)
        return (1 - w) * self.first.output(t, x, u) + w * self.last.output(t, x, u)


def fluctuating(make: Callable[[], Plant], spread: Mapping[str, float], time_constant: float) -> Plant:
    """A plant whose acting inputs differ from the known ones by coloured noise.

    make(): the plant. spread: the standard deviation of the noise by the name of the input, in the input's unit, small: its
    effect on states and readings is taken as linear about x0. time_constant (s): of its correlation
    exp(-|t| / time_constant). Each input has its own noise, which starts from 0. ValueError for an unknown input.
    """
    plant = make()
    model, known = finest(plant), [s.name for s in plant.inputs]
    if unknown := [name for name in spread if name not in known]:
        raise ValueError(f"plant {plant.name!r} has no input {', '.join(unknown)}; its inputs: {', '.join(known)}")
    u = plant.input_at(0.0)
    sd = np.array([spread.get(name, 1.0) for name in known])
    state = difference_jacobian(partial(_step_of_input, model), u, sd)
    reading = difference_jacobian(partial(_output_of_input, model), u, sd)
    disturbances = [
        Disturbance(f"noise of {name}", state[:, j], reading[:, j], spread[name], time_constant)
        for j, name in enumerate(known)
        if name in spread
    ]
    quiet = model.process_cov if plant.truth.disturbed else np.zeros_like(model.process_cov)
    alone = replace(model, process_cov=quiet, process_bound=None, uncertainty=Uncertainty(disturbances=tuple(disturbances)))
    found = augment(alone)
    return replace(found, truth=replace(found.truth, disturbed=True))


def _step_of_input(plant: Plant, u: Array) -> Array:
    return plant.step(0.0, np.broadcast_to(plant.x0, (*u.shape[:-1], plant.x0.size)), u, plant.dt)


def _output_of_input(plant: Plant, u: Array) -> Array:
    return plant.output(0.0, np.broadcast_to(plant.x0, (*u.shape[:-1], plant.x0.size)), u)


def double_spread(plant: Callable[[], Plant], rebuild: Callable[..., Plant], names: Sequence[str] | None = None) -> Plant:
    """A plant whose uncertain parameters of these names are two standard deviations off, in turn above and below.

    plant(): what states them; rebuild(**values): the plant at other values. names: None for all. ValueError for a name that
    it does not state.
    """
    made = plant()
    known = {p.name: p for p in made.uncertainty.parameters}
    names = tuple(known) if names is None else names
    if unknown := [name for name in names if name not in known]:
        raise ValueError(
            f"plant {made.name!r} states no spread of {', '.join(unknown)}; it does of {', '.join(known) or 'none'}"
        )
    return rebuild(**{name: known[name].nominal + 2.0 * (-1) ** j * known[name].sd for j, name in enumerate(names)})
