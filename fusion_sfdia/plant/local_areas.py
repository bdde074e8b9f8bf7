"""A network as plants of its areas: each area alone, with what its neighbours send it.

An area reads its own states, and its neighbours send their readings of its first state z (the shared one), their estimates of
their own and the variances of these. The areas of one degree are one plant: what makes them differ is input.

    x_i+ = F_i x_i + b_i u_i + g_i (sum_j P_ij z_j - d_i) + w_i

With estimates in place of z_j, whose errors e_j are nearly white where z_j is read well, w_i gets the covariance
g_i g_i' sum_j P_ij^2 var(e_j). The area needs no states for its neighbours, which a random walk would only describe worse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.network import Network
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


class Group(NamedTuple):
    """The M areas of degree d: their plant, positions (M,), sides (M, d), neighbours (M, d), and the positions (M, n + d) of
    their sensors among the network's.
    """

    plant: Plant
    areas: Array
    sides: Array
    neighbours: Array
    sensors: Array


@dataclass(frozen=True, eq=False)
class LocalAreas:
    """N areas of n states each with their ties, as plants by degree.

    network: which areas and ties are there. slope (2E,): P_ij at the sides, 0 at open ties. constants (N, c): of each area.
    plant(degree): the plant of an area of that degree. Its states are x_i, z the first; its sensors the area's n readings of
    them, then a reading of z by each of the d neighbours; its inputs u_i, d_i, the standard deviation of sum_j P_ij e_j, d
    estimates z_j, d slopes, and the constants. It states errors of d_i. Names may have the fields {area} and {neighbour[k]}.

    Sensors of the network are those of the areas, (N n), then those at the sides (2E); its inputs are N u_i, then N d_i.
    """

    network: Network
    slope: Array
    constants: Array
    plant: Callable[[int], Plant]

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """The areas by degree."""
        at = self.network.topology
        count, degree = len(at.names), np.diff(at.start)
        found = []
        for d in np.unique(degree):
            plant, areas = self.plant(int(d)), np.flatnonzero(degree == d)
            n = len(plant.states)
            sides = at.start[areas, None] + np.arange(d)
            own = n * areas[:, None] + np.arange(n)
            read = np.concatenate([own, n * count + at.opposite[sides]], axis=1)
            found.append(Group(plant, areas, sides, at.neighbour[sides], read))
        return tuple(found)

    def named(self, group: Group, member: int, name: str) -> str:
        """The name in the network of a sensor or hypothesis of a group's member."""
        names = self.network.topology.names
        neighbours = [names[j] for j in group.neighbours[member]]
        return name.format(area=names[group.areas[member]], neighbour=neighbours)

    def inputs(self, group: Group, u: Array, shared: Array, variance: Array) -> Array:
        """The inputs (..., M, m) of a group: u (..., 2N) of the network, estimates of z and their variances (..., N)."""
        count, d = len(self.network.topology.names), group.sides.shape[1]
        slope, constants = self.slope[group.sides], self.constants[group.areas]
        batch = np.broadcast_shapes(u.shape[:-1], shared.shape[:-1])
        found = np.empty((*batch, len(group.areas), len(group.plant.inputs)))
        found[..., 0], found[..., 1] = u[..., group.areas], u[..., count + group.areas]
        found[..., 2] = np.sqrt(np.sum(slope**2 * variance[..., group.neighbours], axis=-1))
        found[..., 3 : 3 + d] = shared[..., group.neighbours]
        found[..., 3 + d : 3 + 2 * d] = slope
        found[..., 3 + 2 * d :] = constants
        return found
