"""Sequential rules: their recursions against literal loops, their limits against known laws, missing samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2, norm

from fusion_sfdia.detectors.kalman_banks.sequential_rules import (
    Cusum,
    Ewma,
    SequentialRule,
    Shewhart,
    SumOfSquares,
    cusum_limit,
)

RULES: list[SequentialRule] = [Shewhart(), SumOfSquares(5), Cusum(1.0), Ewma(0.2)]
every_rule = pytest.mark.parametrize("rule", RULES, ids=lambda rule: type(rule).__name__)


def literal(rule: SequentialRule, z: np.ndarray) -> float:
    """The statistic of one sensor after the numbers z, by its textbook definition."""
    if isinstance(rule, Shewhart):
        return abs(float(z[-1]))
    if isinstance(rule, SumOfSquares):
        return float(np.sqrt(sum(v**2 for v in z[-rule.length :])))
    if isinstance(rule, Cusum):
        up = down = 0.0
        for v in z:
            up, down = max(0.0, up + v - rule.shift / 2), max(0.0, down - v - rule.shift / 2)
        return max(up, down)
    assert isinstance(rule, Ewma)
    e = 0.0
    for v in z:
        e = (1 - rule.lam) * e + rule.lam * v
    grown = 1 - (1 - rule.lam) ** (2 * len(z))  # Lucas and Saccucci 1990, (2)
    return abs(e) / float(np.sqrt(rule.lam / (2 - rule.lam) * grown))


@every_rule
def test_a_recursion_is_the_textbook_loop_and_does_not_change_without_a_reading(rule: SequentialRule) -> None:
    rng = np.random.default_rng(0)
    z = rng.standard_normal((40, 3, 2)) + 0.5
    z[rng.random(z.shape) < 0.3] = np.nan
    z[0] = 0.7
    memory = rule.start((3,), 2)
    for k in range(len(z)):
        memory = rule.advance(memory, z[k])
        for run in range(3):
            for sensor in range(2):
                seen = z[: k + 1, run, sensor]
                expected = literal(rule, seen[np.isfinite(seen)])
                # forty sums of numbers of a few units
                assert rule.statistic(memory)[run, sensor] == pytest.approx(expected, rel=1e-12, abs=1e-12)


def alarms(rule: SequentialRule, share: float, steps: int, runs: int) -> np.ndarray:
    rng = np.random.default_rng(1)
    memory = rule.start((runs,), 1)
    found = np.empty((steps, runs), bool)
    for k in range(steps):
        memory = rule.advance(memory, rng.standard_normal((runs, 1)))
        found[k] = (rule.statistic(memory) > rule.limit(memory, share))[:, 0]
    return found


@pytest.mark.parametrize("rule", [Shewhart(), SumOfSquares(5), Ewma(0.2)], ids=lambda rule: type(rule).__name__)
def test_exact_limits_are_exact_at_every_step(rule: SequentialRule) -> None:
    found = alarms(rule, 0.02, 12, 40_000)
    # runs are independent: the rate of each step is binomial; 12 steps, four standard errors
    assert np.all(np.abs(found.mean(axis=1) - 0.02) < 4 * np.sqrt(0.02 * 0.98 / 40_000))


def test_a_partly_filled_window_has_the_chi_square_limit_of_its_samples() -> None:
    rule = SumOfSquares(3)
    memory = rule.start((), 1)
    for held in (1, 2, 3, 3):
        memory = rule.advance(memory, np.array([1.0]))
        assert rule.limit(memory, 0.01)[0] == pytest.approx(np.sqrt(chi2.isf(0.01, held)), rel=1e-12)


@pytest.mark.parametrize("k", [0.5, 0.75])
def test_the_limit_of_a_cumulative_sum_gives_the_stated_mean_time_between_false_alarms(k: float) -> None:
    share, runs, most = 0.02, 4000, 2000
    rng = np.random.default_rng(2)
    rule, first = Cusum(2 * k), np.full(4000, most)
    memory = rule.start((runs,), 1)
    for step in range(1, most + 1):
        memory = rule.advance(memory, rng.standard_normal((runs, 1)))
        over = (rule.statistic(memory) > rule.limit(memory, share))[:, 0]
        first[over & (first == most)] = step
    assert np.all(first < most)
    # run lengths are about exponential, their mean has the standard error mean / sqrt(runs); Siegmund's approximation
    # is asymptotic: a tolerance of a tenth for run lengths as short as 50
    assert abs(first.mean() * share - 1) < 0.1 + 4 / np.sqrt(runs)


def test_the_limit_of_a_cumulative_sum_against_a_published_run_length() -> None:
    """Two-sided, k = 1/2: h = 4 has the average run length 168, h = 5 has 465 (Montgomery, Statistical Quality Control)."""
    for h, length in ((4.0, 168.0), (5.0, 465.0)):
        # d h / d log(length) = 1 / (2 k) = 1: an error of a run length by 2 % is .02 of the limit
        assert cusum_limit(0.5, 1 / length) == pytest.approx(h, abs=0.02)


@every_rule
def test_a_limit_is_positive_and_increases_as_the_share_decreases(rule: SequentialRule) -> None:
    memory = rule.advance(rule.start((2,), 3), np.zeros((2, 3)))
    limits = [rule.limit(memory, share) for share in (0.9, 1e-2, 1e-4, 1e-8)]
    assert np.all(limits[0] > 0) and all(np.all(b > a) for a, b in pairwise(limits))
    assert limits[0].shape == (2, 3)


def test_after_one_sample_the_limit_is_the_gaussian_quantile() -> None:
    for rule in (Shewhart(), SumOfSquares(9), Ewma(0.3)):
        memory = rule.advance(rule.start((), 1), np.array([2.5]))
        ratio = rule.statistic(memory) / rule.limit(memory, 1e-3)
        assert ratio[0] == pytest.approx(2.5 / norm.isf(5e-4), rel=1e-12)


def test_invalid_settings_are_rejected() -> None:
    with pytest.raises(ValueError, match="length, in samples, is 0"):
        SumOfSquares(0)
    with pytest.raises(ValueError, match="shift is 0"):
        Cusum(0.0)
    for lam in (0.0, 1.2):
        with pytest.raises(ValueError, match="lam is"):
            Ewma(lam)
