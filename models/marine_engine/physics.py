"""The physics of the marine engine before discretisation: the scalar equations on arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.marine_engine import equations
from fusion_sfdia.models.marine_engine.equations import ALGEBRAIC, CONSTANT_SLIP, EQUATIONS, STATES, EngineParameters
from fusion_sfdia.models.marine_engine.equilibrium import LOADS, engine_variables, follows_law
from fusion_sfdia.plant.physics import Physics
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

UNIT = {"f": "kg", "p": "Pa", "T": "K", "t": "N m"}


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
        inputs=(
            Signal(
                "fuel_setting",
                "1",
                load,
                *LOADS,
                meaning="setting of the fuel rack",
                check="Check the fuel rack, its position feedback, the injection pump and the injectors.",
            ),
        ),
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
