"""Events of sensors with what is known afterwards."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from process_bank import ProcessBank
from scipy.special import ndtri
from toy_plants import readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.detector import Claims, Decision
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.diagnose import Diagnosis, diagnose_run
from fusion_sfdia.diagnosis.model_health import limit_of
from fusion_sfdia.diagnosis.sensor_events import (
    alarm_rate_of,
    false_alarm_of,
    is_in_doubt,
    may_be_outliers,
    rivals_at,
)
from fusion_sfdia.plant.log import Log

PLANT = tanks()
BANK = LeaveOneOutBank(PLANT, false_alarm=1e-4)


def found(fault: dict[int, np.ndarray], **settings: object) -> Diagnosis:
    """The diagnosis of 120 samples with {sensor: fault (120,) in sigma}."""
    t, _, y, u = readings(PLANT, 120, 1, seed=0)
    y = y[:, 0].copy()
    for i, shape in fault.items():
        y[:, i] += PLANT.sensor_sigma[i] * shape
    return diagnose_run(BANK, Log(t, y, u[:, 0]), **settings)


def test_a_bias_is_an_event_with_size_interval_and_confidence() -> None:
    clock = Clock(datetime(2026, 3, 1, 14, 20, tzinfo=UTC))
    diagnosis = found({2: np.where(np.arange(120) >= 60, 9.0, 0.0)}, clock=clock)
    (e,) = diagnosis.events
    sigma = PLANT.sensor_sigma[2]
    assert (e.hypothesis, e.fault, e.open, e.alternatives) == ("q12", "bias", True, ())
    assert e.low < 9 * sigma < e.high and e.sigmas == pytest.approx(e.size / sigma) and e.confidence > 0.99
    assert e.high - e.low == pytest.approx(2 * (e.high - e.size)) and e.high - e.size < 1.96 * sigma
    assert str(diagnosis).splitlines()[1].startswith("  q12: 2026-03-01 14:25:05+00:00 to end of the log, bias ")
    header, rows = diagnosis.table()
    row = dict(zip(header, rows[0], strict=True))
    assert row["start"] == "2026-03-01 14:25:05+00:00" and row["fault"] == "bias" and row["start_s"] == 305.0
    assert diagnosis.health is not None and not diagnosis.health.suspect


def test_events_close_together_are_judged_together() -> None:
    shape = np.zeros(120)
    shape[[50, 58, 66, 75]] = [12.0, -12.0, 12.0, -12.0]
    events = found({1: shape}).events
    assert len(events) > 2 and {(e.hypothesis, e.fault) for e in events} == {("l2", "spikes")}
    assert [np.sign(e.size) for e in events] == [1, -1, 1, -1]


def test_the_probability_is_that_of_the_likelihood_ratios() -> None:
    scores = np.array([[1.0, 1.1, 0.2, 0.0]])
    nothing = np.zeros((1, 4))
    decisions = Decision(nothing, nothing, scores, np.ones((1, 4)), np.arange(4) == np.array([[1]]), *[nothing] * 4)
    own, others = rivals_at(BANK, decisions, 1, 0)
    q = ndtri(1e-4 / 4 / 2)
    weight = np.exp((scores[0] * q) ** 2 / 2)
    assert own == pytest.approx(weight[1] / weight.sum()) and others == ("l1",)
    twice = replace(decisions, isolated=np.array([[True, True, False, False]]))
    assert rivals_at(BANK, twice, 1, 0)[1] == ()  # isolated with it, not instead of it
    large = replace(decisions, residual=1e300 * scores)
    assert rivals_at(BANK, large, 1, 0)[0] == pytest.approx(1 / 3)  # of three that are too large for numbers


def test_an_event_is_in_doubt_where_its_sensor_is_a_suspect_after_it() -> None:
    nothing, none = np.zeros((3, 4)), np.zeros((3, 4), bool)
    decisions = Decision(nothing, nothing, nothing, np.ones((3, 4)), none, *[nothing] * 4)
    suspect = none.copy()
    suspect[2, 1] = True
    assert is_in_doubt(replace(decisions, suspect=suspect), 1, 1)
    assert not is_in_doubt(replace(decisions, suspect=suspect), 0, 1)  # another sensor
    assert not is_in_doubt(replace(decisions, suspect=suspect), 1, 0)  # later
    assert not is_in_doubt(replace(decisions, suspect=suspect), 1, 2)  # at the end of the log
    assert not is_in_doubt(decisions, 1, 1)  # of a detector without suspects


def test_two_large_residuals_may_be_outliers_and_three_are_a_fault() -> None:
    sd = np.ones(6)
    assert may_be_outliers(np.array([9.0, -9.0, 1.0, 2.4, np.nan, 0.0]), sd)
    assert not may_be_outliers(np.array([9.0, 9.0, 1.0, 2.6, np.nan, 0.0]), sd)
    assert not may_be_outliers(np.full(6, np.nan), sd)  # nothing is known of it


def test_an_event_of_two_outliers_is_as_likely_none() -> None:
    """So far its confidence was 1.0: the sensor had read 12 sigma off twice in a row."""
    t, _, y, u = readings(PLANT, 120, 1, seed=0)
    y = y[:, 0].copy()
    y[60:62, 2] += 12 * PLANT.sensor_sigma[2]
    for count, confident in ((2, False), (12, True)):
        y[90 : 90 + count, 1] += 12 * PLANT.sensor_sigma[1]
        events = [e for e in diagnose("robust-glr", t, y, u[:, 0], plant=PLANT).events if e.kind == "sensor"]
        (spike,) = [e for e in events if e.start < t[70]]
        assert spike.confidence <= 0.5
        (later,) = [e for e in events if e.start >= t[70]]
        assert (later.confidence > 0.9) is confident


def test_probabilities_of_the_detector_and_its_suspects_come_first() -> None:
    t, _, y, u = readings(PLANT, 40, 1, seed=0)
    y = y[:, 0].copy()
    y[20:, 2] += 20 * PLANT.sensor_sigma[2]
    bank = ProcessBank(PLANT, accept=(10**6, 10**6), doubt=(15, 21), between=(2, 5), false_alarm=1e-6)
    events = diagnose(bank, t, y, u[:, 0]).events
    (sensor,) = [e for e in events if e.kind == "sensor"]
    assert sensor.alternatives == ("error of inflow",) and str(sensor).endswith("; not excluded: error of inflow")


@pytest.mark.parametrize(("stated", "expected"), [(0.93, 0.93), (0.45, np.nan), (np.nan, np.nan)])
def test_a_change_of_the_process_has_the_probability_at_which_it_was_accepted(stated: float, expected: float) -> None:
    """Not that of later, when the estimate follows the change; none where the detector prefers something else."""
    t, _, y, u = readings(PLANT, 40, 1, seed=0)
    bank, log = ProcessBank(PLANT, accept=(10, 10**6)), Log(t, y[:, 0], u[:, 0])
    decisions = diagnose_run(bank, log).decisions
    assert decisions.probability is not None
    probability = np.full_like(decisions.probability, 1e-3)
    probability[int(np.argmax(decisions.process[:, 0])), 4] = stated
    seen = diagnose_run(bank, log, decisions=replace(decisions, probability=probability))
    (outlet,) = [e for e in seen.events if e.hypothesis == "outlet"]
    assert outlet.kind == "process" and (np.isnan(outlet.confidence) if np.isnan(expected) else outlet.confidence == expected)


def test_the_rate_is_that_of_the_detector() -> None:
    assert false_alarm_of(BANK) == 1e-4

    class Plain(Claims):
        plant = PLANT

    assert false_alarm_of(Plain()) == alarm_rate_of(Plain()) == 1e-3


def test_the_health_of_the_model_is_judged_at_the_rate_that_thresholds_were_fitted_to() -> None:
    fitted = replace(BANK, fitted_rate=1e-2, threshold_scale=0.8)
    assert (false_alarm_of(fitted), alarm_rate_of(fitted), alarm_rate_of(BANK)) == (1e-4, 1e-2, 1e-4)
    t, _, y, u = readings(PLANT, 40, 1, seed=0)
    found = [diagnose(detector, t, y[:, 0], u[:, 0]).health for detector in (BANK, fitted)]
    limits = [limit_of(rate, len(PLANT.sensors)) for rate in (1e-4, 1e-2)]
    assert [h.limit for h in found if h is not None] == limits and limits[0] < limits[1]
