"""Alarms from streams: against plain loops, and which false-alarm bounds hold."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from fusion_sfdia.detectors.stochastic_thresholds.confirmation import ConfirmationCusum, Consecutive, WindowGlr, run
from fusion_sfdia.detectors.stochastic_thresholds.threshold_rules import conformal_alpha

TESTS = [Consecutive(2.0, q=3), ConfirmationCusum(5.0), WindowGlr(4.0, window=5)]


def test_against_plain_loops() -> None:
    z = np.random.default_rng(0).standard_normal((60, 3))
    rows, up, down, glr = np.zeros_like(z), np.zeros_like(z), np.zeros_like(z), np.zeros_like(z)
    for k in range(60):
        if k >= 2:
            rows[k] = np.min(np.abs(z[k - 2 : k + 1]), axis=0)
        up[k] = np.maximum((up[k - 1] if k else 0.0) + z[k] - 0.5, 0.0)
        down[k] = np.maximum((down[k - 1] if k else 0.0) - z[k] - 0.5, 0.0)
        glr[k] = np.max([np.abs(z[k - n + 1 : k + 1].sum(0)) / np.sqrt(n) for n in range(1, min(k + 1, 5) + 1)], axis=0)
    np.testing.assert_array_equal(run(TESTS[0], z), rows)
    np.testing.assert_array_equal(run(TESTS[1], z), np.maximum(up, down))
    np.testing.assert_allclose(run(TESTS[2], z), glr, rtol=1e-12)  # sums in another order


@pytest.mark.parametrize("test", TESTS, ids=lambda t: type(t).__name__)
def test_streams_are_independent_and_gaps_change_nothing(test: ConfirmationCusum) -> None:
    z = np.random.default_rng(1).standard_normal((40, 2, 4))
    together = run(test, z)
    np.testing.assert_array_equal(together[:, 1, 2], run(test, z[:, 1, 2]))
    gaps = np.insert(z, [5, 5, 20], np.nan, axis=0)
    with_gaps = run(test, gaps)
    gone = np.isnan(gaps[:, 0, 0])
    np.testing.assert_array_equal(with_gaps[~gone], together)
    assert not with_gaps[gone].any()
    state = test.start((2, 4))
    before = tuple(a.copy() for a in state)
    test.step(state, z[0])
    for a, b in zip(state, before, strict=True):
        np.testing.assert_array_equal(a, b)


def test_sums_detect_a_shift_earlier_than_three_in_a_row() -> None:
    rng, K, runs, onset = np.random.default_rng(2), 400, 300, 200
    healthy = rng.standard_normal((K, runs))
    shifted = rng.standard_normal((K, runs)) + np.where(np.arange(K) >= onset, 1.5, 0.0)[:, None]
    delay = []
    for test in TESTS:
        level = conformal_alpha(run(test, healthy)[20:].ravel(), 1e-3)
        after = run(test, shifted)[onset:] > level
        assert np.mean(np.any(after, axis=0)) > 0.99
        delay.append(np.mean(np.argmax(after, axis=0)))
    assert max(delay[1:]) < delay[0]


def test_consecutive_alarms_are_not_independent() -> None:
    """The proof of B18's Proposition 5 assumes it; with a memory they are dependent, though the bound of one alarm holds."""
    rng, alpha, lam, K = np.random.default_rng(3), 5.0, 0.3, 100_000
    p = 1 / alpha**2 / 50
    shock = rng.choice([-1.0, 0.0, 1.0], K, p=[p / 2, 1 - p, p / 2]) / np.sqrt(p)
    residual, s = np.zeros(K), np.zeros(K)
    for k in range(1, K):
        residual[k], s[k] = lam * residual[k - 1] + shock[k], lam * s[k - 1] + 1.0
    twice = run(Consecutive(alpha, q=2), residual[100:] / s[100:]) > alpha
    once = np.mean(np.abs(residual / np.maximum(s, 1.0)) > alpha)
    assert np.mean(twice) <= once <= 1 / alpha**2
    # given an alarm, the next one is more than ten times as likely as alarms are
    assert np.sum(twice) / (once * K) > 10 * once


def test_three_alarms_in_a_row_may_be_likelier_than_their_bound_at_alpha_10() -> None:
    """White shocks of three values, of which one gives three alarms: (1 - lam)^2 lam^4 / alpha^2 for (1 / alpha^2)^3."""
    alpha, lam, q, shape = 10.0, 0.3, 3, (4000, 500)
    limit = alpha / (1 - lam)
    size = limit * lam ** (1 - q) * (1 + 1e-9)
    p = size**-2.0
    shock = np.random.default_rng(0).choice([-size, 0.0, size], shape, p=[p / 2, 1 - p, p / 2])
    thrice = np.mean(run(Consecutive(limit, q=q), lfilter([1.0], [1.0, -lam], shock, axis=0)) > limit)
    assert abs(thrice - p) < 5 * np.sqrt(p / shock.size)  # a second shock so soon after is rare
    assert thrice > 20 * alpha ** (-2.0 * q)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Consecutive(2.0, q=0), "q is 0; expected a whole number of at least 1"),
        (lambda: Consecutive(0.0), "level is 0"),
        (lambda: ConfirmationCusum(1.0, drift=-0.1), "drift is -0.1"),
        (lambda: ConfirmationCusum(np.inf), "level is inf"),
        (lambda: WindowGlr(1.0, window=1.5), "window is 1.5"),
    ],
)
def test_invalid_settings_are_rejected(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_the_usual_settings_on_streams_that_are_checked_by_hand() -> None:
    """Three in a row: the least of the last three. Sums over up to eight samples: 8 / sqrt(8) at most, of ones."""
    np.testing.assert_array_equal(run(Consecutive(2.0), [4.0, -3.0, 5.0, 1.0]), [0.0, 0.0, 3.0, 1.0])
    np.testing.assert_allclose(run(WindowGlr(4.0), np.ones(10)), np.sqrt(np.minimum(np.arange(1, 11), 8)), rtol=1e-12)
    np.testing.assert_array_equal(run(ConfirmationCusum(5.0), [1.5, 0.0, -1.5]), [1.0, 0.5, 1.0])
    np.testing.assert_array_equal(run(ConfirmationCusum(5.0, drift=0.0), [1.0, 2.0]), [1.0, 3.0])
    with pytest.raises(ValueError, match="z is"):
        run(ConfirmationCusum(5.0), "one")
