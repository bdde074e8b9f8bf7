"""The discretised power network: arrays over all areas; a change touches only the rows of the areas concerned.

Discretisations, both with reference and load held over dt:
- "area-by-area": each area exactly, its neighbours' angles held too. Sparse for any number of areas, and possible for
  each area alone; but the coupling is of first order in dt. At dt = 1 s the largest differences of its transition matrix to the
  exact one, in the rows of theta, omega, p_m, p_v, are 0.04, 0.11, 0.73 and 1.86 for the 15 areas.
- "exact": the matrix exponential of the whole network, dense.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import batch_rows
from fusion_sfdia.models.power_network import equations
from fusion_sfdia.models.power_network.parameters import DYNAMIC, NetworkParameters, load_network
from fusion_sfdia.plant.linear import zero_order_hold
from fusion_sfdia.plant.network import Network

Array = NDArray[Any]

DISCRETISATIONS = ("area-by-area", "exact")
DENSE_AREAS = 250  # 1000 states: matrices of 8 MB
PROCESS_VARIANCE = {  # of theta, omega, p_m, p_v in 1 s; B18, sec. VIII, can be read in two ways
    "lit": (1e-4, 1e-4, 1e-4, 1e-4),  # as printed: "sigma_w^2 = 0.0001" of all states
    "small": (1e-5, 1e-5, 1e-4, 1e-4),  # the smaller variance of angle and speed meant for w as well
}
NOISE_VARIANCE = (1e-5, 1e-5, 1e-4, 1e-4)  # of the readings of theta, omega, p_m, p_v


@dataclass(frozen=True, eq=False)
class NetworkModel:
    """A power network over steps of dt seconds; `network_model` makes one, and each change gives another.

    constants: (N, 5) as in the parameters, but for faults. area: (N, 4, 6) rows [F_i, b_i, g_i] of
    x_i+ = F_i x_i + b_i P_ref + g_i (sum_j P_ij theta_j - P_L), neighbours held; F_i contains sum_j P_ij of the closed ties.
    side_slope: (2E,) P_ij at the sides of network.topology, 0 where the tie is open.
    """

    parameters: NetworkParameters
    network: Network
    constants: Array
    dt: float
    noise: str
    discretisation: str
    area: Array
    side_slope: Array

    @property
    def names(self) -> tuple[str, ...]:
        return self.parameters.topology.names

    @cached_property
    def stiffness(self) -> Array:
        """(N,) sum_j P_ij over the closed ties."""
        return stiffness(self.network, self.side_slope)

    @cached_property
    def process_cov(self) -> Array:
        """(4,) variances of what disturbs an area's states in dt; they grow in proportion to it."""
        return np.array(PROCESS_VARIANCE[self.noise]) * self.dt

    def external(self, theta: Array, load: Array) -> Array:
        """sum_j P_ij theta_j - P_L (..., N), of angles and loads (..., N)."""
        at = self.network.topology
        inflow = np.add.reduceat(self.side_slope * theta[..., at.neighbour], at.start[:-1], axis=-1)
        return inflow - load

    def step(self, x: Array, reference: Array, load: Array) -> Array:
        """The state (..., N, 4) after dt, of the state and the held reference and load (..., N)."""
        n = len(self.names)
        shapes = (x.shape[:-2], reference.shape[:-1], load.shape[:-1])
        batch = shapes[0] if shapes[0] == shapes[1] == shapes[2] else np.broadcast_shapes(*shapes)
        kind = np.result_type(x, reference, load, float)
        if self.discretisation == "exact":
            f, by_reference, by_load = self.matrices
            flat = np.broadcast_to(x, (*batch, n, 4)).reshape(*batch, 1, 4 * n)
            inputs = (
                np.broadcast_to(reference[..., None, :], (*batch, 1, n)),
                np.broadcast_to(load[..., None, :], (*batch, 1, n)),
            )
            whole = flat @ f.T + inputs[0] @ by_reference.T + inputs[1] @ by_load.T
            return np.asarray(whole.reshape(*batch, n, 4))
        at = self.network.topology
        after: Array = equations.advance(
            batch_rows(x, batch, kind, 2), batch_rows(reference, batch, kind), batch_rows(load, batch, kind),
            self.area, at.start, at.neighbour, self.side_slope,
        )  # fmt: skip
        return after.reshape(*batch, n, 4)

    def switched(self, *, plug_in: Iterable[str] = (), unplug: Iterable[str] = ()) -> NetworkModel:
        """The model after areas joined and left the network at the same time: ties and the stiffness at both their ends change.

        Area by area only the rows of these areas and of their neighbours change; all others keep their bits.
        """
        change = self.network.change(plug_in=plug_in, unplug=unplug)
        slope = self.side_slope.copy()
        slope[change.sides] = np.where(change.closed, self.parameters.side_slope[change.sides], 0.0)
        return self._changed(change.touched, network=self.network.after(change), side_slope=slope)

    def altered(self, area: str, **constants: float) -> NetworkModel:
        """The model with other constants of one area, such as governor_time=1000.0; ValueError for an unknown constant."""
        unknown = [name for name in constants if name not in DYNAMIC]
        if unknown:
            raise ValueError(f"unknown constants {', '.join(unknown)} of area {area!r}; known: {', '.join(DYNAMIC)}")
        i = self.network.topology.index(area)
        changed = self.constants.copy()
        for name, value in constants.items():
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} of area {area} is {value:g}; expected a positive finite number")
            changed[i, DYNAMIC.index(name)] = value
        return self._changed(np.array([i]), constants=changed)

    def _changed(self, rows: Array, **changes: Any) -> NetworkModel:
        after = replace(self, **changes, area=self.area.copy())
        after.area[rows] = after.rows(rows)
        return after

    def rows(self, areas: Array) -> Array:
        """(M, 4, 6) rows of `area`, from the constants and slopes of these areas (M,) alone."""
        sides, first = self.network.topology.sides(areas)
        stiff = np.add.reduceat(self.side_slope[sides], first) if areas.size else np.empty(0)
        return equations.rows_of(stiff, self.constants[areas], self.dt)[:, 0]

    @cached_property
    def continuous(self) -> tuple[Array, Array, Array]:
        """A (4N, 4N), B (4N, N), L (4N, N) of the whole network, dense; ValueError for more than 250 areas."""
        self.require_dense()
        local = equations.area_matrices(self.stiffness, self.constants, np.empty(0, int))[:, 0]
        return self._assembled(local)

    @cached_property
    def matrices(self) -> tuple[Array, Array, Array]:
        """F (4N, 4N), G (4N, N) of the references and (4N, N) of the loads over dt; ValueError for more than 250 areas."""
        self.require_dense()
        if self.discretisation == "area-by-area":
            return self._assembled(self.area)
        a, b, load = self.continuous
        f, g = zero_order_hold(a, np.concatenate([b, load], axis=1), self.dt)
        return f, g[:, : len(self.names)], g[:, len(self.names) :]

    def _assembled(self, local: Array) -> tuple[Array, Array, Array]:
        n, at = len(self.names), self.network.topology
        every = np.arange(n)
        f, by_reference, by_load = np.zeros((n, 4, n, 4)), np.zeros((n, 4, n)), np.zeros((n, 4, n))
        f[every, :, every, :] = local[:, :, :4]
        f[at.node, :, at.neighbour, 0] = self.side_slope[:, None] * local[at.node, :, 5]
        by_reference[every, :, every], by_load[every, :, every] = local[:, :, 4], -local[:, :, 5]
        return f.reshape(4 * n, 4 * n), by_reference.reshape(4 * n, n), by_load.reshape(4 * n, n)

    def require_dense(self) -> None:
        """Raise ValueError where matrices of all states by all states would fill the memory."""
        if len(self.names) > DENSE_AREAS:
            raise ValueError(
                f"matrices of all {4 * len(self.names)} states are dense and too large here; step area by area, which needs "
                f"none, or take at most {DENSE_AREAS} areas"
            )


def stiffness(network: Network, side_slope: Array) -> Array:
    """(N,) sums of the slopes (2E,) at each area's sides."""
    total: Array = np.add.reduceat(side_slope, network.topology.start[:-1])
    return total


def network_model(
    parameters: NetworkParameters | None = None,
    *,
    unplugged: Iterable[str] = (),
    dt: float = 1.0,
    noise: str = "lit",
    discretisation: str = "area-by-area",
) -> NetworkModel:
    """The model of a network; None for the 15 areas of B18. Raises ValueError for settings that do not fit.

    unplugged: areas that are not plugged in and run by themselves. dt: seconds. noise: "lit" or "small", of the process.
    discretisation: "area-by-area" or "exact".
    """
    c = load_network() if parameters is None else parameters
    for what, value, known in (("noise", noise, tuple(PROCESS_VARIANCE)), ("discretisation", discretisation, DISCRETISATIONS)):
        if value not in known:
            raise ValueError(f"{what} is {value!r}; known: {', '.join(known)}")
    if not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt is {dt} s; it must be positive and finite")
    network = Network.of(c.topology, unplugged)
    slope = np.where(network.closed, c.side_slope, 0.0)
    local = equations.rows_of(stiffness(network, slope), c.constants, float(dt))[:, 0]
    model = NetworkModel(c, network, c.constants, float(dt), noise, discretisation, local, slope)
    if discretisation == "exact":
        model.require_dense()
    return model
