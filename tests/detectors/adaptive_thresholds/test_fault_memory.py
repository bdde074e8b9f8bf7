"""Intervals of constant offsets against a literal scalar one: a run, a sensor and a step at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.adaptive_thresholds.virtual_sensors import FaultMemory

Array = NDArray[Any]

NOMINAL, HALF_WIDTH = np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3])
BOUND = np.array([0.25, 0.5, 1.0])


def start(runs: int = 2) -> FaultMemory:
    """Two states, the first two of three variables."""
    return FaultMemory.new((runs,), NOMINAL, HALF_WIDTH, 2)


def isolating(m: FaultMemory, sensor: int) -> FaultMemory:
    return m.without(sensor, np.arange(3) == sensor, NOMINAL, HALF_WIDTH)


def test_at_first_no_sensor_is_isolated_and_states_are_within_the_envelope() -> None:
    m = start()
    assert m.x.tolist() == [[1.0, 2.0]] * 2 and m.error.tolist() == [[0.1, 0.2]] * 2 and m.state.tolist() == m.x.tolist()
    assert not m.isolated.any() and np.isnan(m.before).all() and np.isnan(m.size).all()
    assert np.all(m.low == -np.inf) and np.all(m.high == np.inf) and not m.omega.any() and not m.fault.any()
    m.x[0] = 9.0  # each array is its own
    assert m.state[0].tolist() == [1.0, 2.0] and NOMINAL.tolist() == [1.0, 2.0, 3.0]


def test_the_interval_is_the_reading_less_its_healthy_value_and_the_noise() -> None:
    """y = 12, z in [9, 10], |n| <= 1 of the third sensor: f in [12 - 10 - 1, 12 - 9 + 1] = [1, 4]."""
    m = isolating(start(1), 2)
    reading, lower, upper = np.array([[5.0, 5.0, 12.0]]), np.array([[4.0, 4.0, 9.0]]), np.array([[6.0, 6.0, 10.0]])
    low, high = m.interval(reading, lower, upper, BOUND, True)
    assert low.tolist() == [[-np.inf, -np.inf, 1.0]] and high.tolist() == [[np.inf, np.inf, 4.0]]  # nothing for other sensors


def test_intervals_are_intersected_over_time_and_empty_once_no_offset_fits() -> None:
    rng = np.random.default_rng(0)
    runs, steps, emptied = 40, 30, 0
    m = isolating(isolating(start(runs), 2), 0)
    ends = {(b, e): (-np.inf, np.inf) for b in range(runs) for e in (0, 2)}
    offset = rng.normal(0, 3, (runs, 3))
    for k in range(steps):
        z = rng.normal(0, 5, (runs, 3))
        lower, upper = z - rng.uniform(0, 1, z.shape), z + rng.uniform(0, 1, z.shape)
        # the offsets of every other run change in the middle, which no constant one explains
        moved = offset + 8.0 * (k >= 15) * (np.arange(runs) % 2)[:, None]
        reading = np.where(rng.random(z.shape) < 0.2, np.nan, z + rng.uniform(-1, 1, z.shape) * BOUND + moved)
        low, high = m.interval(reading, lower, upper, BOUND, True)
        m = m._replace(low=low, high=high)
        for (b, e), (least, most) in ends.items():
            y = reading[b, e]
            if not np.isnan(y) and not np.isnan(least):
                least, most = max(least, y - upper[b, e] - BOUND[e]), min(most, y - lower[b, e] + BOUND[e])
                ends[b, e] = (least, most) if least <= most else (np.nan, np.nan)
                emptied += not least <= most
        for (b, e), (least, most) in ends.items():
            np.testing.assert_array_equal([m.low[b, e], m.high[b, e]], [least, most])
    steady = np.arange(runs) % 2 == 0
    for e in (0, 2):
        assert np.all((m.low[steady, e] <= offset[steady, e]) & (offset[steady, e] <= m.high[steady, e]))
        assert np.all(np.isnan(m.low[~steady, e]))
    assert emptied == runs  # two sensors of half of the runs


def test_without_intersection_each_instant_stands_alone() -> None:
    m = isolating(start(1), 1)._replace(low=np.full((1, 3), 2.0), high=np.full((1, 3), 2.5))
    here = np.array([[0.0, 10.0, 0.0]]), np.array([[0.0, 9.0, 0.0]]), np.array([[0.0, 11.0, 0.0]])
    low, high = m.interval(*here, BOUND, False)
    assert (low[0, 1], high[0, 1]) == (-1.5, 1.5)  # 10 - 11 - 0.5, 10 - 9 + 0.5
    low, high = m.interval(*here, BOUND, True)
    assert np.isnan(low[0, 1]) and np.isnan(high[0, 1])  # apart from [2, 2.5]
    low, high = m.interval(np.full((1, 3), np.nan), *here[1:], BOUND, False)
    assert (low[0, 1], high[0, 1]) == (2.0, 2.5)  # no reading, nothing new


def test_the_bound_of_a_reconstructed_reading_is_the_noise_and_the_remaining_interval() -> None:
    m = isolating(isolating(start(1), 0), 1)
    m = m._replace(
        low=np.array([[1.0, -np.inf, -np.inf]]), high=np.array([[4.0, np.inf, np.inf]]), size=np.array([[2.0, np.nan, np.nan]])
    )
    healthy, bound = m.reconstructed(np.array([[10.0, 10.0, 10.0]]), BOUND)
    np.testing.assert_array_equal(healthy, [[8.0, np.nan, 10.0]])  # less 2; unknown offset: missing; not isolated: unchanged
    np.testing.assert_array_equal(bound[0, [0, 2]], [0.25 + 2.0, 1.0])  # the farther end of [1, 4] from 2


def test_an_isolated_sensor_resets_the_intervals_that_depend_on_it() -> None:
    m = isolating(start(1), 1)._replace(
        x=np.array([[7.0, 8.0]]), error=np.array([[0.5, 0.6]]), low=np.array([[-np.inf, 1.0, -np.inf]]),
        high=np.array([[np.inf, 2.0, np.inf]]), size=np.array([[np.nan, 1.5, np.nan]]),
    )  # fmt: skip
    apart = m.without(2, np.array([False, False, True]), NOMINAL, HALF_WIDTH)
    assert apart.isolated.tolist() == [[False, True, True]] and apart.x.tolist() == [[7.0, 8.0]]
    assert (apart.low[0, 1], apart.high[0, 1], apart.size[0, 1]) == (1.0, 2.0, 1.5)
    below = m.without(2, np.array([False, True, True]), NOMINAL, HALF_WIDTH)  # the second equation reads the third sensor
    assert below.isolated.tolist() == [[False, True, True]] and below.x.tolist() == [[7.0, 2.0]]
    assert below.error.tolist() == [[0.5, 0.2]] and below.low[0, 1] == -np.inf and np.isnan(below.size[0, 1])


def test_runs_are_taken_from_one_memory_or_the_other() -> None:
    one, other = isolating(start(2), 0), start(2)
    both = one.where(np.array([True, False]), other)
    assert both.isolated.tolist() == [[True, False, False], [False, False, False]]
