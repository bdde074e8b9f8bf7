"""A fault that may have been there since the first sample is one of the sensor or an error of the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from fusion_sfdia import diagnose, run, simulate
from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors import RobustBank
from fusion_sfdia.detectors.kalman_banks.likelihood_window import Inflation, Weighed
from fusion_sfdia.detectors.kalman_banks.since_start import SINCE_START, SURE, nothing_ruled_out, seen_again
from fusion_sfdia.diagnosis.sentences import sentence, wordings
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plants import marine_engine, two_tanks
from fusion_sfdia.study.error_protocol import CASES, trial

SENSOR, ROWS = 7, 200  # of the engine, whose parameters do not move the readings as a bias of it does


def windows(a: np.ndarray, b: np.ndarray) -> Weighed:
    """Sums a, b (B, N) since one onset."""
    count = a.shape[-1]
    none = np.zeros((len(a), 1, 0, count))
    return Weighed(none, np.ones((len(a), 1)), a[:, None], b[:, None], np.ones((len(a), 1)), np.zeros((count, 0)))


def test_a_sample_rules_out_what_is_more_than_three_deviations_off() -> None:
    rng = np.random.default_rng(1)
    runs, information, inflation = 20_000, 4.0, 1.5
    a = rng.normal(0.0, np.sqrt(information * inflation), (runs, 1))
    grown = Inflation(np.full((runs, 1), inflation), np.full((runs, 1, 1), inflation))
    found = seen_again(
        nothing_ruled_out((runs,), 1), windows(a, np.full((runs, 1), information)), grown, np.ones((runs, 1), bool)
    )
    wrong = np.mean(~found.allows(np.zeros((runs, 1))))  # there is no fault: it must not be ruled out
    expected = 2 * norm.sf(SURE)
    assert abs(wrong - expected) < 4 * np.sqrt(expected / runs)


def test_the_sample_that_rules_out_most_counts_and_sensors_without_one_rule_out_nothing() -> None:
    b, alike = np.array([[1.0, 1.0, 0.0]]), Inflation(np.ones((1, 1)), np.ones((1, 1, 3)))
    now = nothing_ruled_out((1,), 3)
    for a in (0.0, -1.0, 2.0):
        now = seen_again(now, windows(np.array([[a, a, a]]), b), alike, np.array([[True, False, True]]))
    assert now.high.tolist() == [[SURE - 1, np.inf, np.inf]]
    assert now.low.tolist() == [[2 - SURE, -np.inf, -np.inf]]
    assert now.allows(np.array([[2.0, 99.0, 99.0]])).all()
    assert now.allows(np.array([[2.1, -99.0, -99.0]])).tolist() == [[False, True, True]]


@pytest.fixture(scope="module")
def engine() -> Plant:
    return marine_engine()


def readings(plant: Plant, begin: int, end: int = ROWS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A log (t, y, u) in which one sensor reads 10 sigma too high from one row to another."""
    recording = simulate(plant, ROWS, seeds=[5])
    y = recording.y[:, 0].copy()
    y[begin:end, SENSOR] += 10 * plant.sensor_sigma[SENSOR]
    return recording.t, y, recording.u


def test_a_fault_since_the_first_row_is_one_of_sensor_or_model(engine: Plant) -> None:
    bank = RobustBank(engine)
    t, y, u = readings(engine, 0)
    _, found = run(bank, bank.init(), t, y, u)
    assert not found.isolated.any()
    assert found.suspect is not None
    faulty, model = found.suspect[60:, SENSOR], found.suspect[60:, -1]
    assert faulty.all()
    assert model.all()
    assert bank.process_hypotheses[-1] == SINCE_START
    said = diagnose(bank, (t, y, u))
    name = engine.sensor_names[SENSOR]
    assert said.verdict == f"cannot tell: {name} or model since the start"
    [told] = [sentence(e, wordings(bank), Clock()) for e in said.events]
    assert "differed from the model from the first rows on" in told


def test_what_is_left_out_since_the_start_is_used_again_after_its_repair(engine: Plant) -> None:
    bank = RobustBank(engine)
    _, found = run(bank, bank.init(), *readings(engine, 0, 120))
    assert found.suspect is not None
    assert found.suspect[100].any()
    assert not found.suspect[160:].any()


def test_a_fault_that_begins_later_is_one_of_the_sensor(engine: Plant) -> None:
    bank = RobustBank(engine)
    _, found = run(bank, bank.init(), *readings(engine, 60))
    assert found.isolated[70:, SENSOR].all()
    assert not np.any(found.suspect[:, -1])


def test_where_sensors_have_been_seen_to_fit_a_fault_since_the_first_row_is_one_of_the_sensor(engine: Plant) -> None:
    plant = replace(engine, uncertainty=replace(engine.uncertainty, fits=True))
    bank = RobustBank(plant)
    _, found = run(bank, bank.init(), *readings(plant, 0))
    assert found.isolated[60:, SENSOR].all()
    assert SINCE_START not in bank.process_hypotheses


def test_unknowns_that_are_off_since_the_start_isolate_no_sensor() -> None:
    """Two tanks rest where their unknowns are two deviations off: an outlet is narrower, or the gauge above it wrong."""
    plant = two_tanks()
    off = replace(next(case for case in CASES if case.name == "all-unknowns-off"), start="rest")
    made = [trial(plant, off, seed, 80) for seed in (610003, 610006, 610007, 610018)]
    y, u = (np.stack([getattr(one.log, what) for one in made], axis=1) for what in ("y", "u"))
    bank = RobustBank(plant)
    _, found = run(bank, bank.init((len(made),)), made[0].log.t, y, u)
    assert not found.isolated.any()
    assert found.suspect is not None
    assert found.suspect[40:, :, plant.sensor_index("l2")].any(axis=0).all()
