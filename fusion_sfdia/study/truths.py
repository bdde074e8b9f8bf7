"""The plant that makes the readings, where it differs from the model: parameters, inputs and equations, over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.plant import Numerics, Plant, Structure
from fusion_sfdia.plant.uncertainty import Uncertainty, error_of

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
