"""network/governor: deterministic thresholds, unplugging after the detection, runs that depend on their seeds only."""

from __future__ import annotations

import numpy as np

from fusion_sfdia.benchmarks.network.support.trials import ALPHA, BOUND, LAM, WatchedRuns, deterministic_thresholds, trial
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import Switch
from fusion_sfdia.models.power_network.published import GOVERNOR
from fusion_sfdia.study.scenarios import scenario


def test_deterministic_thresholds_bound_the_residuals_of_bounded_noise() -> None:
    """The residuals of 200 steps with noise and disturbances of +- BOUND, by their own equation, stay below the thresholds."""
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


def test_a_run_depends_on_its_own_seed_only() -> None:
    one = scenario("network/governor")
    task = one.tasks({**one.settings, "noises": ("lit",), "modes": ("corrected",), "duration": 72.0}, 3)[0]
    together, alone = one.work(task), one.work({**task, "seeds": [2]})
    for name in ("detected", "false_alarms", "unplugged_angle", "unplugged_other_alarms"):
        assert np.array_equal(together[name][2:], alone[name]), name


def test_mechanical_power_and_valve_of_the_faulty_area_show_the_fault() -> None:
    """B18, sec. VIII-A: of the residuals of area 4, in order angle, speed, mechanical power, valve, these two leave their
    thresholds three times in a row within 25 s of the fault, both of them and before the others; with the same noise and a
    healthy governor none does.
    """
    model = network_model(unplugged=["15"])
    watch = WatchedRuns("4", GOVERNOR.fault.onset, "corrected")
    begun, runs = round(GOVERNOR.fault.onset / model.dt) + 1, range(3)
    shown = {}
    for faults in ((), (GOVERNOR.fault,)):
        found = [trial(model, watch, 60, [seed], loads=GOVERNOR.loads, faults=faults) for seed in runs]
        alarm = np.array([np.abs(a["residual"]) > ALPHA * a["deviation"] for a in found])[:, begun:]
        confirmed = alarm[:, :-2] & alarm[:, 1:-1] & alarm[:, 2:]  # (runs, steps, 4)
        shown[bool(faults)] = np.where(confirmed.any(axis=1), confirmed.argmax(axis=1), np.inf)
    assert np.isinf(shown[False]).all()
    assert np.isfinite(shown[True][:, 2:]).all()
    assert np.all(shown[True][:, 2:].min(axis=-1) < shown[True][:, :2].min(axis=-1))


def test_an_area_is_unplugged_at_the_step_after_its_detection() -> None:
    model, leaves = network_model(noise="small"), [Switch(50.0, unplug=("4",))]
    watch = WatchedRuns("4", 35.0, "corrected")
    kept, gone = (trial(model, watch, 60, [0], loads="1", faults=[], switches=s) for s in ((), leaves))
    for name in ("residual", "angles"):
        assert np.array_equal(kept[name][:50], gone[name][:50])
    assert np.array_equal(kept["angles"][50], gone["angles"][50])  # the step from 49 s on was joined still
    assert not np.array_equal(kept["angles"][51], gone["angles"][51])
    assert np.all(np.abs(gone["residual"][51:]) < 3 * ALPHA * gone["deviation"][51:])  # of its model alone; 6 deviations


def test_unplugging_the_faulty_area_keeps_its_neighbours_angles_smaller() -> None:
    """B18, sec. VIII-A: in each of 6 runs, from 70 s on, the angles of areas 3, 5 and 13 together."""
    one = scenario("network/governor")
    task = one.tasks({**one.settings, "noises": ("small",), "modes": ("corrected",)}, 6)[0]
    found, next_to_it = one.work(task), [network_model().network.topology.index(a) for a in ("3", "5", "13")]
    kept, gone = (np.sum(np.square(found[name][:, next_to_it]), axis=-1) for name in ("angle", "unplugged_angle"))
    assert np.all(gone < kept)
