"""What is not known of a power network: slopes of ties, inertias, droops, and errors of references and loads.

Area by area the parameters of an area change its rows [F_i, b_i, g_i] alone, so that derivatives are three numbers an area:
those of the stiffness, the inertia and the droop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.differentiable import Differentiable
from fusion_sfdia.derivatives.equation import plain
from fusion_sfdia.models.power_network import equations
from fusion_sfdia.models.power_network.model import NetworkModel
from fusion_sfdia.models.power_network.operation import NetworkCondition
from fusion_sfdia.models.power_network.parameters import SLOPE_UNIT, UNITS, NetworkParameters
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.secants import secants
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty, by_states_alone

Array = NDArray[Any]

INERTIA, DROOP = 0, 1  # columns of the areas' constants
SPREAD = {  # standard deviation over the value, its change within an hour, source
    "slope": (0.07, 0.02, "the cosine of the angle of a loaded tie and its voltages, 5 % each; our choice"),
    "inertia": (0.15, 0.02, "that of the units in operation: one of several may be off; our choice"),
    "droop": (0.15, 0.0, "governors as set and as they act differ by dead bands and limits; our choice"),
}
LOAD = 0.02  # per unit: standard deviation of what is not metered of an area's load; our choice
REFERENCE = 0.005  # per unit, of how units follow their set points; our choice


MEANING = {  # of each kind of parameter, and what to check
    "slope": ("stiffness", "Check which lines of the tie are in service."),
    "inertia": ("inertia", "Check which units are on line."),
    "droop": ("droop", "Check the governor settings, and which units are on governor control."),
}


def unknown_parameters(c: NetworkParameters) -> tuple[Parameter, ...]:
    """Slopes of the ties, then inertias, then droops of the areas."""
    names = c.topology.names
    ties = [f"slope_{names[i]}-{names[j]}" for i, j in c.topology.links]
    values = [
        *(("slope", tie, SLOPE_UNIT, value) for tie, value in zip(ties, c.slope, strict=True)),
        *(("inertia", f"inertia_{i}", UNITS["inertia"], v) for i, v in zip(names, c.constants[:, INERTIA], strict=True)),
        *(("droop", f"droop_{i}", UNITS["droop"], v) for i, v in zip(names, c.constants[:, DROOP], strict=True)),
    ]
    where = [
        f"tie {n.removeprefix('slope_')}" if kind == "slope" else f"area {n.partition('_')[2]}" for kind, n, _, _ in values
    ]
    tiny = np.finfo(float).tiny
    return tuple(
        Parameter(
            name,
            unit,
            float(v),
            SPREAD[kind][0] * float(v),
            SPREAD[kind][1] * float(v),
            source=SPREAD[kind][2],
            low=tiny,
            meaning=f"{MEANING[kind][0]} of {place}",
            check=MEANING[kind][1],
        )
        for (kind, name, unit, v), place in zip(values, where, strict=True)
    )


def altered(c: NetworkParameters, **values: float) -> NetworkParameters:
    """The network with other values of parameters, by the names of `unknown_parameters`."""
    theta = np.array([values.get(p.name, p.nominal) for p in unknown_parameters(c)])
    e, n = c.slope.size, len(c.topology.names)
    constants = c.constants.copy()
    constants[:, INERTIA], constants[:, DROOP] = theta[e : e + n], theta[e + n :]
    return replace(c, slope=theta[:e], constants=constants)


def network_uncertainty(c: NetworkParameters, condition: Callable[[float], NetworkCondition], readout: Array) -> Uncertainty:
    """What a plant of the healthy network, discretised area by area, does not know; readout (N, n): H of its sensors."""
    at = _Areas(c, condition)
    step = Differentiable(at.step, at.step_and_jacobian)
    return Uncertainty(unknown_parameters(c), step, None, step.jacobian, partial(_readout, readout), inputs=_input_errors(c))


def rebuilt_uncertainty(plant: Plant, c: NetworkParameters, build: Callable[[NetworkParameters], Plant]) -> Uncertainty:
    """The same of a plant that build(parameters) makes, by secants."""
    return secants(plant, unknown_parameters(c), partial(_rebuilt, build, c), inputs=_input_errors(c))


def _rebuilt(build: Callable[[NetworkParameters], Plant], c: NetworkParameters, **values: float) -> Plant:
    return build(altered(c, **values))


def _input_errors(c: NetworkParameters) -> dict[str, float]:
    return {f"reference_{i}": REFERENCE for i in c.topology.names} | {f"load_{i}": LOAD for i in c.topology.names}


def _readout(readout: Array, t: float, x: Array, u: Array, theta: Array) -> Array:
    return by_states_alone(readout, u, theta)


@dataclass(frozen=True, eq=False)
class _Areas:
    """The functions of a network of N areas and E ties at theta (..., E + 2 N): slopes, inertias, droops."""

    c: NetworkParameters
    condition: Callable[[float], NetworkCondition]

    @cached_property
    def counts(self) -> tuple[int, int]:
        return len(self.c.topology.names), self.c.slope.size

    def split(self, model: NetworkModel, theta: Array) -> tuple[Array, Array, Array]:
        """Slopes of the sides (..., 2E), 0 where open, stiffnesses (..., N) and constants (..., N, 5)."""
        n, e = self.counts
        at = self.c.topology
        side = np.where(model.network.closed, theta[..., at.link], 0.0)
        constants = np.empty((*theta.shape[:-1], n, 5))
        constants[...] = model.constants
        constants[..., INERTIA], constants[..., DROOP] = theta[..., e : e + n], theta[..., e + n :]
        return side, np.add.reduceat(side, at.start[:-1], axis=-1), constants

    def known(self, side: Array, x: Array, u: Array) -> Array:
        """[x_i, P_ref, sum_j P_ij theta_j - P_L] (..., N, 6), on which the rows of the areas act."""
        n, _ = self.counts
        at = self.c.topology
        batch = np.broadcast_shapes(side.shape[:-1], x.shape[:-1], u.shape[:-1])
        v = np.empty((*batch, n, 6))
        v[..., :4] = x.reshape(*x.shape[:-1], n, 4)
        v[..., 4] = u[..., :n]
        v[..., 5] = np.add.reduceat(side * x[..., 4 * at.neighbour], at.start[:-1], axis=-1) - u[..., n:]
        return v

    def step(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        model = self.condition(t_start).true
        side, stiffness, constants = self.split(model, theta)
        return _after(equations.rows_of(stiffness, constants, model.dt)[..., 0, :, :], self.known(side, x, u))

    def step_and_jacobian(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> tuple[Array, Array]:
        model = self.condition(t_start).true
        n, e = self.counts
        at = self.c.topology
        side, stiffness, constants = self.split(model, theta)
        v = self.known(side, x, u)
        held = equations.rows_of(stiffness, constants, model.dt, (0, 1 + INERTIA, 1 + DROOP))
        batch = v.shape[:-2]
        found = equations.by_all(
            _of_runs(held, batch, (n, 4, 4, 6)), _of_runs(v, batch, (n, 6)), _of_runs(x, batch, (4 * n,)),
            _of_runs(side, batch, (2 * e,)), at.start, at.neighbour, at.link, model.network.closed, e,
        )  # fmt: skip
        return _after(held[..., 0, :, :], v), found.reshape(*batch, 4 * n, 8 * n + e)


def _of_runs(a: Array, batch: tuple[int, ...], shape: tuple[int, ...]) -> Array:
    """The array (..., *shape) for each run of the batch: (B, *shape)."""
    whole = a if a.shape == (*batch, *shape) else np.broadcast_to(a, (*batch, *shape))
    return plain(whole.reshape(-1, *shape))


def _after(rows: Array, v: Array) -> Array:
    """The states (..., 4 N) after a step of areas with these rows (..., N, 4, 6), of `known` v (..., N, 6)."""
    after = (rows @ v[..., None])[..., 0]
    return np.asarray(after.reshape(*after.shape[:-2], -1))
