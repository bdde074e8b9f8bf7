"""The noise that readings show: its size, its correlation, and readings that are clipped."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from joints import random_joint
from numpy.typing import NDArray
from rounding import rounding
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.stats import chi2, norm

from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, statistics
from fusion_sfdia.detectors.kalman_banks.likelihood_window import Weighed
from fusion_sfdia.detectors.kalman_banks.reading_noise import (
    BLOCK,
    CUT,
    LARGER,
    OWN,
    ReadingNoise,
    clipped,
    correlation,
    inflation_of,
    is_larger,
    learnt,
    nothing_shown,
    unclipped,
    with_sums,
)
from fusion_sfdia.plant.slow_noise import inflation_of as inflation_of_share

Array = NDArray[Any]
RUNS = 200
WHITE = np.ones((100, 5))  # no sensor states slow noise
# the slope of P(e^2 > m exp(d)) - P(e^2 < m exp(d)) at d = 0, where m is the median of chi-square
MEDIAN = float(chi2.median(1))
SLOPE = 2 * MEDIAN * float(chi2.pdf(MEDIAN, 1))


def readings(e: Array) -> LeaveOneOut:
    """Leave-one-out statistics of independent readings with weight 4, whose standardised innovations are e (..., N)."""
    return LeaveOneOut(2 * e, np.full(e.shape, 4.0), None, np.ones(e.shape, bool), None, None)


def after(e: Array, now: ReadingNoise | None = None) -> ReadingNoise:
    """What is known after standardised innovations e (K, B, N)."""
    now = nothing_shown(e.shape[1:-1], e.shape[-1]) if now is None else now
    for sample in e:
        now = learnt(now, readings(sample), np.ones(sample.shape[:-1], bool))
    return now


def variance_of_sum(n: int, rho: float) -> float:
    """Of n samples with the correlation rho^k at lag k, over that of independent ones."""
    return float(toeplitz(rho ** np.arange(n)).sum() / n)


def mean_of_cut(scale: float) -> float:
    """E min(scale chi-square, CUT), by integration of P(scale chi-square > c) over c."""
    c = np.linspace(0.0, CUT, 200_001)
    return float(np.trapezoid(chi2.sf(c / scale, 1), c))


@pytest.mark.parametrize("variance", [0.3, 1.0, 3.0, 30.0])
def test_the_size_is_the_variance_of_the_noise(variance: float) -> None:
    """Of a filter that takes into account what is larger than half in the logarithm, as the bank does."""
    rng, now = np.random.default_rng(0), nothing_shown((RUNS,), 6)
    for _ in range(400):
        taken = np.exp(np.maximum(now.size - LARGER, 0.0))
        now = after(np.sqrt(variance / taken) * rng.standard_normal((1, RUNS, 6)), now)
    found = now.size.mean(axis=-1)
    # the bias of a recursion with large steps: .14 times its variance, here .05
    assert abs(found.mean() - np.log(variance)) < 4 * found.std() / np.sqrt(RUNS) + 0.01


def test_noise_as_stated_is_hardly_ever_taken_as_larger() -> None:
    """ln kappa varies by STEP / (2 SLOPE) a sensor, and by TOGETHER / (2 SLOPE N) for all: 0.2 in all for 20 sensors."""
    found = after(np.random.default_rng(1).standard_normal((300, RUNS, 20)))
    sd = np.sqrt((0.025 + 0.2 / 20) / (2 * SLOPE))
    share = norm.sf(0.5 / sd)
    runs = is_larger(found).mean(axis=-1)
    assert runs.mean() < 2 * share + 4 * runs.std() / np.sqrt(RUNS)


@pytest.mark.parametrize("sensors", [200, 1000])
def test_of_many_sensors_chance_takes_none_as_larger(sensors: int) -> None:
    """In nearly all steps, although it would with the level of few sensors: gains stand still only then."""
    rng = np.random.default_rng(6)
    now = after(rng.standard_normal((300, 1, sensors)))
    larger, few = [], []
    for _ in range(200):
        now = after(rng.standard_normal((1, 1, sensors)), now)
        larger.append(is_larger(now).any())
        few.append((now.size > LARGER).any())
    assert np.mean(larger) < 0.05 < np.mean(few)


def test_what_all_sensors_have_in_common_is_followed_faster_than_what_one_has() -> None:
    rng = np.random.default_rng(2)
    known = after(rng.standard_normal((200, RUNS, 8)))
    louder = rng.standard_normal((10, RUNS, 8))
    alone = louder.copy()
    alone[..., 0] *= 3
    of_all, of_one = after(3 * louder, known), after(alone, known)
    together, own = (np.mean((now.size - known.size)[:, 0]) for now in (of_all, of_one))
    assert together > np.log(9) / 2  # half of the way within ten samples
    assert 0 < own < together / 3


def test_a_fault_of_one_sensor_hardly_moves_what_is_known_of_the_others() -> None:
    rng = np.random.default_rng(3)
    known = after(rng.standard_normal((200, RUNS, 8)))
    healthy = rng.standard_normal((10, RUNS, 8))
    faulty = healthy.copy()
    faulty[..., 0] += 1000.0
    ours, theirs = after(faulty, known).size[:, 1:], after(healthy, known).size[:, 1:]
    assert 0 < np.mean(ours - theirs) < 10 * 0.2 / 8  # one of eight votes


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_the_correlation_is_that_of_the_noise_in_cut_differences(rho: float) -> None:
    rng = np.random.default_rng(4)
    e = lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], rng.standard_normal((600, RUNS, 6)), axis=0)[100:]
    expected = 1 - mean_of_cut(1 - rho) / mean_of_cut(1.0)
    of_all = 1 - after(e).every / mean_of_cut(1.0)
    # kappa is estimated: differences are over 1 / kappa, whose mean is 1 + its variance, some 0.05
    assert abs(of_all.mean() - expected) < 0.1 * (1 - expected) + 4 * of_all.std() / np.sqrt(RUNS)


def test_a_model_that_is_off_is_off_by_the_variance_of_the_levels() -> None:
    rng, sensors, variance = np.random.default_rng(8), 40, 0.25
    levels = np.sqrt(variance) * rng.standard_normal((RUNS, sensors))
    found = after(levels + rng.standard_normal((256, RUNS, sensors))).off
    # what chance may add to the median is taken off: 1.4 / 127; the median of 40 is high by some 3 %
    assert abs(found.mean() - variance) < 4 * found.std() / np.sqrt(RUNS) + 0.05 * variance
    white = after(rng.standard_normal((256, RUNS, sensors))).off
    assert np.mean(white == 0) > norm.cdf(1) - 4 * np.sqrt(0.16 * 0.84 / RUNS) and white.max() < variance / 10


def test_a_fault_that_begins_is_judged_without_what_it_does_to_the_levels() -> None:
    rng = np.random.default_rng(9)
    known = after(rng.standard_normal((12 * BLOCK, RUNS, 3)))
    within = after(2 + rng.standard_normal((BLOCK, RUNS, 3)), known)
    np.testing.assert_array_equal(within.off, known.later)
    assert after(2 + rng.standard_normal((BLOCK, RUNS, 3)), within).off.mean() > 10 * known.later.mean()


def test_what_a_model_is_off_counts_in_the_sums_of_sensors_alone() -> None:
    age = np.array([[1.0, 5.0, 30.0]])
    right = nothing_shown((1,), 3)
    off = right._replace(off=np.array([0.2]))
    without, found = inflation_of(right, age, WHITE), inflation_of(off, age, WHITE)
    np.testing.assert_array_equal(found.common, without.common)
    np.testing.assert_allclose(found.own - without.own, np.repeat(0.2 * age[..., None], 3, axis=-1), rtol=1e-12)


def test_before_any_reading_noise_is_supposed_to_be_correlated_by_four_fifths() -> None:
    age = np.array([[1.0, 2.0, 7.0, 40.0]])
    found = inflation_of(nothing_shown((1,), 3), age, WHITE)
    expected = [variance_of_sum(int(n), 0.8) for n in age[0]]
    np.testing.assert_allclose(found.common[0], expected, rtol=rounding(25.0, 100))
    np.testing.assert_allclose(found.own[0], np.repeat(found.common[0][:, None], 3, axis=1), rtol=0)


def test_sums_vary_as_those_of_noise_with_its_size_and_correlation() -> None:
    """One sensor more correlated than all together, another louder: their own inflation; all compete by the common one."""
    age, white = np.array([[1.0, 5.0, 30.0]]), mean_of_cut(1.0)
    now = nothing_shown((1,), 5)._replace(
        own=white * np.array([[1.0, 0.2, 1.0, 1.0, 1.0]]),
        every=np.array([white * 0.7]),
        spread=np.array([[1.2, 1.2, 3.0, 1.2, 1.0]]),
    )
    found = inflation_of(now, age, WHITE)
    shared, correlated = (np.array([variance_of_sum(int(n), q) for n in age[0]]) for q in (0.3, 0.8))
    near = 1e-5  # of the integral
    np.testing.assert_allclose(found.common[0], 1.2 * shared, rtol=near)
    np.testing.assert_allclose(found.own[0, :, 0], 1.2 * shared, rtol=near)
    np.testing.assert_allclose(found.own[0, :, 1], 1.2 * correlated, rtol=near)
    np.testing.assert_allclose(found.own[0, :, 2], 3.0 * shared, rtol=near)
    np.testing.assert_allclose(found.own[0, :, 4], shared, rtol=near)


def test_sums_vary_at_least_as_slow_noise_that_is_stated() -> None:
    """All together by its mean, and each sensor by its own; a sensor that shows more counts as it shows itself."""
    age, white = np.array([[1.0, 5.0, 30.0]]), mean_of_cut(1.0)
    now = nothing_shown((1,), 3)._replace(own=white * np.array([[1.0, 1.0, 0.2]]), every=np.array([white * 0.9]))
    stated = inflation_of_share(np.maximum(np.arange(31.0), 1)[:, None], np.array([0.5, 0, 0]), np.array([0.98, 0, 0]))
    of_slow = stated[[1, 5, 30], 0]
    shown, alone = (np.array([variance_of_sum(int(n), q) for n in age[0]]) for q in (0.1, 0.8))
    found = inflation_of(now, age, stated)
    near = 1e-5  # of the integral
    np.testing.assert_allclose(found.common[0], np.maximum(shown, (of_slow + 2) / 3), rtol=near)
    np.testing.assert_allclose(found.own[0, :, 0], np.maximum(of_slow, shown), rtol=near)
    np.testing.assert_allclose(found.own[0, :, 2], alone, rtol=near)


def sums_of(variance: float, steps: int = 1500) -> Array:
    """v of runs whose sums have that variance over what is expected: of 3 sensors over 4, 10 and 20 samples, white noise."""
    rng, white = np.random.default_rng(10), mean_of_cut(1.0)
    now = nothing_shown((RUNS,), 3)._replace(
        own=np.full((RUNS, 3), white), every=np.full(RUNS, white), samples=np.full(RUNS, 300.0)
    )
    age, b = np.tile([4.0, 10.0, 20.0], (RUNS, 1)), np.full((RUNS, 3, 3), 7.0)
    used, every = np.ones((RUNS, 3), bool), np.ones(RUNS, bool)
    for _ in range(steps):
        a = np.sqrt(variance * b) * rng.standard_normal(b.shape)
        a[:, 0] *= 1000  # over few samples: not followed
        now = with_sums(now, Weighed(a, a, a, b, age, a), used, WHITE, every)
    return now.sums


def test_sums_that_vary_less_than_expected_are_followed() -> None:
    found = sums_of(0.6)
    assert abs(found.mean() - mean_of_cut(0.6) / mean_of_cut(1.0)) < 4 * found.std() / np.sqrt(RUNS) + 0.005


def test_sums_are_never_taken_to_vary_more_than_expected_or_far_less() -> None:
    least = sums_of(0.1, 400)
    assert np.all(least >= 0.4) and np.mean(least == 0.4) > 0.5
    assert np.all(sums_of(30.0, 100) == 1.0)


def test_sums_that_vary_less_count_as_that_but_not_as_less_than_white_or_stated_noise() -> None:
    age, white = np.array([[1.0, 5.0, 30.0]]), mean_of_cut(1.0)
    now = nothing_shown((1,), 3)._replace(own=np.full((1, 3), white), every=np.array([white * 0.7]), sums=np.array([0.6]))
    shared = np.array([variance_of_sum(int(n), 0.3) for n in age[0]])
    v = np.array([1.0, 1.0, 0.6])  # of sums over 8 samples and more
    found = inflation_of(now, age, WHITE)
    np.testing.assert_allclose(found.common[0], np.maximum(v * shared, 1.0), rtol=1e-5)
    np.testing.assert_allclose(found.own[0, :, 1], np.maximum(v * shared, 1.0), rtol=1e-5)
    stated = np.full((100, 3), 1.5)
    found = inflation_of(now._replace(off=np.array([0.1])), age, stated)
    np.testing.assert_allclose(found.common[0], np.maximum(v * shared, 1.5), rtol=1e-5)
    whole = np.maximum(shared, 1.5) + 0.1 * age[0]
    np.testing.assert_allclose(found.own[0, :, 1], np.maximum(v * whole, 1.5 + 0.1 * age[0]), rtol=1e-5)


def test_correlation_that_rises_counts_for_the_process_a_block_later_and_one_that_falls_at_once() -> None:
    rng, age, none = np.random.default_rng(11), np.array([[10.0]]), np.ones((100, 8))
    slow = lfilter([0.6], [1.0, -0.8], rng.standard_normal((7 * BLOCK, 1, 8)), axis=0)
    white = rng.standard_normal((12 * BLOCK, 1, 8))
    known = after(white)
    within, before = (inflation_of(now, age, none) for now in (after(slow[:BLOCK], known), known))
    usual = after(slow[:BLOCK], known).spread.mean() / known.spread.mean()
    assert within.own.mean() > 1.4 * before.own.mean()
    assert within.common[0, 0] < 1.3 * usual * before.common[0, 0]
    later = after(slow, known)
    found = inflation_of(later, age, none)
    assert found.common[0, 0] > 2 * before.common[0, 0]
    again = inflation_of(after(white[: 4 * BLOCK - 2], later), age, none)
    assert again.common[0, 0] <= np.median(again.own) * (1 + 1e-12)


def test_correlations_are_believed_from_white_to_nearly_constant() -> None:
    assert correlation(2.0) == 0.0
    assert correlation(0.0) == pytest.approx(0.98)


def test_louder_noise_counts_in_the_windows_for_as_long_as_they_have_its_sums() -> None:
    now = nothing_shown((1,), 2)._replace(spread=np.array([[1.6, 1.0]]))
    quiet = np.full((64, 1, 2), 0.5)
    half = after(quiet[:1], now).spread[0, 0]
    assert half == pytest.approx(1.6 * 31 / 32)
    assert after(quiet, now).spread[0, 0] == 1.0


def test_what_is_known_of_a_sensor_stays_while_it_has_no_reading() -> None:
    rng = np.random.default_rng(5)
    known = after(rng.standard_normal((50, 2, 3)))
    sample = readings(rng.standard_normal((2, 3)))
    without = LeaveOneOut(sample.whitened, sample.weight, None, np.array([[True, True, False]] * 2), None, None)
    later = learnt(known, without, np.array([True, False]))
    np.testing.assert_array_equal(later.own[0, 2], known.own[0, 2])
    np.testing.assert_array_equal(later.last[0, 2], known.last[0, 2])
    for now, before in zip(later, known, strict=True):
        np.testing.assert_array_equal(now[1], before[1])  # a run that is not followed
    assert np.all(later.samples[0] == known.samples[0] + 1) and OWN > 1


@pytest.mark.parametrize("size", [40.0, -40.0])
def test_an_outlier_counts_as_a_reading_three_deviations_from_what_the_others_predict(size: float) -> None:
    rng = np.random.default_rng(6)
    joint, _ = random_joint(rng, 4, 6, batch=(50,))
    y = joint.y + 0.01 * rng.standard_normal((50, 6))
    spread = np.full((50, 6), 100.0)  # no other reading is clipped
    spread[:, 2] = 2.0
    used = np.ones((50, 6), bool)
    found = statistics(joint, y, used)
    y[:, 2] += size * np.sqrt(found.variance[:, 2])
    found = statistics(joint, y, used)
    # u / w is the reading less its prediction by the others
    near = y.copy()
    near[:, 2] += -found.innovation[:, 2] + np.sign(size) * 3.0 * np.sqrt(2.0 * found.variance[:, 2])
    expected, now = statistics(joint, near, used), clipped(found, spread)
    scale = rounding(100.0, 1000) * np.abs(found.whitened).max()
    np.testing.assert_allclose(now.found.whitened, expected.whitened, rtol=0, atol=scale)
    assert now.found.scores is not None and expected.scores is not None
    np.testing.assert_allclose(now.found.scores, expected.scores, rtol=0, atol=scale)
    np.testing.assert_allclose(now.less, found.whitened - expected.whitened, rtol=0, atol=scale)
    again = unclipped(now, found, np.arange(50) < 10)
    np.testing.assert_array_equal(again.found.whitened[:10], found.whitened[:10])
    np.testing.assert_array_equal(again.found.whitened[10:], now.found.whitened[10:])
    assert not again.less[:10].any() and again.less[10:].any(axis=-1).all()


def test_readings_within_three_deviations_are_as_they_are() -> None:
    rng = np.random.default_rng(7)
    joint, _ = random_joint(rng, 4, 6, batch=(50,))
    found = statistics(joint, joint.y + 0.01 * rng.standard_normal((50, 6)), np.ones((50, 6), bool))
    assert clipped(found, np.ones((50, 6))).found is found
