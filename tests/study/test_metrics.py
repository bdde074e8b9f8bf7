"""Metrics: cases counted by hand, laws of every interval, scikit-learn and SciPy as oracles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, binomtest, norm, ttest_1samp
from scipy.stats import t as student
from sklearn.metrics import roc_auc_score
from toy_plants import chain, tanks

from fusion_sfdia.common.run_statistics import (
    NOTHING,
    bootstrap_over_runs,
    mean_over_runs,
    proportion,
    rate_over_runs,
    require_shapes,
    share,
    without_diverged,
)
from fusion_sfdia.study import detection_metrics as detection
from fusion_sfdia.study import estimation_metrics as estimation
from fusion_sfdia.study import isolation_metrics as isolation

T = np.array([10.0, 20, 30, 40, 50, 60])


def case():
    """Six samples, three runs, two sensors: sensor 0 of run 0 at samples 1-3, sensor 1 of run 1 at 2-5, run 2 healthy."""
    active = np.zeros((6, 3, 2), bool)
    active[1:4, 0, 0] = True
    active[2:6, 1, 1] = True
    isolated = np.zeros_like(active)
    isolated[2:4, 0, 0] = True  # one sample late
    isolated[4, 0, 0] = True  # outlasts the fault
    isolated[3, 1, 0] = True  # the wrong one first
    isolated[4:6, 1, 1] = True
    isolated[5, 1, 0] = True  # and one too many
    alarm = isolated.any(axis=-1)
    alarm[0, 2] = True
    return alarm, isolated, active


def test_sample_wise_rates_counted_by_hand():
    alarm, _, active = case()
    assert detection.detection_probability(alarm, active).value == pytest.approx(5 / 7)
    assert detection.false_alarm_probability(alarm, active).value == pytest.approx(2 / 11)
    assert detection.accuracy(alarm, active).value == pytest.approx((5 + 9) / 18)
    assert detection.false_alarms(alarm, active) == 2
    late = np.zeros((6, 3), bool)
    late[3:] = True
    assert detection.detection_probability(alarm, active, late).value == pytest.approx(4 / 4)
    assert detection.false_alarms(alarm, active, late) == 1


def test_isolation_counted_by_hand():
    _, isolated, active = case()
    assert isolation.isolation_recall(isolated, active).value == pytest.approx(4 / 7)
    assert isolation.isolation_precision(isolated, active).value == pytest.approx(4 / 7)
    assert isolation.false_flag_rate(isolated, active).value == pytest.approx(3 / (36 - 7))
    assert isolation.exact_isolation(isolated, active).value == pytest.approx(3 / 7)


def test_confusion_counted_by_hand():
    _, isolated, active = case()
    found = isolation.confusion(isolated, active)
    np.testing.assert_array_equal(found, [[10, 1, 0], [1, 2, 0], [1, 1, 2]])


def test_confusion_shares_a_sample_among_the_wrong_ones():
    active, isolated = np.zeros((1, 1, 3), bool), np.zeros((1, 1, 3), bool)
    active[0, 0, 0] = isolated[0, 0, 1] = isolated[0, 0, 2] = True
    found = isolation.confusion(isolated, active)
    np.testing.assert_array_equal(found[1], [0, 0, 0.5, 0.5])
    assert found.sum() == 1


def test_confusion_rows_add_up_to_the_samples_of_each_truth():
    rng = np.random.default_rng(0)
    active, isolated = rng.random((2, 40, 6, 4)) < 0.2
    found = isolation.confusion(isolated, active)
    np.testing.assert_allclose(found.sum(axis=1), [(~active.any(-1)).sum(), *active.sum(axis=(0, 1))], rtol=1e-12)
    np.testing.assert_allclose(np.diagonal(found)[1:], (active & isolated).sum(axis=(0, 1)), rtol=1e-12)


def test_events_and_delays_counted_by_hand():
    alarm, isolated, active = case()
    assert detection.events(active) == [(0, 0, 1, 3), (1, 1, 2, 5)]
    assert detection.detection_delay(T, alarm, active).value == pytest.approx((10 + 10) / 2)
    assert detection.isolation_delay(T, isolated, active).value == pytest.approx((10 + 20) / 2)
    assert detection.missed_detection_rate(alarm, active).value == 0
    assert detection.missed_detection_rate(np.zeros_like(alarm), active).value == 1
    assert detection.first_alarm_time(T, alarm).value == pytest.approx((30 + 40 + 10) / 3)
    alarm[:, 1] = False
    missed = detection.missed_detection_rate(alarm, active)
    assert (missed.value, missed.n) == (0.5, 2)
    assert detection.detection_delay(T, alarm, active)[0::3] == (10, 1)
    assert detection.first_alarm_time(T, alarm)[0::3] == (20, 2)


def test_events_at_the_ends_and_twice_on_one_sensor():
    active = np.array([1, 1, 0, 1, 0, 1], bool)[:, None, None]
    assert detection.events(active) == [(0, 0, 0, 1), (0, 0, 3, 3), (0, 0, 5, 5)]


def test_trial_accuracy_counted_by_hand():
    alarm, isolated, active = case()
    # run 0 right; run 1: sensor 1 on 2 of the 3 samples that isolate any, sensor 0 on 2 of 3 too: wrong; run 2: false alarm
    assert detection.trial_accuracy(alarm, isolated, active)[0::3] == (pytest.approx(1 / 3), 3)
    isolated[5, 1, 0] = False
    assert detection.trial_accuracy(alarm, isolated, active).value == pytest.approx(2 / 3)
    alarm[0, 2] = False
    assert detection.trial_accuracy(alarm, isolated, active).value == 1
    isolated[:, 0] = False
    assert detection.trial_accuracy(alarm, isolated, active).value == pytest.approx(2 / 3)


def test_a_run_is_judged_by_the_sensor_isolated_most_not_by_the_exact_set():
    active = np.zeros((6, 4, 3), bool)
    active[2:6, :, 0] = True
    active[2:6, 3, 1] = True  # two faults in the last run
    alarm, isolated = active.any(axis=-1), active.copy()
    isolated[2:5, 0, 1] = True  # a healthy one, too, in 3 of 4 samples: the faulty one still leads
    isolated[2:6, 1, 2] = True  # a tie is not right
    isolated[0:2, 2, 1] = True  # isolation before the fault does not count
    isolated[2:6, 3, 2] = [True, False, False, False]
    assert detection.judged_right(alarm, isolated, active).tolist() == [True, False, True, True]
    isolated[2:6, 3, 1] = [False, False, False, True]  # the second faulty sensor as often as a healthy one
    assert detection.judged_right(alarm, isolated, active).tolist() == [True, False, True, False]
    assert not detection.judged_right(np.zeros_like(alarm), isolated, active).any()


def test_auc_is_the_chance_that_a_faulty_sample_scores_higher():
    rng = np.random.default_rng(3)
    active = (rng.random((30, 8, 3)) < 0.3) & (np.arange(8) % 2 == 0)[:, None]
    scores = np.round(rng.standard_normal((30, 8, 3)) + active, 1)  # rounded: with ties
    each = detection.auc(scores, active)
    faulty, healthy = scores[active], scores[~active]
    chance = np.mean((faulty[:, None] > healthy) + 0.5 * (faulty[:, None] == healthy))
    assert each.value == pytest.approx(chance, rel=1e-12)
    assert each.value == pytest.approx(roc_auc_score(active.ravel(), scores.ravel()), rel=1e-12)
    assert each.low < each.value < each.high
    largest = scores.max(axis=-1)
    assert detection.auc(largest, active).value == pytest.approx(
        roc_auc_score(active.any(-1).ravel(), largest.ravel()), rel=1e-12
    )


def test_auc_interval_is_that_of_auc_recomputed_without_each_run():
    rng = np.random.default_rng(4)
    active = np.zeros((20, 12, 1), bool)
    active[8:15] = True
    scores = rng.standard_normal((20, 12, 1)) + active * rng.uniform(0, 2, (12, 1))
    without = [np.delete(np.arange(12), run) for run in range(12)]
    areas = np.array([roc_auc_score(active[:, rest].ravel(), scores[:, rest].ravel()) for rest in without])
    variance = 11 / 12 * np.sum((areas - areas.mean()) ** 2)
    found = detection.auc(scores, active)
    z = norm.ppf(0.975)
    n = found.value * (1 - found.value) / variance * (z / student.ppf(0.975, 11)) ** 2
    limits = (
        found.value + z**2 / (2 * n) + np.array([-z, z]) * np.sqrt(found.value * (1 - found.value) / n + (z / n / 2) ** 2)
    ) / (1 + z**2 / n)
    np.testing.assert_allclose([found.low, found.high], limits, rtol=1e-9)
    assert found.n == 12


@pytest.mark.parametrize("runs", [3, 5, 20])
def test_auc_interval_covers_where_runs_are_few_and_differ(runs: int) -> None:
    """Healthy scores N(0, 1), faulty ones N(d, 1) with d ~ N(1.2, 0.7^2) in each run: the area is Phi(1.2 / sqrt(2.49))."""
    rng, truth, trials = np.random.default_rng(1), norm.cdf(1.2 / np.sqrt(2.49)), 300
    active = np.zeros((90, runs, 1), bool)
    active[60:] = True
    covered = 0
    for _ in range(trials):
        scores = rng.standard_normal((90, runs)) + active[..., 0] * rng.normal(1.2, 0.7, runs)
        _, low, high, _ = detection.auc(scores, active)
        covered += low <= truth <= high
    assert covered >= binom.ppf(0.001, trials, 0.95)


def test_roc_follows_its_definition_and_its_area_is_the_auc():
    rng = np.random.default_rng(5)
    active = rng.random((40, 5, 1)) < 0.4
    scores = rng.standard_normal((40, 5)) + active[..., 0]
    curve = detection.roc(scores, active)
    for fpr, tpr, threshold in zip(*curve, strict=True):
        alarm = scores >= threshold
        assert detection.detection_probability(alarm, active).value == pytest.approx(tpr)
        assert detection.false_alarm_probability(alarm, active).value == pytest.approx(fpr)
    area = np.trapezoid(curve.detection_probability, curve.false_alarm_probability)
    assert area == pytest.approx(detection.auc(scores, active).value, rel=1e-12)


def test_infinite_scores_rank_above_all():
    active = np.array([0, 1, 1, 0], bool)[:, None, None]
    scores = np.array([0.0, np.inf, 2.0, 1.0])[:, None]
    assert detection.auc(scores, active).value == 1
    assert np.isfinite(detection.roc(scores, active).detection_probability).all()


def test_perfect_separation_is_no_certainty():
    active = np.zeros((6, 10, 1), bool)
    active[3:] = True
    found = detection.auc(active[..., 0].astype(float), active)
    assert found == (1.0, pytest.approx(binomtest(10, 10).proportion_ci(method="wilson").low), 1.0, 10)


def test_a_score_of_nan_is_refused_and_can_be_left_out():
    _, _, active = case()
    scores = np.zeros((6, 3))
    scores[0, 0] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        detection.auc(scores, active)
    assert detection.auc(scores, active, np.isfinite(scores)).value == 0.5


def test_nothing_to_count_is_nan_with_n_zero():
    healthy, faulty = np.zeros((6, 3, 2), bool), np.ones((6, 3, 2), bool)
    alarm, scores = np.ones((6, 3), bool), np.zeros((6, 3))
    none_counted = np.zeros((6, 3), bool)
    for found in (
        detection.detection_probability(alarm, healthy),
        detection.false_alarm_probability(alarm, faulty),
        detection.accuracy(alarm, healthy, none_counted),
        detection.trial_accuracy(alarm, healthy, healthy, none_counted),
        detection.auc(scores, healthy),
        detection.auc(scores, faulty),
        detection.missed_detection_rate(alarm, healthy),
        detection.detection_delay(T, ~alarm, faulty),
        detection.first_alarm_time(T, ~alarm),
        isolation.isolation_recall(faulty, healthy),
        isolation.isolation_precision(healthy, faulty),
        isolation.exact_isolation(faulty, healthy),
        isolation.false_flag_rate(faulty, faulty),
        estimation.rmse(np.full((6, 3, 2), np.nan), np.zeros((6, 3, 2))),
        estimation.nis(np.full((6, 3), np.nan)),
        estimation.fault_mape_percent(scores[..., None], scores[..., None], healthy[..., :1], healthy[..., :1]),
        detection.first_alarm_time(T[:0], alarm[:0]),
        detection.detection_probability(alarm[:, :0], healthy[:, :0]),
    ):
        assert found.n == 0
        assert all(np.isnan(v) for v in found[:3])
    assert detection.roc(scores, healthy).threshold.size == 0
    assert not isolation.confusion(healthy, healthy, none_counted).any()


def test_one_run_has_a_value_without_an_interval():
    value, low, high, n = mean_over_runs(np.array([3.0]), np.array([2]))
    assert (value, n) == (1.5, 1)
    assert np.isnan([low, high]).all()
    rate = rate_over_runs(np.array([5]), np.array([10]))
    # Wilson's interval of p = 1/2 from a single trial, 1/2 -+ z / (2 sqrt(1 + z^2)): one run is hardly informative
    half = 1.959964 / (2 * np.sqrt(1 + 1.959964**2))
    assert (rate.low, rate.high) == (pytest.approx(0.5 - half, abs=1e-6), pytest.approx(0.5 + half, abs=1e-6))


def test_shapes_that_do_not_fit_are_refused():
    alarm, isolated, active = case()
    with pytest.raises(ValueError, match=r"alarm has shape \(3, 6\), expected \(6, 3\)"):
        detection.detection_probability(alarm.T, active)
    with pytest.raises(ValueError, match="isolated"):
        isolation.isolation_recall(isolated[..., :1], active)
    with pytest.raises(ValueError, match="t has shape"):
        detection.detection_delay(T[:3], alarm, active)
    require_shapes(alarm=(alarm, (6, 3)))


def test_a_share_is_the_proportion_of_runs_of_which_it_is_true():
    assert share(np.array([True, False, True, True])) == proportion(3, 4)
    assert share([]).n == 0 and np.isnan(share([]).value)


def test_proportion_is_wilson_of_scipy_and_never_leaves_zero_one():
    for hits, trials in ((0, 36), (7, 36), (60, 60)):
        found = proportion(hits, trials)
        interval = binomtest(hits, trials).proportion_ci(method="wilson")
        assert found == (hits / trials, interval.low, interval.high, trials)
        assert 0 <= found.low <= found.value <= found.high <= 1
    assert proportion(0, 0).n == 0


def test_rate_over_runs_is_wilson_for_as_many_samples_as_runs_where_runs_agree_wholly():
    found = rate_over_runs(np.zeros(20, int), np.full(20, 40))
    assert found.high == pytest.approx(binomtest(0, 20).proportion_ci(method="wilson").high, rel=1e-9)
    assert (found.low, found.n) == (0, 20)


def test_rate_over_runs_is_wilson_of_all_samples_at_most():
    """Runs that differ by one sample differ less than independent samples would: n is capped at the samples."""
    found = rate_over_runs(np.array([5, 6] * 500), np.full(1000, 10))
    wilson = binomtest(5500, 10000).proportion_ci(method="wilson")
    # the degrees of freedom (z/t)^2 widen it by 1.2e-3 of its half width at 999
    assert found.low == pytest.approx(wilson.low, abs=2e-3 * (wilson.high - wilson.low))
    assert found.high == pytest.approx(wilson.high, abs=2e-3 * (wilson.high - wilson.low))


@pytest.mark.parametrize(("p", "concentration", "runs"), [(0.3, 1.0, 10), (0.3, 20.0, 50), (0.95, 20.0, 50)])
def test_interval_of_a_rate_covers_the_truth_though_samples_of_a_run_depend(p, concentration, runs):
    """Beta-binomial runs. 2000 repetitions: the standard error of a coverage of 0.95 is 0.005; three are allowed, and 0.01
    for an interval that holds for many runs only. Samples taken for independent cover 0.37 to 0.82 of the time here.
    """
    rng = np.random.default_rng(7)
    covered = 0
    for _ in range(2000):
        samples = rng.integers(20, 41, runs)
        hits = rng.binomial(samples, rng.beta(p * concentration, (1 - p) * concentration, runs))
        found = rate_over_runs(hits, samples)
        covered += found.low <= p <= found.high
    assert abs(covered / 2000 - 0.95) <= 0.01 + 3 * 0.005


def test_interval_of_a_mean_is_students_and_of_a_ratio_that_of_its_residuals():
    rng = np.random.default_rng(1)
    values, counts = rng.exponential(1.0, 25), rng.integers(1, 9, 25)
    alike = mean_over_runs(values, np.ones(25))
    oracle = ttest_1samp(values, 0.0).confidence_interval(0.95)
    np.testing.assert_allclose(alike[:3], [values.mean(), oracle.low, oracle.high], rtol=1e-12)
    ratio = mean_over_runs(values * counts, counts)
    r = np.sum(values * counts) / np.sum(counts)
    # the variance of the mean of residuals s - r n, over the mean count
    half = student.ppf(0.975, 24) * np.std(values * counts - r * counts, ddof=1) / np.sqrt(25) / counts.mean()
    np.testing.assert_allclose(ratio, [r, r - half, r + half, 25], rtol=1e-12)
    assert mean_over_runs(np.full(5, 2.0), np.ones(5)) == (2.0, 2.0, 2.0, 5)


def test_interval_of_a_mean_covers_the_truth():
    """Normal runs, 5 of them, of which Student's interval covers exactly 95 %; three standard errors of 400 trials."""
    rng = np.random.default_rng(8)
    covered = 0
    for _ in range(400):
        found = mean_over_runs(rng.normal(2.0, 1.0, 5), np.ones(5))
        covered += found.low <= 2.0 <= found.high
    assert abs(covered / 400 - 0.95) <= 3 * 0.011


def test_interval_of_a_median_covers_the_truth_and_repeats():
    """Exponential runs, 40 of them: BCa errs by O(1/B), about 0.03 for a median, plus three standard errors of 0.011."""
    rng = np.random.default_rng(8)
    covered = 0
    for _ in range(400):
        values = rng.exponential(2.0, 40)
        found = bootstrap_over_runs(lambda runs, v=values: np.median(v[runs], axis=-1), 40)
        covered += found.low <= 2.0 * np.log(2) <= found.high
    assert abs(covered / 400 - 0.95) <= 0.03 + 3 * 0.011
    assert found == bootstrap_over_runs(lambda runs: np.median(values[runs], axis=-1), 40)


def test_the_variance_of_a_rate_is_that_between_runs_by_its_formula():
    """Three runs: without B/(B - 1) the variance would be two thirds of it. Written out from Korn and Graubard (1998)."""
    hits, samples = np.array([1, 4, 7]), np.array([20, 20, 20])
    p = 12 / 60
    variance = ((0.05 - p) ** 2 + (0.2 - p) ** 2 + (0.35 - p) ** 2) / (3 * 2)  # of a mean of three: s^2 / 3, s^2 over B - 1
    z = norm.ppf(0.975)
    n = min(p * (1 - p) / variance, 60) * (z / student.ppf(0.975, 2)) ** 2
    centre, half = (p + z**2 / (2 * n)) / (1 + z**2 / n), z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + (z / n / 2) ** 2)
    np.testing.assert_allclose(rate_over_runs(hits, samples), [p, centre - half, centre + half, 3], rtol=1e-12)


def test_mean_of_areas_is_the_mean_and_its_interval_that_of_means_without_each_run():
    rng = np.random.default_rng(6)
    active = np.zeros((20, 12, 1), bool)
    active[8:15] = True
    curves = [(rng.standard_normal((20, 12)) + size * active[..., 0], active) for size in (0.5, 2.0)]
    found, each = detection.mean_auc(curves), [detection.auc(*curve) for curve in curves]
    assert found.value == pytest.approx(np.mean([e.value for e in each]), rel=1e-12)
    rest = [np.delete(np.arange(12), run) for run in range(12)]
    areas = np.mean([[detection.auc(s[:, r], a[:, r]).value for r in rest] for s, a in curves], axis=0)
    variance = 11 / 12 * np.sum((areas - areas.mean()) ** 2)
    z, p = norm.ppf(0.975), found.value
    n = p * (1 - p) / variance * (z / student.ppf(0.975, 11)) ** 2
    half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + (z / n / 2) ** 2)
    assert (found.high - found.low) / 2 == pytest.approx(half, rel=1e-9)
    assert detection.mean_auc([]).n == 0


def test_rmse_by_hand_and_as_the_frobenius_norm():
    rng = np.random.default_rng(2)
    truth, estimate = rng.standard_normal((2, 30, 4, 5))
    norms = [np.linalg.norm(truth[:, b] - estimate[:, b]) / np.sqrt(30 * 5) for b in range(4)]
    found = estimation.rmse(estimate, truth)
    assert found.value == pytest.approx(np.mean(norms), rel=1e-12)
    assert found.low < found.value < found.high
    estimate[:, 3] = np.nan
    assert estimation.rmse(estimate, truth)[0::3] == (pytest.approx(np.mean(norms[:3]), rel=1e-12), 3)
    hand = estimation.rmse(np.array([[[3.0, 4.0]]]), np.zeros((1, 1, 2)))
    assert hand.value == pytest.approx(np.sqrt(12.5))


def test_rmse_of_samples_and_of_runs_that_are_counted():
    truth, estimate = np.zeros((3, 2, 1)), np.array([3.0, 1.0, 4.0, 2.0, 5.0, np.nan]).reshape(3, 2, 1)
    where = np.array([[True, False], [True, True], [False, True]])
    assert estimation.rmse(estimate, truth, where).value == pytest.approx((np.sqrt((9 + 16) / 2) + 2) / 2)
    squares = estimation.root_mean_square(estimate**2, where)
    assert squares == estimation.rmse(estimate, truth, where)
    assert squares.n == 2
    where[:, 1] = False
    assert estimation.root_mean_square(estimate**2, where)[0::3] == (pytest.approx(np.sqrt(12.5)), 1)


def test_nees_of_the_true_covariance_is_one():
    """Mean of n K B squared standard normals over n: standard error sqrt(2 / (n K B))."""
    rng = np.random.default_rng(9)
    n, shape = 4, (50, 40)
    half = np.diag([1e6, 1.0, 1e-3, 5.0]) @ np.tril(rng.standard_normal((n, n)) + 3 * np.eye(n))
    error = rng.standard_normal((*shape, n)) @ half.T
    covariance = np.broadcast_to(half @ half.T, (*shape, n, n))
    found = estimation.nees(error, np.zeros_like(error), covariance)
    assert abs(found.value - 1) < 4 * np.sqrt(2 / (n * 2000))
    assert estimation.nees(error, np.zeros_like(error), 4 * covariance).value == pytest.approx(found.value / 4, rel=1e-9)
    low, high = estimation.consistency_limits(n, 40)
    each = [estimation.nees(error[k : k + 1], 0 * error[k : k + 1], covariance[k : k + 1]).value for k in range(50)]
    inside = np.mean([low <= v <= high for v in each])
    assert inside >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / 50)


def test_nees_leaves_out_what_diverged_and_refuses_singular_covariances():
    error = np.ones((2, 3, 2))
    covariance = np.broadcast_to(np.eye(2), (2, 3, 2, 2)).copy()
    covariance[:, 1] = np.nan
    assert estimation.nees(error, 0 * error, covariance)[0::3] == (1.0, 2)
    with pytest.raises(ValueError, match="singular"):
        estimation.nees(error, 0 * error, np.ones((2, 3, 2, 2)))
    with pytest.raises(ValueError, match="not positive"):
        estimation.nees(error, 0 * error, np.zeros((2, 3, 2, 2)))
    with pytest.raises(ValueError, match="at least 1"):
        estimation.consistency_limits(0, 3)


def test_nis_is_the_mean_of_what_was_read():
    assert estimation.nis(np.array([[1.0, np.nan], [3.0, 5.0]])).value == pytest.approx(3.0)


def test_fault_mape_by_hand():
    active = np.ones((2, 1, 2), bool)
    size = np.array([[[2.0, -4.0]], [[2.0, 0.0]]])
    estimate = np.array([[[1.0, -5.0]], [[np.nan, 1.0]]])
    assert estimation.fault_mape_percent(estimate, size, active, active).value == pytest.approx((50 + 25) / 2)
    named = np.zeros_like(active)
    named[0, 0, 1] = True
    assert estimation.fault_mape_percent(estimate, size, named, active).value == pytest.approx(25)


def test_measured_states_by_quantity():
    found = estimation.measured_states(tanks())
    assert list(found) == ["level"]  # the flows are algebraic
    np.testing.assert_array_equal(found["level"], [0, 1])
    assert len(estimation.measured_states(chain(3))) == 3


def test_diverged_runs_are_counted_and_left_out():
    diverged = np.zeros((6, 3), bool)
    diverged[4:, 1] = True
    alarm, isolated, active = case()
    lost, (alarm, isolated) = without_diverged(diverged, alarm, isolated)
    assert (lost, alarm.shape, isolated.shape) == (1, (6, 2), (6, 2, 2))
    assert without_diverged(diverged.any(axis=0), active)[0] == 1
    lost, (nothing,) = without_diverged(np.ones((6, 2), bool), alarm)
    assert lost == 2
    assert rate_over_runs(nothing.sum(axis=0), np.full(0, 6)) is NOTHING


def test_one_run_needs_no_axis_of_runs() -> None:
    rng = np.random.default_rng(0)
    scores, active, isolated = rng.random(40), rng.random((40, 3)) < 0.3, rng.random((40, 3)) < 0.3
    where = rng.random(40) < 0.8
    whole = detection.roc(scores[:, None], active[:, None], where[:, None])
    for given in (active, active[:, None], active.any(axis=1)):
        for one, other in zip(detection.roc(scores, given, where), whole, strict=True):
            np.testing.assert_array_equal(one, other)
    matrix = isolation.confusion(isolated[:, None], active[:, None], where[:, None])
    np.testing.assert_array_equal(isolation.confusion(isolated, active, where), matrix)
    assert isolation.confusion(isolated[:, 0], active[:, 0]).sum() == 40


def test_samples_that_count_in_another_order_of_axes_are_refused() -> None:
    scores, active = np.ones((4, 2)), np.zeros((4, 2, 3), bool)
    for statistic, values in ((detection.roc, scores), (isolation.confusion, active)):
        with pytest.raises(ValueError, match="where"):
            statistic(values, active, np.ones((2, 4), bool))
