"""Readings that are too quiet: the false flags of healthy noise, frozen readings, missing ones, and bounded noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from fusion_sfdia.detectors.kalman_banks.quiet import PAIRS, SHOWN, no_pairs, paired, quietest, too_quiet

Array = NDArray[Any]
SIGMA, NONE = np.array([0.5, 3.0]), np.zeros(2)  # no resolution


def flags(y: Array, false_alarm: float, sigma: Array = SIGMA) -> Array:
    """Whether each sensor is too quiet after each of the readings y (K, B, N)."""
    pairs = no_pairs(y.shape[1:-1], y.shape[-1])
    found = []
    for reading in y:
        pairs = paired(pairs, reading, sigma, NONE, false_alarm)
        found.append(too_quiet(pairs, false_alarm))
    return np.array(found)


LONG = 2 * (2 * PAIRS + SHOWN)  # readings after which a sensor has shown enough


@pytest.mark.parametrize("moving", [0.0, 0.3], ids=["at-rest", "moving"])
@pytest.mark.parametrize("rho", [0.0, 0.8], ids=["white", "slow"])
def test_noise_is_too_quiet_with_at_most_its_probability(moving: float, rho: float) -> None:
    """In one sample of many sensors; correlated noise, whose differences are smaller, is compared with what it has shown."""
    runs, p = 20000, 0.02
    rng = np.random.default_rng(0)
    walk = np.cumsum(moving * rng.standard_normal((LONG, runs, 2)), axis=0)
    e = rng.standard_normal((LONG, runs, 2))
    for k in range(1, LONG):
        e[k] = rho * e[k - 1] + np.sqrt(1 - rho**2) * e[k]
    found = flags((walk + e) * SIGMA + 100.0, p)
    assert not found[: 2 * (PAIRS + SHOWN) - 1].any()  # not before the sensor has shown enough
    assert found[-1].sum() <= binom.ppf(0.9999, 2 * runs, p)


def test_flags_last_while_no_pair_is_added() -> None:
    y = np.random.default_rng(1).standard_normal((LONG + 2 * PAIRS, 20000, 2)) * SIGMA
    found = flags(y, 0.02)
    np.testing.assert_array_equal(found[LONG::2], found[LONG - 1 : -1 : 2])  # the first reading of a pair adds none


@pytest.mark.parametrize("start", [LONG, LONG + 1])
@pytest.mark.parametrize("rho", [0.0, 0.8], ids=["white", "slow"])
def test_a_frozen_reading_is_found_after_twice_the_pairs(start: int, rho: float) -> None:
    """After one more at most, where it froze within a pair; noise that was slow before takes no longer."""
    y = np.random.default_rng(2).standard_normal((LONG + 80, 1, 2)) * SIGMA
    for k in range(1, len(y)):
        y[k] = rho * y[k - 1] + np.sqrt(1 - rho**2) * y[k]
    y[start:, :, 1] = y[start, :, 1]
    found = flags(y, 1e-6)
    first = int(np.argmax(found[:, 0, 1])) - start + 1  # constant readings until then
    assert found[:, 0, 1].any() and first <= 2 * PAIRS + 1
    assert found[start + 2 * PAIRS : start + 4 * PAIRS, 0, 1].all() and not found[:, 0, 0].any()
    moving = np.concatenate([y, y[-1] + np.random.default_rng(3).standard_normal((4, 1, 2)) * SIGMA])
    assert not flags(moving, 1e-6)[-1].any()  # a single pair of usual noise


def test_noise_that_becomes_smaller_is_found_and_one_that_was_small_is_not() -> None:
    y = np.random.default_rng(4).standard_normal((LONG + 2 * PAIRS, 500, 2)) * SIGMA
    y[LONG:, :, 0] *= 0.1
    y[:, :, 1] *= 0.1
    found = flags(y, 1e-4)
    assert found[-1, :, 0].mean() > 0.99
    assert found[:, :, 1].mean() < 1e-2  # until its level is known


@pytest.mark.parametrize("steps", [1.0, 3.0])
def test_readings_in_steps_are_not_too_quiet(steps: float) -> None:
    """Of steps of 3 sigma most neighbours are equal."""
    q = steps * SIGMA
    y = np.round(np.random.default_rng(8).standard_normal((600, 200, 2)) * SIGMA / q) * q
    assert flags(y, 1e-4).mean() < 2e-3


def test_a_missing_reading_ends_its_pair_and_changes_nothing_else() -> None:
    """The sums after gaps are those of the readings without the pairs that had one."""
    y = np.random.default_rng(5).standard_normal((40, 3, 2)) * SIGMA
    gaps = y.copy()
    gaps[6] = np.nan  # a first reading
    gaps[11] = np.nan  # a second one, after 10 began a pair (7 and 8, 9 and 10: 11 begins one)
    pairs = no_pairs((3,), 2)
    for reading in gaps:
        pairs = paired(pairs, reading, SIGMA, NONE, 0.5)
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
    still = paired(paired(no_pairs((), 1), np.ones(1), np.ones(1), NONE, 0.5), np.full(1, np.nan), np.ones(1), NONE, 0.5)
    assert np.isinf(still.squares).all() and not too_quiet(still, 0.5).any()
    never = flags(np.full((60, 1, 2), np.nan), 0.5)
    assert not never.any()


def test_bounded_noise_is_too_quiet_with_at_most_its_probability() -> None:
    """The difference of two uniform readings has sqrt(pi / 3) = 1.02 times the density at 0 of normal ones."""
    runs, p = 20000, 0.02
    y = np.random.default_rng(6).uniform(-1, 1, (LONG, runs, 2)) * np.sqrt(3) * SIGMA
    assert flags(y, p)[-1].sum() <= binom.ppf(0.9999, 2 * runs, p)


def test_a_sensor_is_judged_in_its_own_unit_and_run() -> None:
    y = np.random.default_rng(7).standard_normal((LONG + 2 * PAIRS, 3, 2)) * SIGMA
    y[LONG:, 1, 0] = 1.0
    found = flags(y, 1e-5)
    np.testing.assert_array_equal(found, flags(y * 1024.0, 1e-5, SIGMA * 1024.0))
    assert found[-1].tolist() == [[False, False], [True, False], [False, False]]


def test_where_there_is_room_for_fewer_the_quietest_for_their_level_are_chosen() -> None:
    pairs = no_pairs((2,), 3)
    squares = np.full((2, PAIRS, 3), 0.01) * [3.0, 1.0, 2.0]
    pairs = pairs._replace(squares=squares, level=np.array([[1.0, 1.0, 1.0], [1.0, 0.1, 1.0]]))
    quiet = np.array([[True, True, True], [True, True, False]])
    found = quietest(pairs, quiet, np.array([2, 1]))
    assert found.tolist() == [[False, True, True], [True, False, False]]
    assert not quietest(pairs, quiet, np.array([0, 0])).any()
