"""Networks that change while they run: in place with the bits of a new model, and unchanged if a change fails."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.detectors.stochastic_thresholds.consensus import NetworkReadings, initial_state
from fusion_sfdia.detectors.stochastic_thresholds.network_step import network_step, terms_of
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import NetworkModel, network_model
from fusion_sfdia.models.power_network.parameters import generate_network
from fusion_sfdia.models.power_network.running import RunningNetwork

ARRAYS = ("matrices", "slope", "shared_gain", "process_variance", "noise", "shared_noise")


def assert_same(running: RunningNetwork, model: NetworkModel) -> None:
    expected = network_areas(model)
    for name in ARRAYS:
        assert getattr(running.areas, name).tobytes() == getattr(expected, name).tobytes(), name
    np.testing.assert_array_equal(running.areas.network.closed, expected.network.closed)
    np.testing.assert_array_equal(running.areas.network.plugged, expected.network.plugged)
    np.testing.assert_array_equal(running.model.stiffness, model.stiffness)
    terms, closed = terms_of(expected.arrays), expected.network.closed
    np.testing.assert_array_equal(running.terms.of_areas, terms.of_areas)
    np.testing.assert_array_equal(running.terms.of_sides[closed], terms.of_sides[closed])


def test_changes_in_place_are_those_of_new_models() -> None:
    rng, model = np.random.default_rng(0), network_model(generate_network(30, 2, degree=5.0), unplugged=["4"])
    first, running = model, RunningNetwork(model)
    untouched = [getattr(network_areas(first), name).copy() for name in ARRAYS]
    for _ in range(40):
        chosen = [model.names[i] for i in rng.permutation(30)[: rng.integers(1, 4)]]
        joins = [name for name in chosen if not model.network.plugged[model.network.topology.index(name)]]
        leaves = [name for name in chosen if name not in joins]
        model = model.switched(plug_in=joins, unplug=leaves)
        running.switch(plug_in=joins, unplug=leaves)
        assert_same(running, model)
    for name, before in zip(ARRAYS, untouched, strict=True):
        np.testing.assert_array_equal(getattr(network_areas(first), name), before)


@pytest.mark.parametrize("change", [{}, {"unplug": ["3", "x"]}, {"unplug": ["3", "4"]}, {"plug_in": ["4", "5"]}])
def test_a_change_that_fails_leaves_the_network_running(change: dict[str, list[str]]) -> None:
    model = network_model(unplugged=["4"])
    running = RunningNetwork(model)
    with pytest.raises(ValueError, match=r"node"):
        running.switch(**change)
    assert_same(running, model)


def test_diagnosers_go_on_through_a_change() -> None:
    rng, model = np.random.default_rng(1), network_model()
    running = RunningNetwork(model)
    ours = theirs = initial_state(running.areas, (2,))
    at = model.network.topology
    for k in range(12):
        reference, load = rng.standard_normal((2, 2, 15))
        own, shared = rng.standard_normal((2, 15, 4)), rng.standard_normal((2, at.node.size))
        given = NetworkReadings(own, shared, reference, load), 2.0, 0.3
        ours, _ = network_step(running.areas, ours, *given, terms=running.terms)
        theirs, _ = network_step(network_areas(model), theirs, *given)
        for a, b in zip(ours, theirs, strict=True):
            assert a.tobytes() == b.tobytes()
        if k in (3, 7):
            names = {"unplug": ["4", "9"]} if k == 3 else {"plug_in": ["4", "9"]}
            change = running.switch(**names)
            model = model.switched(**names)
            assert {at.names[i] for i in change.touched} >= {"3", "4", "5", "13"}
    assert np.all(ours.deviation[:, [at.index("4"), at.index("9")]] < 10.0)
