"""Readings that are too quiet: the false flags of healthy noise, frozen readings, missing ones, and bounded noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from fusion_sfdia.kalman_banks.quiet import PAIRS, no_pairs, paired, too_quiet

Array = NDArray[Any]
SIGMA = np.array([0.5, 3.0])


def flags(y: Array, false_alarm: float, sigma: Array = SIGMA) -> Array:
    """Whether each sensor is too quiet after each of the readings y (K, B, N)."""
    pairs = no_pairs(y.shape[1:-1], y.shape[-1])
    found = []
    for reading in y:
        pairs = paired(pairs, reading, sigma, np.zeros(len(sigma)))
        found.append(too_quiet(pairs, false_alarm))
    return np.array(found)


@pytest.mark.parametrize("moving", [0.0, 0.3], ids=["at-rest", "moving"])
def test_noise_is_too_quiet_with_at_most_its_probability(moving: float) -> None:
    """After 2 PAIRS readings once, of many sensors; a variable that moves makes it rarer."""
    runs, p = 20000, 0.02
    rng = np.random.default_rng(0)
    walk = np.cumsum(moving * rng.standard_normal((2 * PAIRS, runs, 2)), axis=0)
    y = (walk + rng.standard_normal((2 * PAIRS, runs, 2))) * SIGMA + 100.0
    found = flags(y, p)
    assert not found[:-1].any()  # not before the pairs are complete
    assert found[-1].sum() <= binom.ppf(0.9999, 2 * runs, p)
    if not moving:
        assert found[-1].sum() >= binom.ppf(0.0001, 2 * runs, p)  # and with no less at rest


def test_flags_last_while_no_pair_is_added_and_each_sample_has_the_probability() -> None:
    """One sample of many runs far from the start: the pairs slide, and each sum is of independent ones."""
    y = np.random.default_rng(1).standard_normal((5 * PAIRS, 20000, 2)) * SIGMA
    found = flags(y, 0.02)
    np.testing.assert_array_equal(found[2 * PAIRS :: 2], found[2 * PAIRS - 1 : -1 : 2])  # the first reading of a pair adds none
    for k in (2 * PAIRS + 1, 4 * PAIRS - 1):
        assert found[k].sum() <= binom.ppf(0.9999, found[k].size, 0.02)


@pytest.mark.parametrize("start", [0, 30, 31])
def test_a_frozen_reading_is_found_after_twice_the_pairs(start: int) -> None:
    """From the start after 2 PAIRS readings; later after one more at most, where it froze within a pair."""
    y = np.random.default_rng(2).standard_normal((80, 1, 2)) * SIGMA
    y[start:, :, 1] = y[start, :, 1]
    found = flags(y, 1e-6)
    first = int(np.argmax(found[:, 0, 1])) - start + 1  # constant readings until then
    assert found[:, 0, 1].any() and first <= 2 * PAIRS + (1 if start else 0)
    assert found[start + 2 * PAIRS :, 0, 1].all() and not found[:, 0, 0].any()
    moving = np.concatenate([y, y[-1] + np.random.default_rng(3).standard_normal((4, 1, 2)) * SIGMA])
    assert not flags(moving, 1e-6)[-1].any()  # a single pair of usual noise


def test_a_reading_with_too_little_noise_is_found() -> None:
    y = np.random.default_rng(4).standard_normal((2 * PAIRS, 500, 2)) * SIGMA * 0.1
    assert flags(y, 1e-4)[-1].mean() > 0.99


def test_a_missing_reading_ends_its_pair_and_changes_nothing_else() -> None:
    """The sums after gaps are those of the readings without the pairs that had one."""
    y = np.random.default_rng(5).standard_normal((40, 3, 2)) * SIGMA
    gaps = y.copy()
    gaps[6] = np.nan  # a first reading
    gaps[11] = np.nan  # a second one, after 10 began a pair (7 and 8, 9 and 10: 11 begins one)
    pairs = no_pairs((3,), 2)
    for reading in gaps:
        pairs = paired(pairs, reading, SIGMA, np.zeros_like(SIGMA))
    kept, first, squares = list(gaps), None, []
    for reading in kept:
        if first is None or np.isnan(first).any():
            first = reading
        elif np.isnan(reading).any():
            first = None
        else:
            squares.append((reading - first) ** 2 / (2 * SIGMA**2))
            first = None
    np.testing.assert_array_equal(pairs.squares, np.stack(squares[: -PAIRS - 1 : -1], axis=1))
    none = np.zeros(1)
    still = paired(paired(no_pairs((), 1), np.ones(1), np.ones(1), none), np.full(1, np.nan), np.ones(1), none)
    assert np.isinf(still.squares).all() and not too_quiet(still, 0.5).any()
    never = flags(np.full((60, 1, 2), np.nan), 0.5)
    assert not never.any()


def test_bounded_noise_is_too_quiet_little_more_often() -> None:
    """Uniform noise of the same sigma: the difference of two readings has sqrt(pi / 3) = 1.02 times the density at 0 of normal
    ones, so that PAIRS of them are too quiet (pi / 3)^(PAIRS / 2) = 1.20 times as often in the limit of a small probability.
    """
    runs, p = 40000, 0.02
    y = np.random.default_rng(6).uniform(-1, 1, (2 * PAIRS, runs, 2)) * np.sqrt(3) * SIGMA
    most = p * (np.pi / 3) ** (PAIRS / 2)
    assert flags(y, p)[-1].sum() <= binom.ppf(0.9999, 2 * runs, most)


def test_a_sensor_is_judged_in_its_own_unit_and_run() -> None:
    y = np.random.default_rng(7).standard_normal((40, 3, 2)) * SIGMA
    y[:, 1, 0] = 1.0
    found = flags(y, 1e-5)
    np.testing.assert_array_equal(found, flags(y * 1024.0, 1e-5, SIGMA * 1024.0))
    assert found[-1].tolist() == [[False, False], [True, False], [False, False]]
