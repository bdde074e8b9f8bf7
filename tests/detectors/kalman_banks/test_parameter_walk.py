"""The walk of parameters: learnt from corrections to one side, and not from white ones."""

from __future__ import annotations

import numpy as np
from rounding import rounding

from fusion_sfdia.detectors.kalman_banks.parameter_walk import FADE, Walk, followed, no_walk, noise_of

RUNS = 400


def after(corrections: np.ndarray, gained: float = 1.0) -> Walk:
    """The walk after corrections (K, B, p), each of an update that takes that variance."""
    now = no_walk(corrections.shape[1:-1], corrections.shape[-1])
    for correction in corrections:
        now = followed(now, correction, np.full(correction.shape, gained), np.ones(correction.shape[:-1], bool))
    return now


def test_a_walk_as_stated_adds_nothing_and_the_fastest_a_tenth_of_the_prior_deviation() -> None:
    sd = np.array([0.5, 20.0])
    assert noise_of(no_walk((3,), 2), sd) is None
    fastest = after(np.ones((200, 3, 2)))
    variance = noise_of(fastest, sd)
    assert variance is not None
    # 100 times a thousandth of the prior standard deviation, less what the plant states: (100^2 - 1) 1e-6 sd^2
    np.testing.assert_allclose(variance, np.broadcast_to((0.01 - 1e-6) * sd**2, (3, 2)), rtol=rounding(1.0, 1000))


def test_white_corrections_are_no_walk() -> None:
    """Their mean is beyond two standard deviations in less than a twentieth of the samples, each of which is soon forgotten."""
    rng = np.random.default_rng(0)
    now = after(rng.standard_normal((600, RUNS, 1)) * 3.0, 9.0)
    # the rate rises by 0.3 with probability .0455 and falls by 0.06 otherwise; excursions last as long as the mean's memory
    assert np.mean(now.rate == 0.0) > 0.5
    assert np.mean(now.rate) < 0.3 / FADE / 10


def test_corrections_to_one_side_are_a_walk_of_either_sign_in_any_unit() -> None:
    """Half a standard deviation on average: beside chance, whose mean has sqrt(FADE / (2 - FADE)) = 0.13 of one."""
    rng = np.random.default_rng(1)
    for unit in (1e-6, -1.0, 1e3):
        now = after(unit * (0.5 + 0.5 * rng.standard_normal((200, RUNS, 1))), unit**2)
        assert np.mean(now.rate > 2.0) > 0.95


def test_corrections_that_change_sides_are_no_walk() -> None:
    alternating = np.resize([1.0, -1.0], 200)[:, None, None] * np.ones((1, 1, 1))
    assert after(alternating).rate.item() == 0.0


def test_a_run_that_is_not_followed_keeps_its_walk() -> None:
    now = after(np.ones((20, 2, 1)))
    later = followed(now, -np.ones((2, 1)), np.ones((2, 1)), np.array([True, False]))
    assert later.corrections[0] < now.corrections[0]
    assert later.corrections[1] == now.corrections[1] and later.rate[1] == now.rate[1]
