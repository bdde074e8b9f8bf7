"""A network in parts: the bits of one process, in this process and on the workers of a cluster."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from fusion_sfdia.detectors.stochastic_thresholds.consensus import MODES, Diagnosers, NetworkReadings, initial_state
from fusion_sfdia.detectors.stochastic_thresholds.network_step import network_step
from fusion_sfdia.detectors.stochastic_thresholds.partitioned_network import (
    Part,
    PartitionedNetwork,
    at_borders,
    part_layouts,
    routes,
    share,
)
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.parameters import generate_network
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.plant import Array

ALPHA, LAM, BATCH, STEPS = 2.0, 0.3, 2, 6
AREAS = network_areas(network_model(generate_network(23, 3, degree=5.0), unplugged=["7", "8"]))


class Drawn(NamedTuple):
    """Readings of every area at each step, the same for every caller; a fifth are missing, and one area's are far off."""

    count: int
    n: int
    total: int

    def __call__(self, k: int, areas: tuple[int, int], sides: Array) -> NetworkReadings:
        rng = np.random.default_rng(k)
        own, shared = rng.standard_normal((BATCH, self.count, self.n)), rng.standard_normal((BATCH, self.total))
        reference, load = rng.standard_normal((2, BATCH, self.count))
        for a in (own, shared):
            a[rng.random(a.shape) < 0.2] = np.nan
        lo, hi = areas
        mine = own[:, lo:hi], shared[:, sides], reference[:, lo:hi], load[:, lo:hi]
        return NetworkReadings(*map(np.ascontiguousarray, mine))


SOURCE = Drawn(*AREAS.size)


def partly_read() -> Areas:
    """A fifth of the states and of the sensors at sides are missing for good."""
    rng = np.random.default_rng(6)
    noise, shared = (np.where(rng.random(a.shape) < 0.2, np.inf, a) for a in (AREAS.noise, AREAS.shared_noise))
    return replace(AREAS, noise=noise, shared_noise=shared)


def in_one_process(areas: Areas, mode: str, source: Drawn = SOURCE) -> tuple[Diagnosers, list[Array]]:
    count, _, total = areas.size
    state, alarms = initial_state(areas, (BATCH,)), []
    for k in range(STEPS):
        state, alarm = network_step(areas, state, source(k, (0, count), np.arange(total)), ALPHA, LAM, mode)
        alarms.append(alarm)
    assert 0 < np.mean(alarms) < 1
    return state, alarms


@pytest.mark.parametrize(("areas", "mode"), [(AREAS, "corrected"), (AREAS, "paper"), (partly_read(), "corrected")])
@pytest.mark.parametrize("size", [1, 2, 5, 23])
def test_parts_give_the_bits_of_the_whole(size: int, areas: Areas, mode: str) -> None:
    expected, alarms = in_one_process(areas, mode)
    found, start = part_layouts(areas, size), initial_state(areas, (BATCH,))
    parts = [Part(b, share(b, start), ALPHA, LAM, mode == "paper") for b in found]
    received, reader = at_borders(found, start), AREAS.network.topology.node
    for k in range(STEPS):
        answers = [
            p.step(received[..., r], SOURCE(k, b.areas, b.sides)) for p, b, r in zip(parts, found, routes(found), strict=True)
        ]
        received = np.concatenate([a[2] for a in answers], axis=-1)
        alarm = np.concatenate([a[0] for a in answers], axis=-1)
        for b, (_, beyond, _) in zip(found, answers, strict=True):
            for column, side in enumerate(b.sides[b.near :]):
                alarm[:, reader[side]] |= beyond[:, column]
        np.testing.assert_array_equal(alarm, alarms[k])
    for b, p in zip(found, parts, strict=True):
        mine = np.setdiff1d(np.arange(b.sides.size), b.border)
        for a, whole in zip(p.kept(), share(b, expected), strict=True):
            assert (a[:, mine] if a.ndim == 2 else a).tobytes() == (whole[:, mine] if a.ndim == 2 else whole).tobytes()
    assert sum(b.border.size for b in found) == received.shape[-1]


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    distributed = pytest.importorskip("distributed", reason="needs the optional package distributed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(
            "PYTHONPATH",
            os.pathsep.join(
                map(str, (Path(__file__).parent, Path(__file__).parents[2] / "helpers", Path(__file__).parents[3]))
            ),
        )
        with (
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address="127.0.0.1:0"
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as running,
        ):
            yield running


@pytest.mark.parametrize("mode", MODES)
def test_two_processes_give_the_bits_of_one(client: Any, mode: str) -> None:
    expected, alarms = in_one_process(AREAS, mode)
    network = PartitionedNetwork(client, AREAS, initial_state(AREAS, (BATCH,)), SOURCE, ALPHA, LAM, mode)
    for alarm in alarms:
        np.testing.assert_array_equal(network.step(), alarm)
    for a, b in zip(network.state(), expected, strict=True):
        assert a.tobytes() == b.tobytes()


def test_it_continues_from_its_state_with_other_parts(client: Any) -> None:
    _, alarms = in_one_process(AREAS, "corrected")
    network = PartitionedNetwork(client, AREAS, initial_state(AREAS, (BATCH,)), SOURCE, ALPHA, LAM)
    for _ in range(3):
        network.step()
    state, one = network.state(), list(client.scheduler_info(n_workers=-1)["workers"])[:1]
    count, _, total = AREAS.size
    for k in range(3, STEPS):
        state, alarm = network_step(AREAS, state, SOURCE(k, (0, count), np.arange(total)), ALPHA, LAM)
        np.testing.assert_array_equal(alarm, alarms[k])
    alone = PartitionedNetwork(client, AREAS, initial_state(AREAS, (BATCH,)), SOURCE, ALPHA, LAM, workers=one)
    np.testing.assert_array_equal(alone.step(), alarms[0])


def test_invalid_partitions_are_rejected(client: Any) -> None:
    start = initial_state(AREAS, (BATCH,))
    with pytest.raises(ValueError, match="mode is 'papr'"):
        PartitionedNetwork(client, AREAS, start, SOURCE, ALPHA, LAM, "papr")
    with pytest.raises(ValueError, match="no worker for a part"):
        PartitionedNetwork(client, AREAS, start, SOURCE, ALPHA, LAM, workers=[])


def test_a_part_receives_no_more_than_its_border() -> None:
    first, second, third = part_layouts(AREAS, 3)
    at = AREAS.network.topology
    for layout in (first, second, third):
        lo, hi = layout.areas
        inside = (at.node >= lo) & (at.node < hi)
        crossing = inside & ~((at.neighbour >= lo) & (at.neighbour < hi))
        assert layout.border.size == layout.sides.size - layout.near == crossing.sum()
    with pytest.raises(ValueError, match="23 areas cannot be shared by 24 parts; expected 1 to 23"):
        part_layouts(AREAS, 24)
