"""Linear areas that share their first states: what each diagnoser of a network knows, its own area and its border.

x_i+ = F_i x_i + b_i u_i + g_i (sum_j P_ij z_j - d_i) + w_i, z the first state, read by its area and by all its neighbours
(Boem et al. 2018, sec. II; the equations of the diagnosers: consensus_equations).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.network import Network

Array = NDArray[Any]

FEW = 6  # states named in an error
UNREAD = ("noise", "shared_noise")  # inf where there is no sensor


class AreaArrays(NamedTuple):
    """N areas of n states with S sides as compiled steps take them; of a part of a network, more sides follow the S.

    matrices to opposite: as of Areas and Topology; received (S,) bool: where an area has no sensor of its neighbour's first
    state. It receives what the neighbour holds, whose noise is then in shared_noise, 0 of an estimate. reader (S,): the area at
    the other end of each side.
    """

    matrices: Array
    slope: Array
    closed: Array
    process_variance: Array
    noise: Array
    shared_noise: Array
    received: Array
    start: Array
    opposite: Array
    reader: Array


@dataclass(frozen=True, eq=False)
class Areas:
    """N areas of n states each, joined at 2E sides of ties, in the layout of network.py.

    Parameters
    ----------
    network : Network
        Its plugged-in areas and closed ties.
    states : tuple of tuple of str
        The names of each area's states (N tuples of n).
    owners : tuple of str (N,)
        The name of each area as the owner of sensors.
    matrices : array (N, n, n + 2)
        Rows [F_i, b_i, g_i].
    slope : array (2E,)
        P_ij, 0 at open ties.
    shared_gain : array (2E,)
        What the area at a side takes for F_j[0, 0] of its neighbour.
    process_variance : array (N, n)
        Of w over a step.
    noise : array (N, n)
        Variances of the areas' own readings, inf of a state that its area does not read.
    shared_noise : array (2E,)
        Variance of what each reads of its neighbour's z, inf where it has no sensor of it and receives what its neighbour
        holds.

    Raises
    ------
    ValueError
        For arrays of other shapes, variances that are not finite and at least 0 (noise: positive, or inf), a slope at an open
        tie, and a shared state of which the models of two areas disagree.

    Examples
    --------
    >>> from fusion_sfdia.plants import Areas, power_network
    >>> areas: Areas = power_network(loads=()).structure.areas
    >>> areas.size, areas.network.neighbours("4")
    ((15, 4, 34), ('3', '5', '13'))
    """

    network: Network
    states: tuple[tuple[str, ...], ...]
    owners: tuple[str, ...]
    matrices: Array
    slope: Array
    shared_gain: Array
    process_variance: Array
    noise: Array
    shared_noise: Array

    def __post_init__(self) -> None:
        at = self.network.topology
        count, sides = len(at.names), at.node.size
        n = self.matrices.shape[1] if self.matrices.ndim == 3 else 0
        shapes = {
            "matrices": (count, n, n + 2), "slope": (sides,), "shared_gain": (sides,), "process_variance": (count, n),
            "noise": (count, n), "shared_noise": (sides,),
        }  # fmt: skip
        for what, expected in shapes.items():
            value = getattr(self, what)
            known = np.isfinite(value) | (np.isposinf(value) if what in UNREAD else False)
            if value.shape != expected or not np.all(known):
                or_inf = ", or inf of a state without a sensor" if what in UNREAD else ""
                raise ValueError(f"{what} of {count} areas has shape {value.shape}; expected {expected} finite numbers{or_inf}")
        if np.any(self.process_variance < 0) or np.any(self.noise <= 0) or np.any(self.shared_noise <= 0):
            raise ValueError("variances of the process must be at least 0, of readings positive; give them squared")
        if np.any(odd := (self.slope != 0) & ~self.network.closed):
            i = int(np.flatnonzero(odd)[0])
            raise ValueError(f"the open tie {at.names[at.node[i]]}-{at.names[at.neighbour[i]]} has a slope; expected 0")
        self._require_agreement(np.flatnonzero(self.network.closed))

    def _require_agreement(self, sides: Array) -> None:
        at = self.network.topology
        own = self.matrices[at.neighbour[sides], 0, 0]
        wrong = sides[self.shared_gain[sides] != own]
        if wrong.size:
            s = int(wrong[0])
            i, j = at.node[s], at.neighbour[s]
            raise ValueError(
                f"areas {at.names[j]} and {at.names[i]} share {self.states[j][0] if self.states else 'a state'} and model it "
                f"differently: its factor is {self.matrices[j, 0, 0]:g} there, {self.shared_gain[s]:g} here; give both the same"
            )

    @property
    def opposite(self) -> Array:
        """(2E,): the side at the other end of each side's tie."""
        return self.network.topology.opposite

    @property
    def size(self) -> tuple[int, int, int]:
        """Areas, states of each, sides."""
        return len(self.network.topology.names), self.matrices.shape[1], self.slope.size

    @cached_property
    def unread(self) -> Array:
        """(N, n) bool: the states that their area does not read."""
        return np.isposinf(self.noise)

    @cached_property
    def received(self) -> Array:
        """(2E,) bool: where an area has no sensor of its neighbour's first state."""
        return np.isposinf(self.shared_noise)

    @cached_property
    def partly_read(self) -> bool:
        """Whether any state is not read by its own area or by a neighbour."""
        return bool(np.any(self.unread) or np.any(self.received))

    @cached_property
    def arrays(self) -> AreaArrays:
        """The arrays for compiled steps; not copies."""
        at = self.network.topology
        sent = np.where(self.unread[at.neighbour, 0], 0.0, self.noise[at.neighbour, 0])
        return AreaArrays(
            self.matrices, self.slope, self.network.closed, self.process_variance, self.noise,
            np.where(self.received, sent, self.shared_noise) if self.partly_read else self.shared_noise, self.received,
            at.start, at.opposite, at.neighbour,
        )  # fmt: skip

    def state_name(self, area: int, state: int) -> str:
        """The name of a state, also of areas without names.

        Parameters
        ----------
        area : int
            Position of the area.
        state : int
            Position of the state in it.

        Returns
        -------
        str
            For an error.
        """
        return self.states[area][state] if self.states else f"state {state} of area {self.network.topology.names[area]}"

    @property
    def unread_names(self) -> str:
        """The first few unread states, for an error."""
        at = self.network.topology
        where = [self.state_name(i, c) for i, c in np.argwhere(self.unread).tolist()]
        where += [
            f"{self.state_name(int(at.neighbour[s]), 0)} at {at.names[at.node[s]]}" for s in np.flatnonzero(self.received)
        ]
        return ", ".join(where[:FEW]) + (f", ... ({len(where)} in all)" if len(where) > FEW else "")

    def place(self, measures: str, owner: str) -> int:
        """Position of a sensor among the N n own readings and 2E shared ones.

        Parameters
        ----------
        measures : str
            The state that it reads.
        owner : str
            The area that reads it.

        Returns
        -------
        int
            Own readings come first.

        Raises
        ------
        ValueError
            For a sensor of none of them.
        """
        known = self._places.get((measures, owner))
        if known is None:
            raise ValueError(
                f"a sensor of {measures} is owned by {owner!r}; an area reads its own states and the first ones of its "
                "neighbours"
            )
        return known

    @cached_property
    def _places(self) -> dict[tuple[str, str], int]:
        count, n, _ = self.size
        at = self.network.topology
        own = {(name, self.owners[i]): n * i + c for i, names in enumerate(self.states) for c, name in enumerate(names)}
        shared = {
            (self.states[j][0], self.owners[i]): n * count + s
            for s, (i, j) in enumerate(zip(at.node, at.neighbour, strict=True))
        }
        return own | shared
