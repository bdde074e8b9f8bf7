"""What is kept of a condition, checked by hand, and the laws of its numbers."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.comparison.protocol import HEALTHY, PROCESS, PUBLISHED, FaultCondition
from fusion_sfdia.comparison.records import BranchReadings
from fusion_sfdia.core.uncertainty import error_of
from fusion_sfdia.evaluation.cases import ProcessFaultCase
from fusion_sfdia.robustness.material import Branched
from fusion_sfdia.robustness.protocol import Condition, conditions, settle_of, slow_name
from fusion_sfdia.robustness.records import FIELDS, Kept, join, record
from fusion_sfdia.robustness.rows import area_of, names_of, numbers
from fusion_sfdia.robustness.variants import KNOWLEDGE, Variant, variants

SAMPLES, SEEDS, SENSORS = 11, 3, 2
LEAK = ProcessFaultCase("leak", "", lost=(0.9,), named=("inflow",))


def kept(kind: str, active: np.ndarray, hypotheses: tuple[str, ...] = ("rate", "error of inflow")) -> Kept:
    """Nothing isolated and no verdict yet."""
    case = LEAK if kind == PROCESS else None
    fault = FaultCondition("fault", kind, np.nan, SAMPLES, kind, case)
    nothing = np.zeros((SAMPLES, SEEDS, SENSORS))
    readings = BranchReadings(nothing, nothing, nothing, nothing, active, nothing)
    flags = (np.zeros((SAMPLES, SEEDS), bool) for _ in range(2))
    isolated, process = np.zeros((SAMPLES, SEEDS, SENSORS), bool), np.zeros((SAMPLES, SEEDS, len(hypotheses)), bool)
    return Kept(
        Branched(Condition("", fault), np.arange(SAMPLES, dtype=float), readings), *flags, isolated, process, hypotheses
    )


def test_a_sensor_fault_by_hand() -> None:
    """Seed 0: right from sample 4 on; seed 1: right and a healthy one from 6 on; seed 2: nothing, and a verdict."""
    active = np.zeros((SAMPLES, SEEDS, SENSORS), bool)
    active[..., 0] = True
    one = kept(PUBLISHED, active)
    one.isolated[4:, 0, 0] = one.isolated[6:, 1, 0] = one.isolated[6:, 1, 1] = True
    one.alarm[:] = one.isolated.any(axis=-1)
    one.process[5:, 2, 0] = one.process[9:, 2, 1] = True
    found = record(one)
    assert set(found) == set(FIELDS)
    np.testing.assert_array_equal(found["samples"], [SAMPLES] * SEEDS)
    np.testing.assert_array_equal(found["exact"], [7, 0, 0])
    np.testing.assert_array_equal(found["falsely_isolated"], [0, 5, 0])
    np.testing.assert_array_equal(found["first"], [4, 6, np.inf])
    np.testing.assert_array_equal(found["first_process"], [np.inf, np.inf, 5])
    np.testing.assert_array_equal(found["process"], [0, 0, 6])
    np.testing.assert_array_equal(found["process_name"], ["", "", "rate"])
    np.testing.assert_array_equal(found["at_end"], [True, False, False])


def test_a_slow_drift_counts_from_the_last_sample_of_its_rise_on() -> None:
    """Of 11 samples the rise takes 10: samples 9 and 10 count."""
    active = np.zeros((SAMPLES, SEEDS, SENSORS), bool)
    active[..., 0] = True
    one = kept(PUBLISHED, active)
    one.isolated[:9, 0, 0] = one.isolated[9, 1, 0] = one.isolated[10, 2, 0] = True
    np.testing.assert_array_equal(record(one)["at_end"], [False, True, True])


def test_a_process_fault_has_the_right_name_where_it_is_the_most_frequent() -> None:
    one = kept(PROCESS, np.zeros((SAMPLES, SEEDS, SENSORS), bool))
    one.process[2:, 0, 1] = one.process[2:6, 1, 1] = one.process[5:, 1, 0] = True
    found = numbers(one.branched.condition, record(one), dt=2.0)
    assert found["process_verdict_probability"].value == pytest.approx(2 / 3)
    assert found["process_naming_probability"].value == pytest.approx(1 / 3)
    assert found["process_delay"].value == pytest.approx(2.0 * 3)  # a sample after the onset, then two more
    assert "exact_isolation" not in found and np.isnan(found["detection_delay"].value)
    assert names_of(LEAK) == ["inflow", error_of("inflow")]


def test_a_verdict_on_the_equation_of_a_state_is_right_where_the_case_names_the_state() -> None:
    one = kept(PROCESS, np.zeros((SAMPLES, SEEDS, SENSORS), bool), ("rate", "equation of inflow"))
    one.process[2:, 0, 1] = one.process[2:, 1, 0] = True
    found = numbers(one.branched.condition, record(one), dt=1.0)
    assert found["process_naming_probability"].value == pytest.approx(1 / 3)


def test_numbers_are_shares_within_their_intervals() -> None:
    rng = np.random.default_rng(0)
    for kind in (HEALTHY, "bias", PROCESS, PUBLISHED):
        active = np.zeros((SAMPLES, SEEDS, SENSORS), bool)
        active[..., 0] = kind in ("bias", PUBLISHED)
        one = kept(kind, active)
        one.isolated[:] = rng.random(one.isolated.shape) < 0.3
        one.process[:] = rng.random(one.process.shape) < 0.1
        one.alarm[:] = True
        found = numbers(one.branched.condition, record(one), dt=1.0)
        assert ("exact_isolation" in found) == (kind in ("bias", PUBLISHED))
        assert ("isolated_at_end" in found) == (kind == PUBLISHED)
        for metric, e in found.items():
            assert np.isnan(e.low) or e.low <= e.value <= e.high, metric
            assert metric.endswith("delay") or 0 <= e.low <= e.high <= 1, metric


def test_runs_of_conditions_of_different_numbers_stand_one_after_the_other() -> None:
    one = record(kept(HEALTHY, np.zeros((SAMPLES, SEEDS, SENSORS), bool)))
    fewer = {name: values[:1] for name, values in one.items()}
    found = join([one, fewer])
    np.testing.assert_array_equal(found["row"], [0, 0, 0, 1])
    assert all(found[name].size == 4 for name in FIELDS)


def test_the_area_is_that_of_pairs_of_samples() -> None:
    healthy, biased = np.array([[0.1, 0.2], [0.3, 0.4]]), np.array([[0.25, 0.5]])
    wins = np.mean([(b > h) for b in biased.ravel() for h in healthy.ravel()])
    assert area_of(healthy, biased).value == pytest.approx(wins)


def test_variants_are_every_detector_with_everything_it_may_know() -> None:
    found = variants(("loo-glr", "pca"), KNOWLEDGE)
    assert len({v.name for v in found}) == len(found) == 2 * len(KNOWLEDGE)
    assert found[0] == Variant("loo-glr", "plant") and found[0].name == "loo-glr"
    with pytest.raises(ValueError, match="unknown detector"):
        variants(("loo-gl",), KNOWLEDGE)
    with pytest.raises(ValueError, match="unknown knowledge"):
        variants(("loo-glr",), ("everything",))


def test_conditions_have_each_name_once_under_a_mismatch_case() -> None:
    from fusion_sfdia.comparison.subjects import cases_of, compared_plant
    from fusion_sfdia.robustness.protocol import SETTINGS

    cases = cases_of(compared_plant("two-tanks"))
    found = conditions(SETTINGS, cases)
    names = [(c.mismatch, c.fault.name) for c in found]
    assert len(set(names)) == len(names) and ("", slow_name(480)) in names
    assert {c.mismatch for c in found} == {"", *(m.name for m in cases.mismatch)}
    assert settle_of(cases) == 60 and settle_of(cases_of(compared_plant("marine-engine"))) == 400
