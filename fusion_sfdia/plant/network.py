"""The structure of a network: named nodes, the links between them, and which nodes are plugged in.

All nodes and links that a network will ever have are declared once, so that arrays never change their shapes (Boem 2018,
sec. II); a link is closed while both its ends are plugged in. Each link has two sides, one at each end; sides are stored node
after node, and at each node by neighbour (compressed sparse rows).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import require_unique

Array = NDArray[Any]
MOST_SHOWN = 20  # names in an error


@dataclass(frozen=True, eq=False)
class Topology:
    """N named nodes and E undirected links between them.

    Parameters
    ----------
    names : tuple of str (N,)
        Of the nodes.
    links : array (E, 2) of int
        Positions of the two ends of each link.

    Raises
    ------
    ValueError
        For names that occur twice, ends that are not nodes, a link from a node to itself, two links between the same nodes, or
        a node without any link.

    Examples
    --------
    >>> from fusion_sfdia.plants import Topology
    >>> topology = Topology.joined(("left", "middle", "right"), [("left", "middle"), ("middle", "right")])
    >>> topology.links.tolist(), topology.index("right")
    ([[0, 1], [1, 2]], 2)
    """

    names: tuple[str, ...]
    links: Array

    def __post_init__(self) -> None:
        require_unique("network", self.names)
        n, links = len(self.names), np.asarray(self.links)
        if links.ndim != 2 or links.shape[1:] != (2,) or links.dtype.kind not in "iu":
            raise ValueError(f"links have shape {links.shape} of {links.dtype}; expected whole numbers (E, 2), two ends a link")
        if links.size and not (0 <= links.min() and links.max() < n):
            raise ValueError(f"links end at nodes {links.min()} to {links.max()}; expected 0 to {n - 1}")
        loops = links[links[:, 0] == links[:, 1], 0]
        if loops.size:
            raise ValueError(f"a link joins {self.shown(loops)} to itself; expected two different ends")
        pairs, count = np.unique(np.sort(links, axis=1) @ np.array([n, 1]), return_counts=True)
        if np.any(count > 1):
            a, b = divmod(int(pairs[count > 1][0]), n)
            raise ValueError(f"{self.names[a]} and {self.names[b]} are linked more than once; join them by one link")
        lonely = np.setdiff1d(np.arange(n), links)
        if lonely.size:
            raise ValueError(f"no link leads to {self.shown(lonely)}; every node of a network has a neighbour")

    @classmethod
    def joined(cls, names: Sequence[str], links: Iterable[tuple[str, str]]) -> Topology:
        """The topology whose links are given by the names of their ends.

        Parameters
        ----------
        names : sequence of str (N,)
            Of the nodes.
        links : iterable of (str, str)
            The two ends of each.

        Returns
        -------
        Topology
            Of these nodes.

        Raises
        ------
        ValueError
            As the class, and for an unknown name.
        """
        at = {name: i for i, name in enumerate(names)}
        pairs = list(links)
        unknown = sorted({end for pair in pairs for end in pair if end not in at})
        if unknown:
            raise ValueError(f"links end at unknown nodes {', '.join(unknown[:MOST_SHOWN])}; known: {_listed(names)}")
        return cls(tuple(names), np.array([(at[a], at[b]) for a, b in pairs], dtype=np.int64).reshape(-1, 2))

    @cached_property
    def _positions(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    def index(self, name: str) -> int:
        """Position of a node.

        Parameters
        ----------
        name : str
            Of the node.

        Returns
        -------
        int
            Among `names`.

        Raises
        ------
        ValueError
            For an unknown name.
        """
        if name not in self._positions:
            raise ValueError(f"unknown node {name!r}; known: {_listed(self.names)}")
        return self._positions[name]

    def shown(self, nodes: Array) -> str:
        """The names of nodes, for an error.

        Parameters
        ----------
        nodes : array (M,) of int
            Their positions.

        Returns
        -------
        str
            In words.
        """
        return _listed([self.names[i] for i in nodes])

    @cached_property
    def _order(self) -> Array:
        return np.lexsort((self.links[:, ::-1].T.ravel(), self.links.T.ravel()))

    @cached_property
    def node(self) -> Array:
        """(2E,): the node at each side."""
        return np.ascontiguousarray(self.links.T.ravel()[self._order])

    @cached_property
    def neighbour(self) -> Array:
        """(2E,): the node at the other end of each side's link."""
        return np.ascontiguousarray(self.links[:, ::-1].T.ravel()[self._order])

    @cached_property
    def link(self) -> Array:
        """(2E,): the link of each side."""
        return self._order % max(len(self.links), 1)

    @cached_property
    def start(self) -> Array:
        """(N + 1,): the sides of node i are those from start[i] to start[i + 1]."""
        return np.concatenate([[0], np.cumsum(np.bincount(self.node, minlength=len(self.names)))])

    @cached_property
    def opposite(self) -> Array:
        """(2E,): the side at the other end of each side's link."""
        place: Array = np.empty_like(self._order)
        place[self._order] = np.arange(place.size)
        other: Array = place[(self._order + len(self.links)) % max(place.size, 1)]
        return other

    def sides(self, nodes: Array) -> tuple[Array, Array]:
        """All sides of some nodes, one node after the other, and where each begins among them.

        Parameters
        ----------
        nodes : array (M,) of int
            Their positions.

        Returns
        -------
        sides : array of int
            Of all these nodes.
        begins : array (M,) of int
            Where those of each node begin.
        """
        count = self.start[nodes + 1] - self.start[nodes]
        first = np.cumsum(count) - count
        return np.repeat(self.start[nodes] - first, count) + np.arange(count.sum()), first


class TopologyChange(NamedTuple):
    """All that changes in a network when nodes join or leave it.

    nodes, plugged (M,): those that join (True) or leave. sides, closed (K,): where links close (True) or open. touched: the
    nodes at these sides, in the order of their positions.
    """

    nodes: Array
    plugged: Array
    sides: Array
    closed: Array
    touched: Array


@dataclass(frozen=True, eq=False)
class Network:
    """A topology and which of its nodes are plugged in; another selection is another Network.

    Parameters
    ----------
    topology : Topology
        Of N nodes.
    plugged : array (N,) of bool
        Whether each is plugged in.

    Examples
    --------
    >>> from fusion_sfdia.plants import Network, Topology
    >>> network = Network.of(Topology.joined("abc", [("a", "b"), ("b", "c")]), unplugged=["c"])
    >>> network.neighbours("b"), network.switched(plug_in=["c"]).neighbours("b")
    (('a',), ('a', 'c'))
    """

    topology: Topology
    plugged: Array

    def __post_init__(self) -> None:
        plugged, n = np.array(self.plugged), len(self.topology.names)
        if plugged.shape != (n,) or plugged.dtype != np.bool_:
            raise ValueError(
                f"plugged has shape {plugged.shape} of {plugged.dtype}; expected a truth value for each of {n} nodes"
            )
        plugged.flags.writeable = False
        object.__setattr__(self, "plugged", plugged)

    @classmethod
    def of(cls, topology: Topology, unplugged: Iterable[str] = ()) -> Network:
        """A network with all nodes plugged in but those named.

        Parameters
        ----------
        topology : Topology
            Of all nodes.
        unplugged : iterable of str, default ()
            Those that are not plugged in.

        Returns
        -------
        Network
            Of that topology.
        """
        whole = cls(topology, np.ones(len(topology.names), bool))
        away = tuple(unplugged)
        return whole.switched(unplug=away) if away else whole

    @cached_property
    def closed(self) -> Array:
        """(2E,): whether the link of each side is closed."""
        both: Array = self.plugged[self.topology.node] & self.plugged[self.topology.neighbour]
        return both

    def sides(self, node: int) -> Array:
        """The closed sides of a node.

        Parameters
        ----------
        node : int
            Its position.

        Returns
        -------
        array of int
            The positions of the sides; empty for a node that is not plugged in.
        """
        own = np.arange(self.topology.start[node], self.topology.start[node + 1])
        return own[self.closed[own]]

    def neighbours(self, name: str) -> tuple[str, ...]:
        """Names of the nodes to which a node is joined at present.

        Parameters
        ----------
        name : str
            Of the node.

        Returns
        -------
        tuple of str
            Empty for a node that is not plugged in.
        """
        at = self.topology
        return tuple(at.names[j] for j in at.neighbour[self.sides(at.index(name))])

    def change(self, *, plug_in: Iterable[str] = (), unplug: Iterable[str] = ()) -> TopologyChange:
        """The change when nodes join and leave at the same time; the cost grows with their links only.

        Parameters
        ----------
        plug_in : iterable of str, default ()
            Nodes that join.
        unplug : iterable of str, default ()
            Nodes that leave.

        Returns
        -------
        TopologyChange
            What changes.

        Raises
        ------
        ValueError
            For an unknown node, one named twice, one to plug in that is plugged in, one to unplug that is not, or nothing to
            do.
        """
        at, joins, leaves = self.topology, tuple(plug_in), tuple(unplug)
        if not joins and not leaves:
            raise ValueError("no node to plug in or to unplug; name at least one")
        require_unique("nodes to plug in and to unplug", (*joins, *leaves))
        expected = {at.index(name): value for names, value in ((joins, True), (leaves, False)) for name in names}
        for i, value in expected.items():
            if self.plugged[i] == value:
                raise ValueError(f"node {at.names[i]!r} is {'plugged in' if value else 'unplugged'} already; leave it out")
        nodes = np.array(sorted(expected))
        plugged = np.array([expected[i] for i in nodes.tolist()])
        own = at.sides(nodes)[0]
        sides = np.unique(np.concatenate([own, at.opposite[own]]))
        both = np.ones(sides.size, bool)
        for ends in (at.node[sides], at.neighbour[sides]):
            place = np.minimum(np.searchsorted(nodes, ends), nodes.size - 1)
            both &= np.where(nodes[place] == ends, plugged[place], self.plugged[ends])
        other = both != self.closed[sides]
        return TopologyChange(nodes, plugged, sides[other], both[other], np.unique(at.node[sides[other]]))

    def switched(self, *, plug_in: Iterable[str] = (), unplug: Iterable[str] = ()) -> Network:
        """The network after nodes joined and left it together.

        Parameters
        ----------
        plug_in : iterable of str, default ()
            Nodes that join.
        unplug : iterable of str, default ()
            Nodes that leave.

        Returns
        -------
        Network
            Of the same topology.

        Raises
        ------
        ValueError
            As in `change`.
        """
        return self.after(self.change(plug_in=plug_in, unplug=unplug))

    def after(self, change: TopologyChange) -> Network:
        """The network after a change of it.

        Parameters
        ----------
        change : TopologyChange
            As `change` gives it.

        Returns
        -------
        Network
            Of the same topology.
        """
        plugged = self.plugged.copy()
        plugged[change.nodes] = change.plugged
        return Network(self.topology, plugged)


def _listed(names: Sequence[str]) -> str:
    """Names for an error, at most MOST_SHOWN."""
    return ", ".join(names[:MOST_SHOWN]) + (f", ... ({len(names)} in all)" if len(names) > MOST_SHOWN else "")
