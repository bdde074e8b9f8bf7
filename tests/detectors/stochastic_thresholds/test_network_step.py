"""The compiled step of a whole network: the numbers of the array code to rounding, and the same bits in any batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from consensus_arrays import predict, take

from fusion_sfdia.detectors.stochastic_thresholds import consensus
from fusion_sfdia.detectors.stochastic_thresholds.consensus import MODES, Diagnosers, NetworkReadings, initial_state
from fusion_sfdia.detectors.stochastic_thresholds.network_step import network_step
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.parameters import generate_network
from fusion_sfdia.plant.areas import Areas

ALPHA, LAM = 2.0, 0.3
NETWORKS = {
    "paper": network_areas(network_model()),
    "area 4 unplugged": network_areas(network_model(unplugged=["4"])),
    "dense": network_areas(network_model(generate_network(40, 1, degree=9.0), unplugged=["7", "8", "20"])),
}


def anything(areas: Areas, batch: int, seed: int = 0) -> tuple[Diagnosers, NetworkReadings]:
    """Diagnosers that hold anything, a quarter of their readings missing now or before, and what comes next."""
    rng = np.random.default_rng(seed)
    empty = initial_state(areas, (batch,))
    state = Diagnosers(*(rng.uniform(0.1, 1.0, a.shape) for a in empty))
    for error_bound in (state.error_bound, state.error_bound_shared):
        error_bound *= rng.random(error_bound.shape) < 0.25
    reference, load = rng.standard_normal((2, *state.held.shape[:2]))
    readings = [np.where(rng.random(a.shape) < 0.25, np.nan, rng.standard_normal(a.shape)) for a in empty[:2]]
    return state, NetworkReadings(*readings, reference, load)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("network", NETWORKS)
def test_the_compiled_step_equals_array_code(network: str, mode: str) -> None:
    areas = NETWORKS[network]
    state, given = anything(areas, 3)
    inputs = given.reference, given.load, LAM, mode
    expected = take(predict(areas, state, *inputs), given.own, given.shared)
    found, alarm = network_step(areas, state, given, ALPHA, LAM, mode=mode)
    # each number is a sum of at most n + 2 + 4 terms for each of the sides, in another order; with all terms positive the sum
    # of their magnitudes is what predict gives for magnitudes, and each of the two roundings at a term costs eps of it
    operations = 2 * (6 + 4 * int(np.diff(areas.network.topology.start).max()))
    magnitudes = replace(
        areas, matrices=np.abs(areas.matrices), slope=np.abs(areas.slope), shared_gain=np.abs(areas.shared_gain)
    )
    positive = Diagnosers(*(-a if k in (4, 5) else a for k, a in enumerate(state)))
    most = predict(magnitudes, positive, np.abs(given.reference), -np.abs(given.load), LAM, mode)
    for k, name in enumerate(Diagnosers._fields):
        size = np.abs(getattr(most, name.replace("held", "estimate").replace("residual", "estimate")))
        assert np.all(np.abs(found[k] - expected[k]) <= operations * np.finfo(float).eps * size), name
    by_turns = consensus.take(areas, consensus.predict(areas, state, *inputs), given.own, given.shared)
    assert [a.tobytes() for a in by_turns] == [a.tobytes() for a in found]
    crossed = np.abs(expected.residual) > ALPHA * expected.deviation
    beside = np.abs(expected.residual_shared) > ALPHA * expected.deviation_shared
    at = areas.network.topology
    expected = [[crossed[b, i].any() or beside[b, at.node == i].any() for i in range(areas.size[0])] for b in range(3)]
    np.testing.assert_array_equal(alarm, expected)
    assert alarm.any() and not alarm.all()


@pytest.mark.parametrize("mode", MODES)
def test_the_bits_depend_on_no_batch_and_on_no_reused_memory(mode: str) -> None:
    areas = NETWORKS["area 4 unplugged"]
    state, given = anything(areas, 5)
    used = [Diagnosers(*(np.full_like(a, np.nan) for a in state)), Diagnosers(*map(np.copy, state))]
    whole, alone = state, [Diagnosers(*(a[b : b + 1] for a in state)) for b in range(5)]
    for k in range(4):
        whole, alarm = network_step(areas, used[1] if k else state, given, ALPHA, LAM, mode=mode, out=used[0])
        used = [used[1], used[0]]
        for b in range(5):
            one = NetworkReadings(*(a[b : b + 1] for a in given))
            alone[b], by_itself = network_step(areas, alone[b], one, ALPHA, LAM, mode=mode)
            for together, single in zip((*whole, alarm), (*alone[b], by_itself), strict=True):
                assert together[b : b + 1].tobytes() == single.tobytes()


def test_batches_have_any_leading_axes_and_are_broadcast() -> None:
    areas = NETWORKS["paper"]
    state, given = anything(areas, 6)
    whole = consensus.predict(areas, state, given.reference, given.load[:1], LAM, "corrected")
    several = Diagnosers(*(a.reshape(2, 3, *a.shape[1:]) for a in state))
    found = consensus.predict(areas, several, given.reference.reshape(2, 3, -1), given.load[:1], LAM, "corrected")
    for a, b in zip(found, whole, strict=True):
        assert a.shape == (2, 3, *b.shape[1:]) and a.tobytes() == b.tobytes()
    kept = consensus.take(areas, found, given.own.reshape(2, 3, 15, 4), given.shared.reshape(2, 3, -1))
    for a, b in zip(kept, consensus.take(areas, whole, given.own, given.shared), strict=True):
        assert a.tobytes() == b.tobytes()
    turned = Diagnosers(*(np.asfortranarray(a) for a in state))  # memory in another order
    ahead = consensus.predict(areas, turned, given.reference, given.load[:1], LAM, "corrected")
    ahead = consensus.Prediction(*(np.asfortranarray(a) for a in ahead))
    for a, b in zip(consensus.take(areas, ahead, given.own, given.shared), kept, strict=True):
        np.testing.assert_array_equal(a, b.reshape(a.shape))
    with pytest.raises(ValueError, match="mode is 'papr'"):
        consensus.predict(areas, state, given.reference, given.load, LAM, "papr")
    with pytest.raises(ValueError, match="broadcast"):
        consensus.predict(NETWORKS["dense"], state, given.reference, given.load, LAM, "corrected")


def test_diagnosers_without_information_start_from_their_first_readings() -> None:
    areas = NETWORKS["paper"]
    _, given = anything(areas, 1)
    now, alarm = network_step(areas, initial_state(areas, (1,)), given, ALPHA, LAM)
    assert not alarm.any() and not now.residual.any()
    read = np.isfinite(given.own)
    np.testing.assert_array_equal(now.held[read], given.own[read])
    np.testing.assert_array_equal(now.error_bound[~read] > 1e50, True)


def test_wrong_shapes_are_rejected() -> None:
    areas = NETWORKS["paper"]
    state, given = anything(areas, 2)
    for name, array in given._asdict().items():
        with pytest.raises(ValueError, match="have the shapes"):
            network_step(areas, state, given._replace(**{name: array[..., :-1]}), ALPHA, LAM)
    with pytest.raises(ValueError, match="have the shapes"):
        network_step(areas, state, given._replace(own=given.own[:0], shared=given.shared[:0]), ALPHA, LAM)
    with pytest.raises(ValueError, match="have the shapes"):
        network_step(NETWORKS["dense"], state, given, ALPHA, LAM)
    with pytest.raises(ValueError, match="mode is 'papr'; known: corrected, paper"):
        network_step(areas, state, given, ALPHA, LAM, mode="papr")
    for wrong in (state, initial_state(areas, (1,))):
        with pytest.raises(ValueError, match="not needed any more"):
            network_step(areas, state, given, ALPHA, LAM, out=wrong)
