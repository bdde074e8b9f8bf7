"""Networks: sides, neighbours, and nodes that join and leave at once."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.plant.network import Network, Topology

SQUARE = Topology.joined(("a", "b", "c", "d"), [("a", "b"), ("b", "c"), ("d", "c"), ("a", "d"), ("c", "a")])


def test_sides_are_the_links_seen_from_both_ends() -> None:
    rng = np.random.default_rng(0)
    pairs = np.array([(i, j) for i in range(30) for j in range(i)])
    links = np.concatenate([np.stack([np.arange(29), np.arange(1, 30)], 1), pairs[rng.permutation(len(pairs))[:40]]])
    links = np.unique(np.sort(links, axis=1), axis=0)[rng.permutation(len(np.unique(np.sort(links, axis=1), axis=0)))]
    topology = Topology(tuple(map(str, range(30))), links)
    for i in range(30):
        own = np.arange(topology.start[i], topology.start[i + 1])
        expected = sorted({int(b) for a, b in links if a == i} | {int(a) for a, b in links if b == i})
        assert np.all(topology.node[own] == i)
        assert topology.neighbour[own].tolist() == expected
        for side in own:
            assert set(links[topology.link[side]].tolist()) == {i, int(topology.neighbour[side])}
            other = topology.opposite[side]
            assert other != side and topology.link[other] == topology.link[side] and topology.node[other] != i
    sides, first = topology.sides(np.array([7, 3]))
    np.testing.assert_array_equal(topology.node[sides], np.repeat([7, 3], [first[1], sides.size - first[1]]))


def test_a_link_is_closed_while_both_ends_are_plugged_in() -> None:
    whole = Network.of(SQUARE)
    assert whole.neighbours("a") == ("b", "c", "d") and whole.neighbours("b") == ("a", "c")
    without = whole.switched(unplug=["c"])
    assert without.neighbours("a") == ("b", "d") and without.neighbours("c") == () and without.neighbours("b") == ("a",)
    both = without.switched(unplug=["a"])
    assert not both.closed.any()
    assert both.switched(plug_in=["c"]).neighbours("c") == ("b", "d")
    assert Network.of(SQUARE, unplugged=["a", "c"]).plugged.tolist() == both.plugged.tolist()


def test_several_nodes_switch_at_once() -> None:
    before = Network.of(SQUARE, unplugged=["d"])
    after = before.switched(plug_in=["d"], unplug=["b"])
    assert after.neighbours("d") == ("a", "c") and after.neighbours("b") == ()
    assert before.neighbours("d") == ()  # the one before is as it was


def test_touched_are_the_switched_node_and_its_neighbours() -> None:
    chain = Topology.joined("abcdef", [("a", "b"), ("b", "c"), ("c", "d"), ("d", "e"), ("e", "f")])
    whole = Network.of(chain)
    assert [chain.names[i] for i in whole.change(unplug=["c"]).touched] == ["b", "c", "d"]
    away = Network.of(chain, unplugged=["c"])
    assert [chain.names[i] for i in away.change(unplug=["d"]).touched] == ["d", "e"]  # the tie c-d was open


def test_a_change_is_what_differs_afterwards() -> None:
    rng, network = np.random.default_rng(1), Network.of(SQUARE)
    for _ in range(30):
        chosen = [SQUARE.names[i] for i in rng.permutation(4)[: rng.integers(1, 4)]]
        joins = [name for name in chosen if not network.plugged[SQUARE.index(name)]]
        leaves = [name for name in chosen if name not in joins]
        change, after = network.change(plug_in=joins, unplug=leaves), network.switched(plug_in=joins, unplug=leaves)
        np.testing.assert_array_equal(change.nodes, np.flatnonzero(network.plugged != after.plugged))
        np.testing.assert_array_equal(change.sides, np.flatnonzero(network.closed != after.closed))
        np.testing.assert_array_equal(change.closed, after.closed[change.sides])
        np.testing.assert_array_equal(change.touched, np.unique(SQUARE.node[change.sides]))
        network = after


@pytest.mark.parametrize(
    ("names", "links", "message"),
    [
        (("a", "b", "a"), [("a", "b")], "the names a occur more than once"),
        (("a", "b"), [("a", "x")], "unknown nodes x; known: a, b"),
        (("a", "b"), [("a", "b"), ("b", "b")], "joins b to itself"),
        (("a", "b", "c"), [("a", "b"), ("c", "b"), ("b", "a")], "a and b are linked more than once"),
        (("a", "b", "c"), [("a", "b")], "no link leads to c"),
        (("a",), [], "no link leads to a"),
    ],
)
def test_a_topology_that_is_none(names: tuple[str, ...], links: list[tuple[str, str]], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Topology.joined(names, links)


@pytest.mark.parametrize("links", [np.zeros((2, 3), int), np.array([[0.0, 1.0]]), np.array([[0, 2]]), np.array([[-1, 0]])])
def test_links_that_are_no_positions(links: np.ndarray) -> None:
    with pytest.raises(ValueError, match="expected"):
        Topology(("a", "b"), links)


@pytest.mark.parametrize(
    ("plug_in", "unplug", "message"),
    [
        ((), (), "no node to plug in"),
        (("a",), (), "'a' is plugged in already"),
        ((), ("d",), "'d' is unplugged already"),
        (("x",), (), "unknown node 'x'; known: a, b, c, d"),
        (("d",), ("d",), "the names d occur more than once"),
    ],
)
def test_a_switch_that_does_not_fit(plug_in: tuple[str, ...], unplug: tuple[str, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Network.of(SQUARE, unplugged=["d"]).switched(plug_in=plug_in, unplug=unplug)


def test_what_is_plugged_in_cannot_be_changed_in_place() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Network.of(SQUARE).plugged[0] = False
    with pytest.raises(ValueError, match="truth value for each of 4"):
        Network(SQUARE, np.ones(4))
