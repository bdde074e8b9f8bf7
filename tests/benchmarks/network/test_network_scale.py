"""network/scale: rows of each size, memory as the sum of the arrays, and two processes if a cluster is installed."""

from __future__ import annotations

import math
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.benchmarks.network import scale as network_scale
from fusion_sfdia.report.content import Summary
from fusion_sfdia.study.experiments.timing import best_times
from fusion_sfdia.study.scenarios import scenario

SCALE = scenario("network/scale")


def run(**changes: Any) -> Summary:
    settings = {**SCALE.settings, "seconds": 1e-3, "parts": (), "robust": (), **changes}
    return SCALE.summarise(settings, [(task, SCALE.work(task)) for task in SCALE.tasks(settings, 1)])


def test_each_size_has_its_times_and_its_memory() -> None:
    summary = run(areas=(15, 40))
    found = {(r.quantity, r.condition, r.metric): r for r in summary.rows}
    assert len(found) == len(summary.rows)
    assert all(r.value > 0 and r.n > 0 and r.scenario == "network/scale" for r in summary.rows)
    for areas in (15, 40):
        step, one = found[f"{areas} areas", "", "step_time"], found[f"one of {areas} areas", "", "step_time"]
        assert math.isclose(one.value * areas, step.value)
        # an area: model 4 x 6, its weight and deviations 1 + 2 x 4, readings and inputs 6, two states of 4 x 4, its start,
        # alarm; a side: slope, weight and deviation, reading, two states of 4, its opposite and reader, whether it is closed;
        # once: one start more
        sides = network_scale.network_of(areas).network.topology.node.size
        expected = 8 * (areas * (24 + 9 + 6 + 32 + 1) + sides * (1 + 2 + 1 + 8 + 2) + 1) + areas + sides
        assert found[f"one of {areas} areas", "", "peak_memory"].value == expected / areas
        assert (f"{areas} areas", "in place", "replug_time") in found
    assert found["one of 15 areas", "", "step_time"].published == 4.1e-3
    assert len(summary.figures) == 1 and summary.figures[0].draw().axes
    assert any("needs the packages distributed and cryptography" in remark for remark in summary.remarks)


def test_robust_banks_have_their_times_memory_and_growth() -> None:
    summary = run(areas=(15,), robust=(15, 30))
    found = {(r.quantity, r.metric): r for r in summary.rows if r.detector == "robust-glr:areas"}
    for areas in (15, 30):
        step, one = found[f"{areas} areas", "step_time"], found[f"one of {areas} areas", "step_time"]
        assert step.value > 0 and math.isclose(one.value * areas, step.value)
        # at least two windows of eta before and after: 10 and 13 onsets, 9 states, 14 and 10 hypotheses of an area of one tie
        assert found[f"one of {areas} areas", "peak_memory"].value > 2 * 4 * 9 * (6 * 14 + 7 * 10)
    assert any("from 15 to 30 areas: 1 is linear" in remark for remark in summary.remarks)
    assert "areas: 1 is linear" not in " ".join(run(areas=(15,), robust=(15,)).remarks)


def test_timed_steps_continue_the_run() -> None:
    areas = network_scale.network_areas(network_scale.network_of(15), named=False)
    step, arrays = network_scale.stepping(areas)
    for _ in range(3):
        step()
    settled = [a for a in arrays if a.shape == (1, 15, 4)]
    assert sum(np.all((a > 0) & (a < 1)) for a in settled) >= 1  # the deviations, which the diagnosers start without


@pytest.mark.skipif(not all(map(find_spec, network_scale.CLUSTER)), reason="needs distributed and cryptography")
def test_two_processes_are_compared_with_one_and_accept_their_certificate_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """One cluster for both: of the sizes on two processes the smallest alone is run."""
    import distributed

    seen: list[Any] = []

    class Watched(distributed.LocalCluster):
        def __init__(self, **options: Any) -> None:
            super().__init__(**options)
            seen.extend((self.scheduler_address, *(w.address for w in self.workers.values()), self.security.require_encryption))

    monkeypatch.setattr(distributed, "LocalCluster", Watched)
    settings = {**SCALE.settings, "seconds": 1e-3, "areas": (15,), "parts": (30,), "robust": ()}
    tasks = SCALE.tasks(settings, 1)
    assert [(t["kind"], t["areas"]) for t in tasks] == [("one", 15), ("parts", 15), ("parts", 30)]
    summary = SCALE.summarise(settings, [(task, SCALE.work(task)) for task in tasks[:2]])
    found = {(r.quantity, r.condition, r.metric): r.value for r in summary.rows}
    assert found["15 areas", "2 processes", "step_time"] > 0 and found["15 areas", "2 processes", "speedup"] < 1
    assert found["areas in a part", "two free cores", "break_even"] > 0
    *addresses, encrypted = seen
    assert encrypted and len(addresses) == 3 and all(a.startswith("tls://127.0.0.1:") for a in addresses)


def test_without_certificates_nothing_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network_scale, "find_spec", lambda name: None if name == "cryptography" else object())
    assert {t["kind"] for t in SCALE.tasks(SCALE.settings, 1)} == {"one", "robust"}
    monkeypatch.setattr(network_scale, "find_spec", lambda name: object())
    assert {t["kind"] for t in SCALE.tasks(SCALE.settings, 1)} == {"one", "robust", "parts"}


def test_times_by_another_clock() -> None:
    ticks = iter(range(1000))
    found = best_times({"a": lambda: None}, 5.0, clock=lambda: next(ticks))
    assert found["a"].best == 1.0
