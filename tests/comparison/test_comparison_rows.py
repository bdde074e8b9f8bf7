"""The numbers and rows of a comparison on made-up arrays, each counted by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.comparison import measures
from fusion_sfdia.comparison.numbers import Cell, complete, confusion, gather, share_right, widened, within
from fusion_sfdia.comparison.protocol import SETTINGS
from fusion_sfdia.comparison.ranking import accommodation, clusters, detection, exoneration, isolation
from fusion_sfdia.comparison.recordings import plant_of
from fusion_sfdia.comparison.records import Branch, Outcome, record
from fusion_sfdia.comparison.rows import rows_of_cell
from fusion_sfdia.evaluation.metrics import Estimate, proportion, rate_over_runs

Arrays = dict[str, NDArray[Any]]

SETTINGS_HERE = SETTINGS | {
    "faults": ("bias", "noise", "dropout"), "magnitudes": (3.0, 10.0), "lengths": (), "window": 4, "false_alarm": 0.1,
}  # fmt: skip
CONDITIONS = (  # of two-tanks, window 4 samples, two seeds: name, truth, threshold, and by seed first alarm
    ("none", "", 0, (np.inf, 3)),
    ("bias-3-sigma", "", 0, (2, np.inf)),
    ("bias-10-sigma", "", 0, (0, 1)),
    ("noise-3-sigma", "", 0, (np.inf, np.inf)),
    ("noise-10-sigma", "", 0, (1, 3)),
    ("dropout", "", 0, (np.inf, np.inf)),
    ("leak", "", 0, (2, 3)),
    ("none", "outlets", 0, (0, np.inf)),
    ("bias-10-sigma", "outlets", 0, (1, 2)),
    ("none", "inflow", 0, (0, 0)),
    ("bias-3-sigma", "", -1, (1, 2)),
    ("bias-3-sigma", "", 1, (np.inf, np.inf)),
)


def made_up() -> Arrays:
    """Of the conditions (12, 2): alarms where the first comes and later, and numbers that differ from row to row."""
    names, truths, thresholds, first = (np.array(column) for column in zip(*CONDITIONS, strict=True))
    samples = np.full(first.shape, 4)
    healthy = np.isin(names, ["none", "leak"])[:, None]
    row = np.arange(len(names))[:, None] + np.zeros((1, 2))
    none = np.zeros(first.shape)
    right = np.where(healthy, 0, [[0, 1]] + np.arange(12)[:, None] % 3)
    blamed = np.where(row % 2 == 0, [[1, 0]], [[0, 2]])
    blamed[9] = 2, 3
    told = np.zeros((12, 2, 4))
    told[..., 0] = 4
    told[1], told[2], told[4] = [[3, 1, 0, 0], [4, 0, 0, 0]], [[0, 0.5, 0.5, 3], [1, 0, 0, 3]], [[2, 0, 2, 0], [1, 1, 2, 0]]
    return {
        "condition": names, "truth": truths, "threshold": thresholds, "first": first, "samples": samples,
        "alarms": np.where(np.isfinite(first), 4 - np.minimum(first, 4), 0).astype(int),
        "sensor": np.where(healthy, -1, [[0, 2]]), "faulty": np.where(healthy, 0, samples), "right": right,
        "named": right + np.array([1, 0]), "exact": np.minimum(right, 2), "blamed": blamed,
        "told": told, "judged": right > 1, "size_error": np.where(right > 0, 0.1 + row / 10, np.nan),
        "measured": np.where(healthy, np.nan, [[4.0, 1.0]] + 0 * row),
        "raw": np.where(healthy, np.nan, [[100.0, 9.0]] + 0 * row),
        "noise": np.where(healthy, np.nan, 1.0 + none), "all_measured": 2.0 + none, "all_raw": 3.0 + none,
        "diverged": row == 3,
        "trunk": np.array([[0.5, 0.9, 2.5, 0.4, 1.1, 0.3, 0.1, 0.2, 4.0], [0.2, 1.7, 0.1, 0.6, 3.0, 0.2, 0.7, 0.8, 0.0]]).T,
        "swept": np.array([
            [[5.0, 0.3], [6.0, 0.15], [0.45, 9.0], [7.0, 8.0]],
            [[1.0, 3.0], [0.0, 2.0], [9.0, 9.0], [0.55, 0.5]],
        ]),
        "swept_condition": np.array(["bias-3-sigma", "bias-10-sigma"]),
        "scale": np.array(2.0), "ends": np.array([1.6, 2.6]), "claim": np.array(0.01), "calibration_samples": np.array(10),
        "nominal_alarms": np.array([1, 2, 0]), "calibration_alarms": np.array([1, 3, 2]), "deployed_alarms": np.array([3, 1]),
        "step_seconds": np.array(1e-3), "batch_seconds": np.array(1e-4), "state_bytes": np.array(640),
    }  # fmt: skip


def cell(seeds: tuple[int, ...] = (0, 1), **changes: NDArray[Any]) -> Cell:
    return Cell("two-tanks", "made-up", SETTINGS_HERE, [made_up() | changes], seeds)


def values(of: Cell) -> dict[tuple[str, str, str], Estimate]:
    rows = rows_of_cell(of)
    assert {(r.scenario, r.plant, r.detector) for r in rows} == {("comparison", "two-tanks", "made-up")}
    return {(r.fault, r.quantity, r.metric): Estimate(r.value, r.low, r.high, r.n) for r in rows}


def test_a_record_is_counted_by_hand() -> None:
    """Four samples of the tanks' sensors l1, l2, q12, q2: a fault of l1 from the second on, found with l2, then alone."""
    plant = plant_of("two-tanks")
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
    seen = Outcome(alarm, np.array([[False], [False], [False], [True]]), isolated, scores, fault_size, measured)
    found = record(plant, seen, Branch(np.zeros((4, 1, 1)), y, unfaulted, signal, active, size))
    whole = {
        "samples": 4, "alarms": 3, "first": 1, "confirmed": 3, "own": 2, "right": 2, "named": 3, "faulty": 3, "exact": 1,
        "blamed": 1, "judged": True, "diverged": True,
    }  # fmt: skip
    assert {name: found[name].tolist() for name in whole} == {name: [value] for name, value in whole.items()}
    np.testing.assert_array_equal(found["told"], [[2, 0.5, 0, 1.5]])  # none, another level, another flow, the right one
    assert found["size_error"] == pytest.approx((0.2 + 0.1) / 2)
    by_hand = {
        "measured": (4 + 1) / 2, "raw": (25 + 16) / 2, "noise": (0 + 1 + 4) / 3,
        "all_measured": (9 + 4 + 1 + 4) / 15, "all_raw": (25 + 16 + 1) / 15,
    }  # fmt: skip
    # differences of readings of 2 with sigma 0.01 lose 1e-14 of the error, squared and summed not tenfold
    assert {name: float(found[name][0]) for name in by_hand} == pytest.approx(by_hand, rel=1e-11)
    nothing = record(plant, seen._replace(isolated=isolated & False), Branch(y, y, unfaulted, signal, active & False, size * 0))
    assert np.isnan([nothing[name] for name in ("size_error", "measured", "raw", "noise")]).all()
    assert nothing["exact"] == 0 and nothing["own"] == np.inf and not nothing["judged"]


def test_rows_of_single_conditions_by_hand() -> None:
    """The bias of 3 sigma: right 1 and 2 of 4, named 2 and 2, alarm from the third sample of one run; 5 s a sample."""
    found = values(cell())
    of = {metric: e for (fault, quantity, metric), e in found.items() if (fault, quantity) == ("bias-3-sigma", "all")}
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
    assert found["bias-10-sigma", "all", "detection_delay"].value == 2.5
    assert found["none", "all", "alarm_probability"].value == 1 / 8
    assert found["none", "all", "blame_probability"] == rate_over_runs(np.array([1, 0]), np.array([4, 4]))
    assert found["leak", "all", "alarm_probability"].value == 3 / 8
    assert found["leak", "all", "blame_probability"].value == 1 / 8
    assert found["dropout", "all", "rmse_sigma"].value == pytest.approx(np.sqrt(2.5))
    assert not [key for key in found if key[0] in ("none", "leak", "dropout") and key[2] == "exact_isolation"]


def test_rows_of_departures_are_apart_and_under_their_name() -> None:
    found = values(cell())
    assert found["none", "outlets", "alarm_probability"].value == 4 / 8
    assert found["none", "inflow", "alarm_probability"].value == 1.0
    assert found["none", "inflow", "blame_probability"].value == 5 / 8
    assert found["bias-10-sigma", "outlets", "detection_delay"].value == 7.5
    assert found["bias-10-sigma", "outlets", "exact_isolation"].value == 4 / 8
    assert not [key for key in found if key[1] == "inflow" and key[0] != "none"]


def test_rows_of_all_kinds_of_a_size_by_hand() -> None:
    """10 sigma: bias with right 2, 3 and named 3, 3; noise with right 1, 2 and named 2, 2; four samples of each."""
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
    assert values(cell())["graded-3-sigma", "all", "diverged"].value == 0.5


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
        assert values(cell())[name, "all", "auc"].value == pytest.approx(areas[-1], rel=1e-12)
    assert values(cell())["graded-3-sigma", "all", "auc"].value == pytest.approx(areas[0], rel=1e-12)
    assert values(cell())["graded-10-sigma", "all", "auc"].value == pytest.approx(areas[1], rel=1e-12)
    frozen = cell(swept_condition=np.array(["freeze", "bias-10-sigma"]))
    frozen.lengths["freeze"] = 4
    assert frozen.mean_area(10.0).value == pytest.approx(np.mean(areas), rel=1e-12)  # a freeze is of every size
    assert frozen.mean_area(3.0).value == pytest.approx(areas[0], rel=1e-12)
    short = cell()
    short.lengths["bias-3-sigma"] = 2
    scores, active = short.swept("bias-3-sigma")
    assert scores.shape == (11, 2) and active.sum(axis=(0, 2)).tolist() == [2, 2] and not active[:9].any()


def test_what_is_named_by_quantity_by_hand() -> None:
    """Sizes of a kind count as one run. Level fails in seed 0, flow in seed 1; of noise only the sizes 3 and 10 count."""
    found = confusion(cell())
    assert found.shape == (2, 4, 4)  # quantities, kinds x seeds, none and another level, flow and the right one
    np.testing.assert_array_equal(found[0], [[3, 1.5, 0.5, 3], [0] * 4, [6, 0, 2, 0], [0] * 4])
    np.testing.assert_array_equal(found[1], [[0] * 4, [5, 0, 0, 3], [0] * 4, [5, 1, 2, 0]])
    assert share_right(cell()) == 6 / 32
    rows = {quantity: e.value for (fault, quantity, _), e in values(cell()).items() if fault == "large"}
    assert rows == {
        "level: none": 9 / 16, "level: another level": 1.5 / 16,
        "level: another flow": 2.5 / 16, "level: the right one": 3 / 16,
        "flow: none": 10 / 16, "flow: another level": 1 / 16, "flow: another flow": 2 / 16, "flow: the right one": 3 / 16,
    }  # fmt: skip
    assert np.isnan(share_right(cell(told=np.zeros((12, 2, 4)))))


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
    cells, reasons = gather(SETTINGS_HERE, [*zip(tasks, (one, other), strict=True), refused])
    both = cells["two-tanks", "d"]
    assert both.seeds == (0, 1, 2, 3) and reasons == {("two-tanks", "e"): "no wings"}
    assert both["first"].shape == (12, 4) and both["told"].shape == (12, 4, 4) and both["condition"].shape == (12,)
    np.testing.assert_array_equal(both["trunk"], np.hstack([one["trunk"], one["trunk"] + 1]))
    np.testing.assert_array_equal(both["swept"], np.concatenate([one["swept"]] * 2, axis=2))
    assert both["deployed_alarms"].tolist() == [3, 1, 0, 2] and both.step_seconds == 1e-4
    half = gather(SETTINGS_HERE, [(tasks[0], one)])[0]["two-tanks", "d"]
    assert list(complete({("p", "both"): both, ("p", "half"): half})) == [("p", "both")]


def test_clusters_of_a_ranking_by_hand() -> None:
    """Sizes of a kind share noise and sensor: their mean is one number a seed. Departures are one group."""
    of = cell()
    found = {name: {k: v.tolist() for k, v in criterion(of).items()} for name, criterion in CRITERIA.items()}
    assert found["detection"] == {"bias": [1.0, 0.5], "noise": [0.5, 0.5]}
    assert found["isolation"] == {"bias": [(1 + 2) / 8, (2 + 2) / 8], "noise": [(0 + 1) / 8, (1 + 2) / 8]}
    assert found["accommodation"]["bias"] == pytest.approx([np.log10(5), np.log10(3)])
    assert set(found["exoneration"]) == {"dropout", "plant", "departure"}
    assert found["exoneration"]["dropout"] == [1.0, 0.5] and found["exoneration"]["plant"] == [0.75, 1.0]
    assert found["exoneration"]["departure"] == pytest.approx([1 - (0 + 1 + 2) / 12, 1 - (2 + 0 + 3) / 12])
    both = clusters({"a": of}, "detection")["a"]
    assert both.tolist() == [1.0, 0.5, 0.5, 0.5]


CRITERIA = {"detection": detection, "isolation": isolation, "accommodation": accommodation, "exoneration": exoneration}


def test_measures_of_the_report_by_hand() -> None:
    of = cell()
    found = {name: measure.of(of) for name, measure in measures.measures(SETTINGS_HERE).items()}
    assert found["runs with an alarm, 10 sigma"].value == 1.0 and found["runs with an alarm, 3 sigma"].value == 0.25
    assert found["exact names, 10 sigma"].value == 7 / 16 == measures.exactly(SETTINGS_HERE, of).value
    assert found["blame, worst departure"].value == 5 / 8 and measures.under_departures(of).where == "inflow"
    assert found["blame, worst fault of the plant"].value == 1 / 8 and measures.under_plant_faults(of).where == "leak"
    assert found["named at all, 10 sigma"].value == 8 / 16
    assert found["delay (s), 10 sigma"].value == 6.25
    assert found["healthy sensors named, 10 sigma"].value == 2 / 48
    assert found["area under the ROC, bias 3 sigma"] == of.areas["bias-3-sigma"]
    assert found["mean area under ROCs, 3 sigma"].value == of.areas["bias-3-sigma"].value
    assert found["false alarms at its own threshold"].value == 0.1
    assert measures.seen(SETTINGS_HERE, of) == 1.0
    worse = cell(exact=np.zeros((12, 2), int))
    assert measures.names_most(SETTINGS_HERE, {"worse": worse, "made-up": of}) == "made-up"
    assert measures.under_departures(cell(truth=np.full(12, ""))).where == "none"
    assert len(measures.glance(SETTINGS_HERE)) == 8
