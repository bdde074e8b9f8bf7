"""The numbers and rows of a comparison on made-up arrays, each counted by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_up_cell import SETTINGS_HERE, TANKS, cell, made_up
from numpy.typing import NDArray

from fusion_sfdia.common.run_statistics import Estimate, proportion, rate_over_runs
from fusion_sfdia.study.comparison import metric_rows as rows
from fusion_sfdia.study.comparison import ranking
from fusion_sfdia.study.comparison.cell import ComparisonCell, widened, within
from fusion_sfdia.study.comparison.metric_rows import confusion, rows_of_cell, share_right
from fusion_sfdia.study.comparison.ranking import accommodation, detection, exoneration, isolation
from fusion_sfdia.study.comparison.records import BranchReadings, KeptDecisions, record
from fusion_sfdia.study.comparison.subjects import Subjects, plant_of
from fusion_sfdia.study.comparison.summary import complete, gather

Arrays = dict[str, NDArray[Any]]


def values(of: ComparisonCell) -> dict[tuple[str, str, str], Estimate]:
    """By fault, condition and metric; those of a quantity by its name and the condition."""
    found = rows_of_cell(of)
    assert {(r.scenario, r.plant, r.detector) for r in found} == {("comparison", "two-tanks", "made-up")}
    of_whole = [r for r in found if r.quantity == "all"]
    assert len({(r.fault, r.condition, r.metric) for r in of_whole}) == len(of_whole)
    return {(r.fault, r.condition, r.metric): Estimate(r.value, r.low, r.high, r.n) for r in of_whole}


def test_a_record_is_counted_by_hand() -> None:
    """Four samples of the tanks' sensors l1, l2, q12, q2: a fault of l1 from the second on, found with l2, then alone."""
    plant = plant_of(TANKS)
    active, isolated = np.zeros((2, 4, 1, 4), bool)
    active[1:, 0, 0] = True
    isolated[2, 0, :2] = isolated[3, 0, 0] = True
    scores = np.zeros((4, 1, 4))
    scores[1, 0, 2], scores[2, 0, 0], scores[3, 0, 0] = 1.5, 2.0, 1.0
    size, fault_size = np.where(active, 0.05, 0.0), np.full((4, 1, 4), np.nan)
    fault_size[2, 0, :2], fault_size[3, 0, 0] = (0.04, 0.01), 0.055
    signal = np.array([[[1.0, 2.0, 6e-4, 5e-4]]]) + np.zeros((4, 1, 1))
    error = np.zeros((3, 4, 1, 4))  # of measured, y and the readings without fault, in sigma
    error[:, :, 0, 0] = [[3, 2, np.nan, 1], [0, 5, 4, np.nan], [0, 0, -1, 2]]
    error[:, 0, 0, 3] = 2, 1, 7
    measured, y, unfaulted = signal + error * plant.sensor_sigma
    alarm = np.array([[False], [True], [True], [True]])
    seen = KeptDecisions(alarm, np.array([[False], [False], [False], [True]]), isolated, scores, fault_size, measured)
    found = record(plant, seen, BranchReadings(np.zeros((4, 1, 1)), y, unfaulted, signal, active, size))
    whole = {
        "samples": 4, "alarms": 3, "first": 1, "confirmed": 3, "own": 2, "right": 2, "isolated": 3, "faulty": 3, "exact": 1,
        "falsely_isolated": 1, "judged": True, "diverged": True,
    }  # fmt: skip
    assert {name: found[name].tolist() for name in whole} == {name: [value] for name, value in whole.items()}
    np.testing.assert_array_equal(found["isolated_as"], [[2, 0.5, 0, 1.5]])  # none, another level, another flow, the right one
    assert found["size_error"] == pytest.approx((0.2 + 0.1) / 2)
    by_hand = {
        "measured": (4 + 1) / 2, "raw": (25 + 16) / 2, "noise": (0 + 1 + 4) / 3,
        "all_measured": (9 + 4 + 1 + 4) / 15, "all_raw": (25 + 16 + 1) / 15,
    }  # fmt: skip
    # differences of readings of 2 with sigma 0.01 lose 1e-14 of the error, squared and summed not tenfold
    assert {name: float(found[name][0]) for name in by_hand} == pytest.approx(by_hand, rel=1e-11)
    nothing = record(
        plant, seen._replace(isolated=isolated & False), BranchReadings(y, y, unfaulted, signal, active & False, size * 0)
    )
    assert np.isnan([nothing[name] for name in ("size_error", "measured", "raw", "noise")]).all()
    assert nothing["exact"] == 0 and nothing["own"] == np.inf and not nothing["judged"]


def test_rows_of_single_conditions_by_hand() -> None:
    """The bias of 3 sigma: right 1 and 2 of 4, isolated 2 and 2, alarm from the third sample of one run; 5 s a sample."""
    found = values(cell())
    of = {metric: e for (fault, quantity, metric), e in found.items() if (fault, quantity) == ("bias-3-sigma", "")}
    assert set(of) == {"missed_detection_rate", "detection_delay", "exact_isolation", "isolation_recall", "rmse_ratio", "auc"}
    missed = proportion(1, 2)
    assert of["missed_detection_rate"].value == 0.5 and of["missed_detection_rate"].n == 2
    # detected 2 of 2 with the lower threshold and 0 of 2 with the higher: a standard error of 1/2 besides Wilson's, so that the
    # share may be anything
    assert np.hypot(missed.high - missed.value, 1.959963985 / 2) > 0.5
    assert (of["missed_detection_rate"].low, of["missed_detection_rate"].high) == (0.0, 1.0)
    assert of["detection_delay"].value == 10.0
    assert of["exact_isolation"].value == 3 / 8 and of["isolation_recall"].value == 3 / 8
    assert of["rmse_ratio"].value == pytest.approx(np.sqrt(0.2 * (1 / 3)))
    assert found["bias-10-sigma", "", "detection_delay"].value == 2.5
    assert found["none", "", "alarm_probability"].value == 1 / 8
    assert found["none", "", "false_isolation_probability"] == rate_over_runs(np.array([1, 0]), np.array([4, 4]))
    assert found["leak", "", "alarm_probability"].value == 3 / 8
    assert found["leak", "", "false_isolation_probability"].value == 1 / 8
    assert found["dropout", "", "rmse_sigma"].value == pytest.approx(np.sqrt(2.5))
    assert not [key for key in found if key[0] in ("none", "leak", "dropout") and key[2] == "exact_isolation"]


def test_rows_of_mismatch_cases_have_them_as_condition() -> None:
    found = values(cell())
    assert found["none", "outlets", "alarm_probability"].value == 4 / 8
    assert found["none", "inflow", "alarm_probability"].value == 1.0
    assert found["none", "inflow", "false_isolation_probability"].value == 5 / 8
    assert found["bias-10-sigma", "outlets", "detection_delay"].value == 7.5
    assert found["bias-10-sigma", "outlets", "exact_isolation"].value == 4 / 8
    assert not [key for key in found if key[1] == "inflow" and key[0] != "none"]


def test_rows_of_all_kinds_of_a_size_by_hand() -> None:
    """10 sigma: bias with right 2, 3 and isolated 3, 3; noise with right 1, 2 and isolated 2, 2; four samples of each."""
    found = {metric: e for (fault, _, metric), e in values(cell()).items() if fault == "graded-10-sigma"}
    assert found["missed_detection_rate"] == pytest.approx(proportion(0, 4))  # all are found: Wilson's interval from 0 on
    assert found["detection_delay"].value == pytest.approx(5.0 * (0 + 1 + 1 + 3) / 4)
    assert found["detection_probability"].value == (4 + 3 + 3 + 1) / 16
    assert found["isolation_recall"].value == (2 + 3 + 1 + 2) / 16
    assert found["isolation_precision"].value == (2 + 3 + 1 + 2) / (3 + 3 + 2 + 2)
    assert found["false_flag_rate"].value == (1 + 0 + 1 + 0) / (16 * 4 - 16)
    assert found["exact_isolation"].value == (2 + 2 + 1 + 2) / 16
    assert found["fault_mape_percent"].value == pytest.approx(100 * 0.3)  # of the bias: the size of noise goes through 0
    assert found["rmse_sigma"].value == pytest.approx(np.sqrt((4 + 1) / 2))
    assert found["rmse_unaccommodated_sigma"].value == pytest.approx(np.sqrt((100 + 9) / 2))
    assert found["rmse_healthy_sigma"].value == 1.0 and found["rmse_all_sigma"].value == pytest.approx(np.sqrt(2))
    assert found["diverged"].value == 0.0
    assert values(cell())["graded-3-sigma", "", "diverged"].value == 0.5


def test_rows_of_thresholds_by_hand() -> None:
    """Nine healthy samples of two seeds: three above 2, four above 1.6, two above 2.6; 10 samples in each calibration run."""
    found = {metric: e for (fault, _, metric), e in values(cell()).items() if fault == "none"}
    matched = rate_over_runs(np.array([2, 1]), np.array([9, 9]))
    assert found["matched_false_alarm_probability"].value == 3 / 18
    error = (4 - 2) / 18 / 2
    assert cell().rate_error == pytest.approx(error)
    assert found["matched_false_alarm_probability"] == pytest.approx(within(widened(matched, error), 0.0, 1.0))
    assert found["deployed_false_alarm_probability"].value == 4 / 18
    deployed = rate_over_runs(np.array([3, 1]), np.array([9, 9]))
    assert found["deployed_false_alarm_probability"] == pytest.approx(within(widened(deployed, error * 4 / 3), 0.0, 1.0))
    assert found["nominal_false_alarm_probability"] == rate_over_runs(np.array([1, 2, 0]), np.full(3, 10))
    assert found["nominal_false_alarm_probability"].value == 0.1
    assert found["calibration_error"].value == pytest.approx(1 / np.sqrt(3) / 2)
    assert found["threshold_scale"][:3] == pytest.approx((2.0, 2 - 1.959963985 * 0.5, 2 + 1.959963985 * 0.5))
    assert found["claimed_false_alarm_probability"].value == 0.01 and found["target_false_alarm_probability"].value == 0.1
    assert found["state_size"].value == 640
    assert cell().chance == 2 / 4  # windows of four samples, two a seed; the ninth sample is left over
    silent = cell(calibration_alarms=np.zeros(3, int), claim=np.array(np.nan))
    assert np.isnan(silent.calibration_error)
    assert not [key for key in values(silent) if key[2] == "claimed_false_alarm_probability"]


def test_areas_are_pairs_counted_by_hand() -> None:
    """Healthy samples against faulty ones of all seeds; a healthy 0.2 thrice and so on, ties count half."""
    healthy = made_up()["trunk"].ravel()
    areas = []
    for name, faulty in zip(("bias-3-sigma", "bias-10-sigma"), made_up()["swept"], strict=True):
        pairs = [(f > h) + (f == h) / 2 for f in faulty.ravel() for h in healthy]
        areas.append(float(np.mean(pairs)))
        assert values(cell())[name, "", "auc"].value == pytest.approx(areas[-1], rel=1e-12)
    assert values(cell())["graded-3-sigma", "", "auc"].value == pytest.approx(areas[0], rel=1e-12)
    assert values(cell())["graded-10-sigma", "", "auc"].value == pytest.approx(areas[1], rel=1e-12)
    frozen = cell(swept_condition=np.array(["freeze", "bias-10-sigma"]))
    frozen.conditions["freeze"] = frozen.conditions["bias-3-sigma"]._replace(name="freeze", kind="freeze")
    assert frozen.mean_area(10.0).value == pytest.approx(np.mean(areas), rel=1e-12)  # a freeze is of every size
    assert frozen.mean_area(3.0).value == pytest.approx(areas[0], rel=1e-12)
    short = cell()
    short.conditions["bias-3-sigma"] = short.conditions["bias-3-sigma"]._replace(length=2)
    scores, active = short.swept("bias-3-sigma")
    assert scores.shape == (11, 2) and active.sum(axis=(0, 2)).tolist() == [2, 2] and not active[:9].any()


def test_what_is_isolated_by_quantity_is_counted_by_hand() -> None:
    """Sizes of a kind count as one run. Level fails in seed 0, flow in seed 1; of noise only the sizes 3 and 10 count."""
    found = confusion(cell())
    assert found.shape == (2, 4, 4)  # quantities, kinds x seeds, none and another level, flow and the right one
    np.testing.assert_array_equal(found[0], [[3, 1.5, 0.5, 3], [0] * 4, [6, 0, 2, 0], [0] * 4])
    np.testing.assert_array_equal(found[1], [[0] * 4, [5, 0, 0, 3], [0] * 4, [5, 1, 2, 0]])
    assert share_right(cell()) == 6 / 32
    shares = {(r.quantity, r.condition): r.value for r in rows_of_cell(cell()) if r.fault == "large"}
    assert shares == {
        ("level", "isolated: none"): 9 / 16, ("level", "isolated: another level"): 1.5 / 16,
        ("level", "isolated: another flow"): 2.5 / 16, ("level", "isolated: the faulty sensor"): 3 / 16,
        ("flow", "isolated: none"): 10 / 16, ("flow", "isolated: another level"): 1 / 16,
        ("flow", "isolated: another flow"): 2 / 16, ("flow", "isolated: the faulty sensor"): 3 / 16,
    }  # fmt: skip
    assert np.isnan(share_right(cell(isolated_as=np.zeros((12, 2, 4)))))


def test_a_plant_that_fails_shows_a_sample_after_its_onset() -> None:
    of = cell()
    assert of.delay(of.rows_of("leak")).value == 5.0 * ((2 + 1) + (3 + 1)) / 2
    assert of.delay(of.rows_of("leak", "bias-10-sigma")).value == 5.0 * (3 + 4 + 0 + 1) / 4


def test_what_is_right_to_rounding_counts_as_a_thousandth_of_the_noise() -> None:
    measured = np.where(np.arange(12)[:, None] == 2, [[0.0, 1e-20]], made_up()["measured"])
    of = cell(measured=measured)
    assert of.gain(of.rows_of("bias-10-sigma")).value == pytest.approx(np.sqrt(1e-4 * (1e-3 / 3)))


def test_seeds_of_tasks_stand_side_by_side() -> None:
    one, other = made_up(), made_up()
    other["scale"], other["step_seconds"] = one["scale"], np.array(1e-4)
    other["trunk"], other["deployed_alarms"] = other["trunk"] + 1, np.array([0, 2])
    tasks = [{"plant": "two-tanks", "detector": "d", "seeds": s} for s in ([0, 1], [2, 3])]
    refused = ({"plant": "two-tanks", "detector": "e", "seeds": [0]}, {"reason": np.array("no wings")})
    cells, reasons = gather(Subjects(), SETTINGS_HERE, [*zip(tasks, (one, other), strict=True), refused])
    both = cells["two-tanks", "d"]
    assert both.seeds == (0, 1, 2, 3) and reasons == {("two-tanks", "e"): "no wings"}
    assert both["first"].shape == (12, 4) and both["isolated_as"].shape == (12, 4, 4) and both["condition"].shape == (12,)
    np.testing.assert_array_equal(both["trunk"], np.hstack([one["trunk"], one["trunk"] + 1]))
    np.testing.assert_array_equal(both["swept"], np.concatenate([one["swept"]] * 2, axis=2))
    assert both["deployed_alarms"].tolist() == [3, 1, 0, 2] and both.step_seconds == 1e-4
    half = gather(Subjects(), SETTINGS_HERE, [(tasks[0], one)])[0]["two-tanks", "d"]
    assert list(complete({("p", "both"): both, ("p", "half"): half})) == [("p", "both")]


def test_clusters_of_a_ranking_by_hand() -> None:
    """Sizes of a kind share noise and sensor: their mean is one number a seed. Mismatch cases are one group."""
    of = cell()
    found = {name: {k: v.tolist() for k, v in criterion(of).items()} for name, criterion in CRITERIA.items()}
    assert found["detection"] == {"bias": [1.0, 0.5], "noise": [0.5, 0.5]}
    assert found["isolation"] == {"bias": [(1 + 2) / 8, (2 + 2) / 8], "noise": [(0 + 1) / 8, (1 + 2) / 8]}
    assert found["accommodation"]["bias"] == pytest.approx([np.log10(5), np.log10(3)])
    assert set(found["exoneration"]) == {"dropout", "process", "mismatch"}
    assert found["exoneration"]["dropout"] == [1.0, 0.5] and found["exoneration"]["process"] == [0.75, 1.0]
    assert found["exoneration"]["mismatch"] == pytest.approx([1 - (0 + 1 + 2) / 12, 1 - (2 + 0 + 3) / 12])
    both = ranking.CRITERIA["detection"].values(of, SETTINGS_HERE)
    assert both.tolist() == [1.0, 0.5, 0.5, 0.5]


CRITERIA = {"detection": detection, "isolation": isolation, "accommodation": accommodation, "exoneration": exoneration}


def test_measures_of_the_report_by_hand() -> None:
    of = cell()
    found = {name: measure.of(of) for name, measure in rows.measures(SETTINGS_HERE).items()}
    assert found["runs with an alarm, 10 sigma"].value == 1.0 and found["runs with an alarm, 3 sigma"].value == 0.25
    assert found["exact isolation, 10 sigma"].value == 7 / 16 == rows.exact_isolation(SETTINGS_HERE, of).value
    assert found["false isolation, worst mismatch case"].value == 5 / 8 and rows.under_mismatch(of).case == "inflow"
    assert found["false isolation, worst process fault"].value == 1 / 8 and rows.under_process_faults(of).case == "leak"
    assert found["faulty sensor among the isolated, 10 sigma"].value == 8 / 16
    assert found["delay (s), 10 sigma"].value == 6.25
    assert found["healthy sensors isolated, 10 sigma"].value == 2 / 48
    assert found["area under the ROC, bias 3 sigma"] == of.areas["bias-3-sigma"]
    assert found["mean area under ROCs, 3 sigma"].value == of.areas["bias-3-sigma"].value
    assert found["false alarms at its own threshold"].value == 0.1
    assert rows.detected_share(SETTINGS_HERE, of) == 1.0
    worse = cell(exact=np.zeros((12, 2), int))
    assert rows.best_isolation(SETTINGS_HERE, {"worse": worse, "made-up": of}) == "made-up"
    assert rows.under_mismatch(cell(mismatch=np.full(12, ""))).case == "none"
    assert len(rows.glance(SETTINGS_HERE)) == 8
