"""The truth of a trial, what is counted in it, and an audit of a detector that survives and of one that does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fusion_sfdia import Plant, audit, check_plant, diagnose, run, simulate
from fusion_sfdia.detectors import LeaveOneOutBank, registry
from fusion_sfdia.plants import random_plant, two_tanks
from fusion_sfdia.study.audit import GRACE, KINDS, lasting, outcomes, result_of
from fusion_sfdia.study.error_protocol import CASES, Case, ErrorTrial, cases_for, trial
from fusion_sfdia.study.truths import Variation, declared, varied

BY_NAME = {case.name: case for case in CASES}


def test_a_trial_knows_which_sensor_fails_when() -> None:
    plant, case = two_tanks(), BY_NAME["bias-30"]
    made = trial(plant, case, 3, 120)
    healthy = trial(plant, replace(case, sensors=(("bias", 1e-12),)), 3, 120)
    assert made.faulty.sum() == 40
    assert made.faulty[40:80].any(axis=1).all()
    size = np.abs(made.log.y - healthy.log.y) / plant.sensor_sigma
    assert np.allclose(size[made.faulty], 30.0)
    assert np.all(size[~made.faulty] < 1e-9)
    assert not made.process.any()
    again = trial(plant, case, 3, 120)
    assert np.array_equal(made.log.y, again.log.y)


def test_a_truth_off_by_its_parameters_is_the_plant_built_with_them() -> None:
    plant = two_tanks()
    off = [Variation(p.name, 0.1 * p.nominal) for p in plant.uncertainty.parameters if p.name.startswith("outlet")]
    truth, other = varied(plant, off), two_tanks(outlet=1.1)
    found, expected = (simulate(plant, 50, [0], truth=of, start=plant.x0).signal for of in (truth, other))
    assert np.allclose(found, expected, rtol=1e-12)  # 50 steps of the same equations, rounded
    assert not np.allclose(found, simulate(plant, 50, [0], truth="model").signal, rtol=1e-3)
    with pytest.raises(ValueError, match="declares no 'colour'"):
        varied(plant, [Variation("colour", 1.0)])


@pytest.mark.parametrize(("profile", "ends"), [("pulse", 20), ("step", 40), ("ramp", 40)])
def test_changes_of_the_process_begin_and_end_as_stated(profile: str, ends: int) -> None:
    plant = two_tanks()
    changes = Variation(declared(plant)[0].name, 1.0, profile, 40 * plant.dt, 40 * plant.dt)
    values = np.array([changes.at(k * plant.dt, plant.dt) for k in range(120)])
    assert np.array_equal(np.flatnonzero(values), np.arange(40, 40 + ends))
    assert values.max() == 1.0


def test_every_row_that_is_judged_has_one_kind() -> None:
    detector = registry.detector("robust-glr", two_tanks())
    for name in ("ar-0.95", "two-biases", "process-step"):
        (found,), _ = outcomes(detector, BY_NAME[name], (1,), 150)
        assert len(found.counts) == len(KINDS)
        assert sum(found.counts[1:]) == found.judged


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param("robust-glr", marks=pytest.mark.long), "loo-glr", "limits"])
def test_trials_that_are_run_together_have_the_outcomes_that_each_has_alone(name: str) -> None:
    detector = registry.detector(name, two_tanks())
    for case in ("ar-0.95", "two-biases", "process-step"):
        together, _ = outcomes(detector, BY_NAME[case], (1, 2, 3), 120)
        assert together == [outcomes(detector, BY_NAME[case], (seed,), 120)[0][0] for seed in (1, 2, 3)]


@pytest.mark.slow
def test_the_events_of_a_trial_are_those_of_a_diagnosis_of_its_log() -> None:
    """Among them none of a late sensor, which a diagnosis finds to be late."""
    plant = random_plant(511)
    detector = registry.detector("robust-glr", plant)
    for name, seed in (("late-sensor", 14005), ("bias-10", 3)):
        case = next(c for c in CASES if c.name == name)
        ((outcome,), _) = outcomes(detector, case, [seed])
        log = trial(plant, case, seed).log
        events = [e for e in diagnose(detector, log).events if e.kind == "sensor" and np.isfinite(e.confidence)]
        assert [c for c, _ in outcome.events] == pytest.approx([e.confidence for e in events])
        assert bool(events) is (name == "bias-10")


def test_a_trial_is_judged_as_a_diagnosis_of_its_log() -> None:
    """Readings in steps of 3 sigma, of which a diagnosis takes the rounding for noise: no sensor is isolated for it."""
    detector, case = registry.detector("loo-glr", two_tanks()), BY_NAME["steps-3"]
    logs = [trial(detector.plant, case, seed).log for seed in (0, 1)]
    raw = [run(detector, detector.init(t=-detector.plant.dt), log)[1].isolated for log in logs]
    found = [diagnose(detector, log).decisions.isolated for log in logs]
    assert sum(map(np.sum, raw)) > 0
    judged, _ = outcomes(detector, case, (0, 1))
    assert [o.counts[0] for o in judged] == [np.any(isolated, axis=-1).sum() for isolated in found]


def test_a_trial_outside_the_limits_of_the_plant_is_left_out_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def limited(plant: Plant, case: Case, seed: int, steps: int) -> ErrorTrial:
        if seed == 2:
            raise FloatingPointError("level 1 is below 0")
        return trial(plant, case, seed, steps)

    monkeypatch.setattr("fusion_sfdia.study.audit.trial", limited)
    found, why = outcomes(LeaveOneOutBank(two_tanks()), BY_NAME["bias-10"], (1, 2, 3), 120)
    result = result_of(BY_NAME["bias-10"], 3, found, why)
    assert (result.runs, result.absent, result.left_out) == (2, 1, "level 1 is below 0")


def test_a_repair_is_given_some_rows() -> None:
    held = np.zeros(100, bool)
    held[10:20] = True
    assert np.array_equal(np.flatnonzero(lasting(held)), np.arange(10, 20 + GRACE))


@pytest.mark.parametrize("seed", range(6))
def test_random_plants_are_plants(seed: int) -> None:
    plant = random_plant(seed)
    check_plant(plant)
    assert 3 <= len(plant.states) <= 12
    assert len(plant.uncertainty.parameters) == 1
    u = plant.input_at(0.0)
    f, h = plant.step_jacobian_at(0.0, plant.x0, u, plant.dt), plant.output_jacobian_at(0.0, plant.x0, u)
    assert np.max(np.abs(np.linalg.eigvals(f))) < 1
    observability = np.concatenate([h @ np.linalg.matrix_power(f, k) for k in range(len(plant.states))])
    assert np.linalg.matrix_rank(observability) == len(plant.states)
    moved = simulate(plant, 200, [0]).signal[:, 0]
    assert np.all(np.ptp(moved, axis=0) > 0)


@pytest.mark.slow
def test_an_audit_tells_what_a_detector_survives() -> None:
    detector = LeaveOneOutBank(two_tanks())
    found = audit(detector, seeds=(0, 1), steps=120, groups=("start", "cause"))
    by_name = {r.case.name: r for r in found.results}
    assert by_name["start-sampled"].survived
    assert by_name["bias-30"].shares["right"].value > 0.9
    assert str(found).count("\n") >= len(found.results)
    rows = found.rows()
    assert {r.metric for r in rows} >= {"false_isolation_probability", "wrong_verdict_probability"}
    slow = audit(detector, seeds=(0, 1), steps=120, groups=("readings",))
    assert not {r.case.name: r for r in slow.results}["ar-0.95"].survived
    assert "autoregressive, 0.95" in str(slow).splitlines()[-4] + str(slow).splitlines()[-1] + str(slow)


def test_a_plant_has_the_cases_that_it_can_have() -> None:
    bare = replace(two_tanks(), uncertainty=type(two_tanks().uncertainty)())
    names = {c.name for c in cases_for(bare)}
    assert "bias-10" in names
    assert not names & {"one-unknown-off", "process-step", "process-then-bias-0"}


def test_settings_that_do_not_fit_are_refused() -> None:
    detector = LeaveOneOutBank(two_tanks())
    with pytest.raises(ValueError, match="unknown group 'colour'"):
        audit(detector, groups=("colour",))
    with pytest.raises(ValueError, match="10 steps and 8 seeds; expected at least"):
        audit(detector, steps=10)


def test_a_case_is_data() -> None:
    assert isinstance(CASES[0], Case)
    assert len({c.name for c in CASES}) == len(CASES)
