"""Threshold rules: their bounds hold, and alpha from a false-alarm probability."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.detectors.stochastic_thresholds.threshold_rules import RULES, alpha_for, conformal_alpha, false_alarm_of


def test_rules_against_numbers_checked_by_hand() -> None:
    assert false_alarm_of("chebyshev", 2.0) == 0.25
    assert false_alarm_of("cantelli", 3.0) == 0.2
    assert false_alarm_of("cantelli-one-sided", 2.0) == pytest.approx(0.2)
    assert false_alarm_of("gaussian", 1.959963984540054) == pytest.approx(0.05)
    assert false_alarm_of("bound", 1.0) == 0.0
    assert alpha_for("chebyshev", 0.01) == pytest.approx(10.0)
    assert alpha_for("chebyshev", 0.01, components=4) == pytest.approx(20.0)  # Bonferroni


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("p", [0.3, 1e-2, 1e-6])
def test_alpha_and_probability_are_inverse(rule: str, p: float) -> None:
    assert false_alarm_of(rule, alpha_for(rule, p)) == pytest.approx(p)


@pytest.mark.parametrize("rule", ["chebyshev", "cantelli", "cantelli-one-sided"])
@pytest.mark.parametrize("draw", ["gaussian", "three points", "exponential", "student"])
def test_inequalities_hold_for_any_distribution(rule: str, draw: str) -> None:
    rng, alpha, M = np.random.default_rng(5), 3.0, 200_000
    x = {
        "gaussian": rng.standard_normal(M),
        "three points": rng.choice([-3.001, 0.0, 3.001], M, p=[1 / 18, 8 / 9, 1 / 18]),  # 1/9: Chebyshev's worst case
        "exponential": rng.exponential(size=M) - 1.0,
        "student": rng.standard_t(3, M) / np.sqrt(3.0),
    }[draw]
    far = x > alpha if rule.endswith("one-sided") else np.abs(x) > alpha
    claim = false_alarm_of(rule, alpha)
    assert np.mean(far) <= claim * 1.01 + 3 * np.sqrt(claim / M)  # 1 % for the variance of the three points, 3 standard errors
    if (rule, draw) == ("chebyshev", "three points"):
        assert np.mean(far) >= claim - 3 * np.sqrt(claim / M), "the bound is attained"


def test_a_gaussian_quantile_is_exact_for_gaussians_alone() -> None:
    rng, M = np.random.default_rng(6), 400_000
    alpha = alpha_for("gaussian", 0.01)
    assert np.mean(np.abs(rng.standard_normal(M)) > alpha) == pytest.approx(0.01, abs=4 * np.sqrt(0.01 / M))
    assert np.mean(np.abs(rng.standard_t(3, M) / np.sqrt(3.0)) > alpha) > 0.012


@pytest.mark.parametrize(("M", "p"), [(19, 0.05), (99, 0.05), (150, 0.02)])
def test_conformal_thresholds_keep_their_probability_with_few_samples(M: int, p: float) -> None:
    rng, trials = np.random.default_rng(7), 8_000
    alpha = conformal_alpha(rng.standard_cauchy((M, trials)) ** 2, p)
    further = rng.standard_cauchy(trials) ** 2
    rate = np.mean(further > alpha)
    error = 4 * np.sqrt(p / trials)
    assert p - 1 / (M + 1) - error < rate <= p + error  # at most p, and no more than one rank below


def test_missing_scores_count_as_the_largest() -> None:
    assert conformal_alpha([1.0, np.nan, 2.0, 3.0], 0.4) == 3.0
    np.testing.assert_array_equal(conformal_alpha(np.stack([np.arange(9.0), -np.arange(9.0)], 1), 0.5), [4.0, -4.0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: false_alarm_of("chebyshev", 1.0), "expected a finite number above 1"),
        (lambda: false_alarm_of("cantelli", 0.5), "expected a finite number above 1"),
        (lambda: false_alarm_of("gaussian", 0.0), "expected a finite number above 0"),
        (lambda: false_alarm_of("chebyshev", np.nan), "expected a finite number above 1"),
        (lambda: false_alarm_of("chebyshev", "2"), "alpha is '2'; expected a number"),
        (lambda: false_alarm_of("conformal", 2.0), "does not determine"),
        (lambda: false_alarm_of("markov", 2.0), "rule is 'markov'; known: chebyshev, cantelli"),
        (lambda: false_alarm_of("chebyshev", np.inf), "expected a finite number above 1"),
        (lambda: alpha_for("markov", 0.1), "rule is 'markov'; known: chebyshev, cantelli"),
        (lambda: alpha_for("bound", 0.1), "the rule 'bound' has no false alarms"),
        (lambda: alpha_for("chebyshev", 0.0), "strictly between 0 and 1"),
        (lambda: alpha_for("chebyshev", 1.0), "strictly between 0 and 1"),
        (lambda: alpha_for("gaussian", 0.1, components=0), "has 0 components"),
        (lambda: alpha_for("conformal", 0.1), "needs healthy data"),
        (lambda: conformal_alpha(np.ones(18), 0.05), "18 healthy scores .* give at least 19"),
        (lambda: conformal_alpha(np.ones(18), -1), "strictly between 0 and 1"),
    ],
)
def test_settings_without_a_bound_are_rejected(call: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
