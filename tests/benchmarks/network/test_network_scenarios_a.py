"""Scenarios of the power network with a faulty area: tiny runs, published numbers, detection and isolation by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fusion_sfdia.benchmarks.network import attacks
from fusion_sfdia.benchmarks.network import sign_flip as flip
from fusion_sfdia.benchmarks.network.support.rows import spread, teller, time_rows
from fusion_sfdia.benchmarks.network.support.trials import ALPHA, BOUND, LAM, Watch, deterministic_thresholds, gather, trial
from fusion_sfdia.models.power_network.accommodation import Compensated
from fusion_sfdia.models.power_network.control import generation_control
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import Switch
from fusion_sfdia.models.power_network.published import ATTACKS, GOVERNOR, SIGN_FLIP
from fusion_sfdia.registry import scenario
from fusion_sfdia.report.content import Summary

MINE = {
    "network/governor": {"noises": ("lit",), "duration": 75.0},
    "network/sign-flip": {"noises": ("small",), "modes": ("corrected",), "cases": tuple(flip.CASES)[:2], "duration": 75.0},
    "network/attacks": {"noises": ("lit",), "faults": ("-u", "slow governor"), "duration": 75.0},
}


def summary(name: str, seeds: int, **changes: Any) -> Summary:
    one = scenario(name)
    settings = {**one.settings, **changes}
    return one.summarise(settings, [(t, one.work(t)) for t in one.tasks(settings, seeds)])


@pytest.mark.parametrize("name", MINE)
def test_a_scenario_runs_to_its_rows_and_figures(name: str) -> None:
    found = summary(name, 2, **MINE[name])
    assert found.rows and found.figures and found.tables and found.remarks and found.highlights
    assert {(r.scenario, r.plant) for r in found.rows} == {(name, "power-network")}
    keys = [(r.detector, r.fault, r.quantity, r.metric) for r in found.rows]
    assert len(set(keys)) == len(keys)
    for r in found.rows:
        assert np.isnan(r.low) or r.low <= r.value <= r.high, r
    for figure in found.figures:
        assert figure.draw().axes and figure.alt and figure.caption


def test_published_times_say_where_they_stand() -> None:
    delay, at = GOVERNOR.delay(GOVERNOR.detected), GOVERNOR.at(GOVERNOR.detected)
    assert delay is not None and at is not None
    assert (delay.value, at.value) == (8.0, 43.0) and "VIII-A" in delay.source
    times = (SIGN_FLIP.detected, SIGN_FLIP.isolated, SIGN_FLIP.reconfigured)
    assert [p and p.value for p in map(SIGN_FLIP.delay, times)] == [3.0, 16.0, 22.0]
    assert GOVERNOR.delay(GOVERNOR.isolated) is None
    assert [fault.value for _, fault in ATTACKS if fault] == [-1.0, 2.0, 10.0]


def test_what_times_say() -> None:
    tell = teller("s", "paper", "f", "area 4")
    rows = {r.metric: r.value for r in time_rows(tell, "detection", np.array([40.0, 44.0, np.inf]), 35.0, None, None)}
    assert rows == {"detection_delay": 7.0, "first_alarm_time": 40.0, "first_alarm_time_p5": 40.0, "first_alarm_time_p95": 44.0}
    assert spread(np.array([40.0, 44.0, np.inf])) == "44 [40-never]"
    empty = time_rows(tell, "isolation", np.array([np.inf]), 35.0, None, None)
    assert all(np.isnan(r.value) and r.n == 0 for r in empty)


def test_deterministic_thresholds_hold_what_is_bounded() -> None:
    """The residuals of 200 steps with noise and disturbances of +- BOUND, by their very equation, stay below."""
    model = network_model()
    areas = network_areas(model)
    rng = np.random.default_rng(0)
    at, (count, n, _) = model.network.topology, areas.size
    bounds, residual, largest = deterministic_thresholds(areas), np.zeros((50, count, n)), 0.0
    for _ in range(200):
        own, w, after = BOUND * rng.choice([-1.0, 1.0], size=(3, 50, count, n))
        theirs = BOUND * rng.choice([-1.0, 1.0], size=(50, at.node.size))
        inflow = np.add.reduceat(areas.slope * theirs, at.start[:-1], axis=-1)
        change = np.einsum("irc,bic->bir", areas.matrices[..., :n], own) + areas.matrices[..., n + 1] * inflow[..., None]
        residual = LAM * residual - change + w + after
        largest = max(largest, float(np.max(np.abs(residual) / bounds)))
    assert 0.5 < largest <= 1.0  # all signs at once are rare, none exceed


def flipped(**changes: Any) -> dict[str, Any]:
    watch = {"area": "5", "onset": 45.0, "mode": "corrected", "hypotheses": ATTACKS} | changes
    return trial(network_model(noise="small"), Watch(**watch), 75, range(6), loads="2", faults=[SIGN_FLIP.fault])


def test_a_sign_flip_is_detected_isolated_and_made_up_for() -> None:
    alone, helped = flipped(), flipped(reconfigure=True)
    for found in (alone, helped):  # the same until the isolation
        assert np.all((found["detected"][:, 1] >= 48.0) & (found["detected"][:, 1] <= 51.0))
        assert np.all(found["first_answer"] == 0) and np.all(found["answered"] >= found["detected"][:, 1] + 3)
        assert np.array_equal(found["detected"], alone["detected"])
    assert np.all(helped["angle"][:, 4] < 0.5 * alone["angle"][:, 4])
    k = int(helped["answered"][0]) + 1  # acts on the step that begins at the isolation
    assert np.array_equal(helped["reference"][:k], alone["reference"][:k])
    assert helped["reference"][k, 4] == -alone["reference"][k, 4]
    assert np.array_equal(helped["reached"][46:, 4], -helped["reference"][46:, 4])  # by a fault that acts from 45 s on
    assert np.array_equal(helped["reached"][:46], helped["reference"][:46])
    # once they know how the input acts, the diagnosers have no alarms of it: 0.6 % a step each of what is Gaussian
    late = np.abs(helped["residual"][k + 3 :]) > ALPHA * helped["deviation"][k + 3 :]
    assert np.mean(late) < 0.1


def test_runs_are_their_seeds_whatever_runs_beside_them() -> None:
    one = scenario("network/governor")
    task = one.tasks({**one.settings, "noises": ("lit",), "modes": ("corrected",), "duration": 72.0}, 3)[0]
    together, alone = one.work(task), one.work({**task, "seeds": [2]})
    for name in ("detected", "false_alarms", "unplugged_angle", "unplugged_other_alarms"):
        assert np.array_equal(together[name][2:], alone[name]), name


def test_an_area_is_unplugged_at_the_step_after_its_detection() -> None:
    model, leaves = network_model(noise="small"), [Switch(50.0, unplug=("4",))]
    watch = Watch("4", 35.0, "corrected")
    kept, gone = (trial(model, watch, 60, [0], loads="1", faults=[], switches=s) for s in ((), leaves))
    for name in ("residual", "angles"):
        assert np.array_equal(kept[name][:50], gone[name][:50])
    assert np.array_equal(kept["angles"][50], gone["angles"][50])  # the step from 49 s on was joined still
    assert not np.array_equal(kept["angles"][51], gone["angles"][51])
    assert np.all(np.abs(gone["residual"][51:]) < 3 * ALPHA * gone["deviation"][51:])  # of its model alone; 6 deviations


def test_a_reference_is_divided_by_its_known_gain_and_stays_within_limits() -> None:
    model, y, load = network_model(), np.zeros((2, 15, 4)), np.full(15, 0.2)
    gain = np.ones((2, 15))
    gain[1, :3] = -1.0, 10.0, 0.1
    control = Compensated(generation_control, gain)
    assert control(model, y, load)[1, :4].tolist() == pytest.approx([-0.2, 0.02, 0.65, 0.2], rel=1e-12)
    gain[0, 0] = 0.0
    with pytest.raises(ValueError, match="unplug the area"):
        control(model, y, load)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("network/governor", {"noises": ("large",)}, "one of noises 'large'"),
        ("network/governor", {"duration": 60.0}, "area 15 joins at 70 s"),
        ("network/sign-flip", {"cases": ("two",)}, "one of cases 'two'"),
        ("network/sign-flip", {"controller": "none"}, "controller 'none'"),
        ("network/attacks", {"faults": ("3u",)}, "one of faults '3u'"),
    ],
)
def test_settings_that_do_not_fit(name: str, change: dict[str, Any], message: str) -> None:
    one = scenario(name)
    with pytest.raises(ValueError, match=message):
        one.tasks({**one.settings, **change}, 1)


def test_the_right_answer_to_a_fault_in_no_set_is_none_of_these() -> None:
    assert [attacks._right(f) for f in ("-u", "slow governor")] == ["-u", "none of these"]
    assert attacks._named(np.array([0, 0, 3, 0]), ATTACKS) == "-u 75%, none of these 25%"


def test_runs_of_several_tasks_stand_side_by_side_and_one_is_shown() -> None:
    names = ("answer", "alone_angle", "t", "alone_reached", "unplugged_bounds")
    parts = [({"k": 1}, dict.fromkeys(names, np.full(2, v))) for v in (1, 2)]
    both = gather(parts, lambda task: task["k"])[1]
    assert [both[name].tolist() for name in names] == [[1, 1, 2, 2]] * 2 + [[1, 1]] * 3
