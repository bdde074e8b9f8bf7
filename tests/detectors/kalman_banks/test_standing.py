"""Accepted process hypotheses: what is kept of them, the noise they add, and when they are released."""

from __future__ import annotations

import numpy as np
from rounding import rounding

from fusion_sfdia.detectors.kalman_banks.standing import (
    CONFIRM,
    DECAY,
    LEAST,
    LONG_AGO,
    RELEASE,
    WALK,
    Standing,
    added_noise,
    followed,
    nothing,
    sizes,
    with_accepted,
)

ADDED, STATES = 2, 3
NONE = np.zeros(ADDED + STATES, bool)
RATES = np.array([[1.0, 0.2, 0.0], [0.0, 1.0, 0.1], [0.0, 0.0, 1.0]])
SIZE, SD = np.array([7.0, 8.0, 0.5, -0.3, 0.2]), np.array([1.0, 2.0, 0.05, 0.03, 0.02])


def which(*hypotheses: int) -> np.ndarray:
    return np.isin(np.arange(ADDED + STATES), hypotheses)


def standing(*hypotheses: int, rivals: np.ndarray = NONE) -> Standing:
    return with_accepted(nothing((), ADDED, STATES), which(*hypotheses), rivals, np.array([1.0, -2.0]), SIZE, SD)


def test_at_first_nothing_stands() -> None:
    now = nothing((2,), ADDED, STATES)
    assert now.accepted.shape == (2, 5) and not now.accepted.any() and np.all(now.since == LONG_AGO)
    assert added_noise(now, RATES, np.zeros((2, ADDED))) is None
    assert all(np.isnan(v).all() for v in sizes(now, np.ones((2, ADDED)), np.ones((2, ADDED))))


def test_an_accepted_state_keeps_its_estimate_of_before_and_an_equation_its_size() -> None:
    now = standing(1, 3)
    np.testing.assert_array_equal(now.accepted, which(1, 3))
    np.testing.assert_array_equal(now.before, [0.0, -2.0])
    np.testing.assert_array_equal(now.size, [0.0, -0.3, 0.0])
    np.testing.assert_array_equal(now.sd, [0.0, 0.03, 0.0])
    np.testing.assert_array_equal(now.left, [0.0, 1.0, 0.0])
    assert now.since == 0
    # accepted once more: the estimate of before the first change stays, the size of an equation is the new one
    later = with_accepted(
        followed(now, np.array([1.0, 9.0]), np.ones(2)), which(1, 3), NONE, np.array([5.0, 9.0]), 2 * SIZE, SD
    )
    np.testing.assert_array_equal(later.before, [0.0, -2.0])
    assert later.size[1] == -0.6 and later.left[1] == 1.0 and later.since == 0


def test_another_run_of_the_batch_is_not_changed() -> None:
    before = nothing((2,), ADDED, STATES)
    now = with_accepted(before, which(0, 4) & np.array([[True], [False]]), NONE, np.ones((2, ADDED)), SIZE, SD)
    for after, was in zip(now, before, strict=True):
        np.testing.assert_array_equal(after[1], was[1])
    assert now.accepted[0].sum() == 2


def test_noise_is_that_of_the_error_of_the_equation_and_a_share_of_the_change_of_a_state() -> None:
    """An error of size s along the column r of its rate adds s^2 r r' times what is left of it."""
    now = standing(1, 2, 3)._replace(left=np.array([0.25, 1.0, 0.0]))
    noise = added_noise(now, RATES, np.array([4.0, 3.0]))
    expected = np.zeros((5, 5))
    expected[:3, :3] = 0.25 * 0.5**2 * np.outer(RATES[:, 0], RATES[:, 0]) + 0.3**2 * np.outer(RATES[:, 1], RATES[:, 1])
    expected[4, 4] = (WALK * 5.0) ** 2
    assert noise is not None
    np.testing.assert_allclose(noise, expected, rtol=0, atol=rounding(1.0, 6))


def test_a_state_stands_while_it_differs_from_before() -> None:
    now = standing(0)  # 1 before
    variance = np.array([0.25, 1.0])
    edge = RELEASE * 0.5
    assert followed(now, np.array([1.0 + 1.01 * edge, 0.0]), variance).accepted[0]
    assert followed(now, np.array([1.0 - 1.01 * edge, 0.0]), variance).accepted[0]
    released = followed(now, np.array([1.0 + 0.99 * edge, 0.0]), variance)
    assert not released.accepted.any() and released.since == 1
    again = followed(released, np.array([9.0, 9.0]), variance)
    assert not again.accepted.any() and again.since == 2  # a difference alone accepts nothing


def test_an_error_of_an_equation_stands_until_little_of_its_noise_is_left() -> None:
    now, samples = standing(2), 0
    while now.accepted.any():
        now, samples = followed(now, np.zeros(ADDED), np.ones(ADDED)), samples + 1
        assert now.left[0] == 0.0 or abs(now.left[0] - DECAY**samples) < rounding(1.0, samples)
    assert samples == int(np.ceil(np.log(LEAST) / np.log(DECAY)))
    assert now.left[0] == 0.0 and added_noise(now, RATES, np.zeros(ADDED)) is None


def test_sizes_are_those_of_the_estimate_and_of_the_equation_when_it_was_accepted() -> None:
    now = standing(0, 3)
    size, sd = sizes(now, np.array([0.7, 0.1]), np.array([0.04, 1.0]))
    np.testing.assert_array_equal(size, [0.7, np.nan, np.nan, -0.3, np.nan])
    np.testing.assert_array_equal(sd, [0.2, np.nan, np.nan, 0.03, np.nan])


def test_a_rival_is_watched_and_accepted_once_it_differs() -> None:
    """Hypothesis 0 accepted, 1 nearly as likely: both keep their estimates of before, 1 and -2."""
    now = standing(0, rivals=which(1, 4))
    assert now.accepted.tolist() == which(0).tolist() and now.rival.tolist() == [False, True]
    np.testing.assert_array_equal(now.before, [1.0, -2.0])
    variance, far = np.array([0.25, 0.25]), 0.5 * CONFIRM
    assert followed(now, np.array([9.0, -2.0 + 0.99 * far]), variance).accepted.tolist() == which(0).tolist()
    both = followed(now, np.array([9.0, -2.0 - 1.01 * far]), variance)
    assert both.accepted.tolist() == which(0, 1).tolist()
    instead = followed(now, np.array([1.0, -2.0 + 1.01 * far]), variance)  # the first was not it
    assert instead.accepted.tolist() == which(1).tolist() and instead.rival.tolist() == [False, True]
    nothing_left = followed(now, np.array([1.0, -2.0]), variance)
    assert not nothing_left.accepted.any() and not nothing_left.rival.any()
    later = followed(nothing_left, np.array([1.0, -2.0 + 2 * far]), variance)
    assert not later.accepted.any()


def test_a_frozen_state_that_has_not_moved_does_not_stand() -> None:
    assert not followed(standing(0), np.array([1.0, -2.0]), np.zeros(ADDED)).accepted.any()  # variance 0
