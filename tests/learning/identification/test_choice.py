"""Several healthy logs with gaps: the kind of model that made them is chosen, and predicts other logs as well as it states."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from made_up_logs import DT, LOAD, SENSORS, STEPS, of_autoregression, of_factor

from fusion_sfdia.learning.checks.plants import check_plant
from fusion_sfdia.learning.identification.choice import Candidate, ModelChoice, candidates_for
from fusion_sfdia.learning.identification.healthy_runs import groups_of, runs_of
from fusion_sfdia.learning.identification.identify import identify
from fusion_sfdia.learning.innovations import WARM_UP, left_out
from fusion_sfdia.plant.log import Log

LOGS = 4
TRIED = (
    Candidate("autoregression", 1),
    Candidate("factors", 1),
    Candidate("autoregression", 1, True),
    Candidate("factors", 1, True),
)


def chosen(logs: list[Log], **changes: Any) -> ModelChoice:
    return ModelChoice.of("found", SENSORS, logs, **{"inputs": [LOAD], "candidates": TRIED, "folds": LOGS, **changes})


@pytest.fixture(scope="module")
def by_autoregression() -> ModelChoice:
    return chosen([of_autoregression(seed) for seed in range(LOGS)])


@pytest.fixture(scope="module")
def by_factor() -> ModelChoice:
    return chosen([of_factor(seed) for seed in range(LOGS)])


def test_the_kind_that_made_the_readings_is_chosen_and_the_scores_are_shown(
    by_autoregression: ModelChoice, by_factor: ModelChoice
) -> None:
    assert by_autoregression.chosen == Candidate("autoregression", 1)
    assert by_factor.chosen == Candidate("factors", 1)
    for found in (by_autoregression, by_factor):
        likelihoods = [s.log_likelihood for s in found.scores]
        assert len(likelihoods) == len(TRIED) and likelihoods == sorted(likelihoods, reverse=True)
        text = str(found)
        assert f"{found.chosen}; chosen of {len(TRIED)}" in text and "4 groups of logs left out" in text
        assert all(f"{s.log_likelihood:.3f}" in text for s in found.scores)


def test_gains_that_depend_on_the_load_are_found_where_they_are() -> None:
    found = chosen([of_factor(seed, bend=0.01) for seed in range(LOGS)])
    assert found.chosen == Candidate("factors", 1, quadratic=True)


@pytest.mark.parametrize("which", ["autoregression", "factor"])
def test_a_fresh_log_is_predicted_as_well_as_stated(which: str, request: pytest.FixtureRequest) -> None:
    """NIS of n white readings has the standard error sqrt(2 / n): 4 of them, of the fresh logs and of the scale's together; 0.1
    for a load that the logs have not seen.
    """
    plant = request.getfixturevalue(f"by_{which}").plant
    make = {"autoregression": of_autoregression, "factor": of_factor}[which]
    found = left_out(plant, [make(seed) for seed in range(50, 54)], np.ones(4))
    assert found.readings == 4 * 4 * (STEPS - WARM_UP)
    assert found.chi_square / found.readings == pytest.approx(1.0, abs=4 * np.sqrt(2 * 2 / found.readings) + 0.1)


def test_coefficients_of_the_autoregression_are_those_of_the_truth(by_autoregression: ModelChoice) -> None:
    """A coefficient's standard error is at most sqrt(S / (K var y)), below 0.06 here; four of them, and the ridge."""
    plant = by_autoregression.plant
    F = plant.step_jacobian_at(0.0, plant.x0, plant.input_at(0.0), DT)
    assert np.diag(F) == pytest.approx([0.7, 0.6, 0.7, 0.6], abs=0.15)
    assert F[[0, 1, 3], [2, 0, 2]] == pytest.approx(0.0, abs=0.15)


def test_the_plants_keep_the_contract_and_can_be_pickled(by_autoregression: ModelChoice, by_factor: ModelChoice) -> None:
    for found in (by_autoregression, by_factor):
        check_plant(found.plant)
        assert np.array_equal(pickle.loads(pickle.dumps(found.plant)).process_cov, found.plant.process_cov)
        assert [s.unit for s in found.plant.sensors] == [s.unit for s in SENSORS] and found.plant.dt == DT


def test_several_logs_are_identified_by_the_choice() -> None:
    logs = [Log(t, y[:, :2], u[:, :0]) for t, y, u in (of_factor(seed, 60) for seed in range(3))]
    plant = identify("found", SENSORS[:2], logs, folds=3)
    assert np.array_equal(plant.process_cov, ModelChoice.of("found", SENSORS[:2], logs, folds=3).plant.process_cov)


def test_gaps_and_unknown_inputs_begin_a_new_run_and_missing_readings_do_not() -> None:
    t, y, u = of_factor(3, 100)
    t = t + np.where(np.arange(100) >= 40, 1000.0, 0.0)
    u[70] = np.nan
    y[10:20, 1] = np.nan
    found = runs_of(SENSORS, [LOAD], [Log(t, y, u), of_factor(4, 50)])
    assert [len(run.t) for run in found.logs] == [40, 30, 29, 50] and found.of == (0, 0, 0, 1) and found.dt == DT
    with_gaps = [Log(t, y, u), *(of_factor(seed) for seed in range(2))]
    assert np.isfinite(chosen(with_gaps, candidates=TRIED[1:2]).scores[0].log_likelihood)


def test_skipped_rows_are_rows_without_readings() -> None:
    kept = np.random.default_rng(3).random(STEPS) > 0.2
    kept[[0, -1]] = True
    whole = of_factor(5)
    found = runs_of(SENSORS, [LOAD], [whole.rows(kept)])
    (run,) = found.logs
    np.testing.assert_allclose(run.t, whole.t, rtol=1e-12)
    np.testing.assert_array_equal(run.y, np.where(kept[:, None], whole.y, np.nan))
    assert np.isfinite(run.u).all()


def test_parts_of_one_log_are_left_out_together_and_of_few_logs_stretches() -> None:
    t, y, u = of_factor(3, 100)
    broken = Log(t + np.where(np.arange(100) >= 40, 1000.0, 0.0), y, u)
    by, groups = groups_of(runs_of(SENSORS, [LOAD], [broken, of_factor(1), of_factor(2)]), 3)
    assert by == "logs" and [[len(run.t) for run in g] for g in groups] == [[40, 60], [STEPS], [STEPS]]
    by, groups = groups_of(runs_of(SENSORS, [LOAD], [broken]), 4)
    assert by == "stretches" and [[len(run.t) for run in g] for g in groups] == [[25], [15, 10], [25], [25]]


def test_a_sensor_that_never_moves_is_left_out_and_reported() -> None:
    logs = [of_factor(seed) for seed in range(LOGS)]
    for log in logs:
        log.y[:, 1] = 7.0
    found = chosen(logs, candidates=TRIED[1:2])
    assert found.still == ("b",) and found.plant.sensor_names == ("a", "c", "d")
    assert "never moved, and not in the model: b" in str(found)


def test_a_candidate_that_cannot_be_identified_is_shown_with_its_reason() -> None:
    found = chosen([of_factor(seed) for seed in range(LOGS)], candidates=(Candidate("factors", 4), TRIED[1]))
    assert found.scores[1].candidate.order == 4 and "4 factors of 4 sensors" in str(found)


def test_default_candidates_fit_the_plant() -> None:
    assert not any(c.quadratic for c in candidates_for(3, 0))
    assert max(c.order for c in candidates_for(3, 2) if c.kind == "factors") == 2
    assert any(c.quadratic for c in candidates_for(3, 2))


T, Y, U = of_factor(0, 60)


@pytest.mark.parametrize(
    ("logs", "message"),
    [
        ([], "no healthy logs"),
        ([Log(T, Y[:, :2], U)], r"healthy log 1: t \(60,\), y \(60, 2\)"),
        ([(T, Y)], "healthy log 1 has 2 parts"),
        ([Log(T, Y, U), Log(T[::-1], Y, U)], "healthy log 2: the times do not rise"),
        ([Log(np.exp(T), Y, U)], "resample the logs"),
        ([Log(T, np.where(Y == Y[3], np.inf, Y), U)], "infinite"),
        ([Log(T, Y, np.nan * U)], "leave out the inputs"),
        ([Log(T, Y * [1.0, np.nan, 1.0, 1.0], U)], "sensor 'b' has no reading"),
        ([Log(T, 0 * Y, U)], "no sensor ever moves"),
        ([Log(T[:3], Y[:3], U[:3])], "no model can be identified from 3 samples"),
    ],
)
def test_logs_that_do_not_fit_are_refused(logs: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        chosen(logs)
