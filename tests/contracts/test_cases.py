"""The cases beside every plant: they build, they differ from the usual truth, and a right verdict has names that exist."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.hypotheses import Hypotheses
from fusion_sfdia.plant.uncertainty import equation_of, error_of
from fusion_sfdia.study.cases import case_readings
from fusion_sfdia.study.comparison.protocol import SETTINGS, mismatch_cases
from fusion_sfdia.study.comparison.recordings import mismatched
from fusion_sfdia.study.comparison.subjects import cases_of, compared_plant, plant_of

PLANTS = [name for name, entry in registry.plants().items() if entry.cases]
STEPS, START = 12, 6  # samples
LEAST_UNSEEN = 3


@pytest.mark.parametrize("plant", PLANTS)
def test_what_a_verdict_may_name_is_known_of_the_plant(plant: str) -> None:
    model = registry.plant(plant)
    known = {*(p.name for p in model.uncertainty.parameters), *(s.name for s in (*model.inputs, *model.states))}
    for case in cases_of(compared_plant(plant)).process_faults:
        assert case.named, f"{plant}: process fault {case.name} names nothing"
        assert set(case.named) <= known, f"{plant}, {case.name}: unknown {set(case.named) - known}"


@pytest.mark.parametrize("plant", PLANTS)
def test_what_a_right_verdict_names_is_a_hypothesis_about_the_process(plant: str) -> None:
    """Of `robust-glr`: the parameter, the error of the input or of the equation of the state of each name."""
    hypotheses = {h.name for h in Hypotheses(registry.plant(plant)).process}
    for case in cases_of(compared_plant(plant)).process_faults:
        for name in case.named:
            assert hypotheses & {name, error_of(name), equation_of(name)}, (
                f"{plant}, {case.name}: nothing is called after {name}"
            )


@pytest.mark.parametrize("plant", PLANTS)
def test_there_are_unseen_cases_which_the_comparison_leaves_out(plant: str) -> None:
    cases = cases_of(compared_plant(plant))
    unseen = {c.name for c in cases.mismatch if c.unseen}
    assert len(unseen) >= LEAST_UNSEEN
    tried = {c.name for c in mismatch_cases(SETTINGS, cases)}
    assert tried and not tried & unseen and tried | unseen == {c.name for c in cases.mismatch}


@pytest.mark.slow
@pytest.mark.parametrize("plant", PLANTS)
def test_every_unseen_case_changes_what_is_read(plant: str) -> None:
    of = compared_plant(plant)
    usual = case_readings(plant_of(of), STEPS, (0, 1))
    for case in cases_of(of).mismatch:
        assert pickle.loads(pickle.dumps(case)).name == case.name
        other = mismatched(of, case, STEPS, (0, 1), START * plant_of(of).dt)
        assert np.isfinite(other.y).all() and other.y.shape == usual.y.shape
        assert np.any(other.signal != usual.signal) or np.any(other.u != usual.u), case.name


@pytest.mark.parametrize("plant", PLANTS)
def test_the_other_operation_is_another_within_the_limits_of_the_inputs(plant: str) -> None:
    of = compared_plant(plant)
    model, other = plant_of(of), cases_of(of).other_operation
    assert other is not None
    times = np.arange(200) * model.dt
    u, usual = (np.array([f(t) for t in times]) for f in (lambda t: other(t, 60 * model.dt), model.input_at))
    assert np.any(np.abs(u - usual) > 1e-3 * np.abs(usual).max(axis=0))
    for j, signal in enumerate(model.inputs):
        assert np.all((u[:, j] >= signal.low) & (u[:, j] <= signal.high)), signal.name
