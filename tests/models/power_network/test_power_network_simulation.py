"""Runs of the network: seeds, noise, open ties, unplugged areas, faults."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from network_loop import MODEL, closed_loop

from fusion_sfdia.models.power_network.control import generation_control
from fusion_sfdia.models.power_network.model import NOISE_VARIANCE, network_model
from fusion_sfdia.models.power_network.operation import AreaFault, Switch, load_profile
from fusion_sfdia.models.power_network.parameters import LoadStep, load_steps


def test_a_run_depends_on_its_own_seed_alone() -> None:
    alone = closed_loop(generation_control, 20, seeds=[7], process_noise=True)
    among_others = closed_loop(generation_control, 20, seeds=[3, 7], process_noise=True)
    for a, b in zip(alone, among_others, strict=True):
        assert np.array_equal(a.y[0], b.y[1]) and np.array_equal(a.x[0], b.x[1]) and np.array_equal(a.u[0], b.u[1])


def test_noise_has_the_stated_variances() -> None:
    moments = closed_loop(generation_control, 400, seeds=range(5), process_noise=True, loads=lambda t: np.zeros(15))
    read = np.array([m.own - m.x for m in moments])
    disturbed = np.array(
        [after.x - before.condition.step(before.x, after.reference, after.load) for before, after in pairwise(moments)]
    )
    for error, variance in ((read, np.array(NOISE_VARIANCE)), (disturbed, MODEL.process_cov)):
        samples = error.reshape(-1, 4)
        spread = 5 * np.sqrt(2 / len(samples))  # five standard errors
        assert samples.var(axis=0) == pytest.approx(variance, rel=spread)
    shared = np.array([m.shared - m.x[..., MODEL.network.topology.neighbour, 0] for m in moments])
    assert shared.var() == pytest.approx(NOISE_VARIANCE[0], rel=5 * np.sqrt(2 / shared.size))


def test_open_ties_are_not_read() -> None:
    model = network_model(unplugged=["15"])
    moments = closed_loop(generation_control, 12, model=model, switches=[Switch(10.0, plug_in=("15",))])
    at = model.network.topology
    with_15 = (at.node == 14) | (at.neighbour == 14)
    for m in moments:
        assert np.array_equal(np.isnan(m.shared[0]), with_15 if m.t < 10 else np.zeros(34, bool))
        assert np.all(np.isfinite(m.own)) and m.y.shape == (1, 94) and m.u.shape == (1, 30)


def test_an_unplugged_area_runs_by_itself() -> None:
    model = network_model(unplugged=["15"])
    others = load_profile(model, [LoadStep(2.0, "14", 0.3)])
    silent = np.zeros(15)
    x = np.zeros((15, 4))
    for k in range(10):
        x = model.step(x, silent, others(float(k)))
    assert not x[14].any() and np.abs(x[13]).max() > 0.01


def test_the_faults_of_the_paper_show_in_their_area() -> None:
    """Scenario 1, a governor that has stopped, and scenario 2, a reference of the wrong sign, each in its own valve first."""
    for scenario, fault in (
        ("1", AreaFault("governor", "4", 1000.0, onset=35.0)),
        ("2", AreaFault("input-gain", "5", -1.0, 45.0)),
    ):
        loads = load_profile(MODEL, load_steps(scenario))
        i, first = MODEL.network.topology.index(fault.area), int(fault.onset) + 1
        healthy, faulty = (closed_loop(generation_control, 60, loads=loads, faults=f) for f in ([], [fault]))
        shift = np.abs([a.x - b.x for a, b in zip(healthy, faulty, strict=True)])[:, 0]
        assert not shift[:first].any()
        assert np.argmax(shift[first].max(axis=1)) == i
        assert shift[55, i, 3] > 5 * np.sqrt(NOISE_VARIANCE[3])


def test_runs_that_do_not_fit() -> None:
    for settings, message in (({"seeds": []}, "at least one"), ({"steps": -1}, "steps is -1")):
        with pytest.raises(ValueError, match=message):
            closed_loop(generation_control, **settings)  # type: ignore[arg-type]
