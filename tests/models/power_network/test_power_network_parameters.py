"""Parameters of power networks: the published table, provenance, bad files, the generator."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fusion_sfdia.models.power_network.parameters import (
    DYNAMIC,
    NETWORK_FILE,
    NetworkParameters,
    generate_network,
    load_network,
    load_steps,
)
from fusion_sfdia.plant.network import Network, Topology

TEXT = NETWORK_FILE.read_text(encoding="utf-8")


def test_the_published_table() -> None:
    """B18, Table I, row by row: H, R, D, T_t, T_g, and the limits of the angle and of dP_ref, of areas 1 to 15."""
    c = load_network()
    H = [12, 10, 8, 8, 10, 7, 7, 11, 8, 9, 10, 11, 12, 7, 9]
    R = [0.05, 0.0625, 0.08, 0.08, 0.05, 0.05, 0.05, 0.08, 0.08, 0.05, 0.05, 0.0625, 0.05, 0.08, 0.05]
    D = [0.7, 0.9, 0.9, 0.7, 0.86, 0.7, 0.9, 0.9, 0.7, 0.86, 0.7, 0.9, 0.7, 0.7, 0.86]
    T_t = [0.65, 0.4, 0.3, 0.6, 0.5, 0.65, 0.6, 0.6, 0.6, 0.8, 0.65, 0.6, 0.65, 0.6, 0.8]
    T_g = [0.15 if area in (5, 10, 15) else 0.1 for area in range(1, 16)]
    P_ref = [0.5, 0.65, 0.65, 0.55, 0.5, 0.5, 0.65, 0.65, 0.55, 0.5, 0.5, 0.65, 0.65, 0.55, 0.5]
    assert c.topology.names == tuple(str(area) for area in range(1, 16))
    assert c.constants.T.tolist() == [H, R, D, T_t, T_g]
    assert c.reference_limit.tolist() == P_ref and c.angle_limit.tolist() == [0.1] * 15


def test_the_ties_are_those_of_the_text() -> None:
    c = load_network()
    network = Network.of(c.topology)
    assert 4 * len(c.topology.names) + 2 * len(c.slope) == 94
    assert network.neighbours("4") == ("3", "5", "13")
    assert network.neighbours("15") == ("14",)


def test_provenance_states_what_is_not_published() -> None:
    document = tomllib.loads(TEXT)
    assert {entry["provenance"] for entry in document["area"].values()} == {"paper"}
    recalled = {tie for tie, entry in document["tie"].items() if entry["provenance"] == "recalled"}
    assert recalled == {"1-2", "2-3", "3-4", "4-5", "2-5"}
    assert {e["provenance"] for e in document["tie"].values()} == {"recalled", "chosen"}
    for scenario in document["loads"].values():
        assert set(scenario) == {"recalled", "chosen"}
        assert all(int(area) <= 5 for _, area, _ in scenario["recalled"])
        assert all(int(area) > 5 for _, area, _ in scenario["chosen"])


def test_load_steps_come_in_order_of_time() -> None:
    steps = load_steps("1")
    assert [s.time for s in steps] == sorted(s.time for s in steps)
    assert [tuple(s) for s in steps if int(s.area) <= 5] == [
        (5, "1", 0.15), (15, "2", -0.15), (20, "3", 0.12), (40, "3", -0.12), (40, "4", 0.28),
    ]  # fmt: skip
    with pytest.raises(ValueError, match="no loads '3'; known: 1, 2"):
        load_steps("3")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"4-13" = { value = 2.0', '"4-16" = { value = 2.0', "unknown nodes 16"),
        ('"4-13" = { value = 2.0', '"4-13" = { value = -2.0', "slope of tie 4-13 is -2"),
        ('"4-13" = { value = 2.0', '"4-13" = { value = 0', "slope of tie 4-13 is 0"),
        ('"4-13" = { value = 2.0', '"4-13" = { value = nan', "slope of tie 4-13 is nan"),
        ('"4-13" = { value = 2.0', '"4-13" = { value = "2"', "tie 4-13 is '2'; expected a number"),
        ('"4-13" = {', '"4-3" = {', "3 and 4 are linked more than once"),
        ('"4-13" = {', '"4-4" = {', "joins 4 to itself"),
        ('"4-13" = {', '"4" = {', "two areas each"),
        ('"14-15" = {', '"13-1" = {', "no link leads to 15"),
        ('"14", "15"]', '"14", "14"]', "the names 14 occur more than once"),
        ('"14", "15"]', '"14", "1-5"]', "without a hyphen"),
        ('"14", "15"]', '"14"]', "one for each of 14 areas"),
        ("inertia = { values = [12,", "inertia = { values = [-12,", "inertia of area 1 is -12"),
        ('unit = "s2/rad"', 'unit = "s"', "is in 's'; expected 's2/rad'"),
        ('provenance = "chosen"', 'provenance = "guessed"', "provenance 'guessed'; expected one of paper"),
        ('source = "R, B18 Table I"', 'source = " "', "names no source"),
        ('source = "R, B18 Table I"', 'page = "3"', "expected a table of values, unit, provenance, source"),
        ("droop =", "statism =", "expected inertia, droop"),
        ("[tie]", "[ties]", "a network has names, area, tie and loads"),
        ("[tie]", "[tie", "is not a TOML file"),
    ],
)
def test_wrong_files_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TEXT
    path = tmp_path / "network.toml"
    path.write_text(TEXT.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ValueError, match=message) as error:
        load_network(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('[15, "2", -0.15]', '[15, "16", -0.15]', "expected .time in s, area, change"),
        ('[15, "2", -0.15]', '["15", "2", -0.15]', "expected a number"),
        ("recalled = [[5", "remembered = [[5", "provenance 'remembered'"),
    ],
)
def test_wrong_load_steps_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "network.toml"
    path.write_text(TEXT.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        load_steps("1", path)


def test_parameters_must_fit_the_network() -> None:
    pair = Topology.joined("ab", [("a", "b")])
    with pytest.raises(ValueError, match=r"constants of 2 areas with 1 ties has shape \(2, 4\); expected \(2, 5\)"):
        NetworkParameters(pair, np.ones((2, 4)), np.ones(1), np.ones(2), np.ones(2))


def test_the_generator_is_reproducible() -> None:
    a, b, other = generate_network(200, 3), generate_network(200, 3), generate_network(200, 4)
    for what in ("constants", "slope", "angle_limit", "reference_limit"):
        assert np.array_equal(getattr(a, what), getattr(b, what))
    assert np.array_equal(a.topology.links, b.topology.links)
    assert not np.array_equal(a.topology.links, other.topology.links)


@pytest.mark.parametrize(("areas", "degree"), [(2, 1.0), (15, 34 / 15), (40, 39.0), (301, 3.0), (100, 12.0), (50, 1.96)])
def test_generated_networks_are_connected_and_of_the_stated_degree(areas: int, degree: float) -> None:
    c = generate_network(areas, 7, degree)
    links = c.topology.links
    assert len(links) == round(areas * degree / 2)
    graph = coo_matrix((np.ones(len(links)), links.T), shape=(areas, areas))
    assert connected_components(graph, directed=False)[0] == 1
    paper = load_network()
    for k in range(len(DYNAMIC)):
        assert set(c.constants[:, k]) <= set(paper.constants[:, k])
    assert set(c.slope) <= set(paper.slope)


@pytest.mark.parametrize(
    ("areas", "seed", "degree", "message"),
    [
        (1, 0, 1.0, "at least 2"),
        (10, 0, 1.0, "expected 9 to 45"),
        (10, 0, 10.0, "expected 9 to 45"),
        (10, -1, 2.0, "seed is -1"),
        (10, 0, float("nan"), "degree is nan"),
    ],
)
def test_impossible_networks_are_refused(areas: int, seed: int, degree: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        generate_network(areas, seed, degree)
