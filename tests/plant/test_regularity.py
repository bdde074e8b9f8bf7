"""Repeats, resolutions and periods are found in readings that have them, and in no others."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.plant.regularity import Repeat, equal_readings, period, repeat, repeated, resolution

Array = NDArray[np.float64]


def moving(seed: int, samples: int = 240, change: float = 0.3) -> Array:
    """White noise of 1 on a walk."""
    rng = np.random.default_rng(seed)
    return np.asarray(np.cumsum(change * rng.standard_normal(samples)) + rng.standard_normal(samples))


def held(y: Array, new: NDArray[np.int64]) -> Array:
    """The readings with a new one at the positions `new` alone."""
    last = np.zeros(y.size, int)
    last[new] = new
    return y[np.maximum.accumulate(last)]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rows", [2, 3, 5, 10, 20])
def test_a_value_that_is_repeated_a_number_of_times_is_found(rows: int, seed: int) -> None:
    y = held(moving(seed), np.arange(seed % rows, 240, rows))
    found = repeat(y)
    assert found is not None
    assert found.usual == rows
    assert rows <= found.longest <= 2 * rows
    new = ~repeated(y, found)
    assert set(np.flatnonzero(new)) == {0, *range(seed % rows, 240, rows)}


@pytest.mark.parametrize(("least", "most"), [(1, 3), (2, 3), (8, 12), (5, 20)])
@pytest.mark.parametrize("seed", range(5))
def test_so_is_one_of_uneven_times(least: int, most: int, seed: int) -> None:
    new = np.cumsum(np.random.default_rng(seed).integers(least, most + 1, 400))
    new = np.append(0, new[new < 400])
    y = held(moving(seed, 400), new)
    found = repeat(y)
    assert found is not None
    assert least <= found.usual <= most
    np.testing.assert_array_equal(np.flatnonzero(~repeated(y, found)), new)


@pytest.mark.parametrize(("step", "share"), [(0.0, 0.3), (0.0, 0.5), (0.1, 0.5), (0.25, 0.5)])
def test_so_is_one_that_is_written_again_in_some_of_the_rows(step: float, share: float) -> None:
    for seed in range(10):
        new = np.flatnonzero(np.random.default_rng(seed).random(400) > share)
        y = moving(seed, 400)
        y = held(step * np.rint(y / step) if step else y, new)
        found = repeat(y)
        assert found is not None
        assert found.longest < 20
        again = np.flatnonzero(repeated(y, found))
        assert not step or np.mean(np.isin(again, new)) < 0.4  # that are equal by chance
        assert step or not np.isin(again, new[1:]).any()


def test_the_end_of_a_range_and_coarse_readings_of_what_moves_at_times_are_no_repeats() -> None:
    for seed in range(20):
        assert repeat(np.maximum(moving(seed, 600), 0.0)) is None
        rng = np.random.default_rng(seed)
        for slope in (0.1, 0.4, 0.6, 1.0, 2.3):
            assert repeat(np.rint(slope * np.arange(300) + 0.3 * rng.standard_normal(300))) is None
        busy = np.where(np.arange(600) // 40 % 2, 4.0, 0.2)
        assert repeat(np.rint(np.cumsum(busy * rng.standard_normal(600)) + 0.2 * rng.standard_normal(600))) is None


@pytest.mark.parametrize("change", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("step", [0.0, 0.1, 0.5, 1.0, 2.0, 3.0])
def test_a_sensor_that_reads_anew_in_each_row_repeats_nothing(step: float, change: float) -> None:
    for seed in range(20):
        y = moving(seed, change=change)
        assert repeat(step * np.rint(y / step) if step else y) is None


@pytest.mark.parametrize("seed", range(5))
def test_coarse_readings_are_repeats_where_new_ones_come_at_one_phase(seed: int) -> None:
    y = held(2 * np.rint(moving(seed, 600) / 2), np.arange(3, 600, 10))
    found = repeat(y)
    assert found is not None
    assert (found.usual, found.on_phase) == (10, 3)
    kept = np.flatnonzero(~repeated(y, found))
    assert set(range(3, 600, 10)) <= set(kept)
    assert all(y[k] != y[k - 1] for k in kept if k and k % 10 != 3)


def test_a_constant_and_a_frozen_reading_are_no_repeats() -> None:
    assert repeat(np.full(200, 3.0)) is None
    y = moving(0)
    y[100:] = y[100]
    assert repeat(y) is None
    assert repeat(np.full(200, np.nan)) is None


def test_what_lasts_longer_than_any_repeat_is_not_taken_for_one() -> None:
    y = held(moving(1, 400), np.arange(0, 400, 5))
    y[250:] = y[250]
    found = repeat(y)
    assert found is not None
    out = repeated(y, found)
    assert out[:250].mean() == 0.8
    assert not out[250 + found.longest :].any()


def test_missing_readings_are_passed_over() -> None:
    y = held(moving(2, 400), np.arange(0, 400, 8))
    y[np.random.default_rng(0).random(400) < 0.1] = np.nan
    found = repeat(y)
    assert found is not None
    assert found.usual in (7, 8)
    assert not repeated(y, found)[np.isnan(y)].any()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("step", [0.5, 1.0, 2.0, 3.0, 1 / 18])
def test_the_step_of_rounded_readings_is_found(step: float, seed: int) -> None:
    y = 290.0 + step * np.rint(moving(seed, 400) * min(1.0, 3 * step) / step)
    assert resolution(y) == pytest.approx(step, rel=1e-6)
    y[200:] += 7.77  # a bias is no multiple of it
    assert resolution(y) == pytest.approx(step, rel=1e-6)


def test_readings_that_are_not_rounded_have_no_step() -> None:
    for seed in range(50):
        assert resolution(moving(seed)) == 0.0
        assert resolution(held(moving(seed), np.arange(0, 240, 10))) == 0.0
    assert resolution(np.full(100, 2.0)) == 0.0
    assert resolution(np.array([1.0])) == 0.0


@pytest.mark.parametrize(("unit", "turn"), [("deg", 360.0), ("rad", 2 * np.pi), ("gon", 400.0), ("1", 65536.0)])
@pytest.mark.parametrize("begin", [0.0, -0.5])
def test_a_jump_by_a_period_is_found(unit: str, turn: float, begin: float) -> None:
    rng = np.random.default_rng(3)
    for rate in (0.003, -0.003, 0.02):
        angle = 0.8 + rate * np.arange(300) + 0.002 * rng.standard_normal(300)
        assert period(turn * (np.mod(angle - begin, 1.0) + begin), unit) == turn
    about_north = 0.01 * rng.standard_normal(300)
    assert period(turn * np.mod(about_north, 1.0), unit) == turn


def test_no_period_is_found_in_readings_that_jump_elsewhere() -> None:
    rng = np.random.default_rng(4)
    y = 180.0 + rng.standard_normal(300)
    assert period(y, "deg") is None
    spikes = y.copy()
    spikes[[50, 120]] = 0.0
    assert period(spikes, "deg") is None
    bias = np.where(np.arange(300) < 150, 350.0, 5.0) + 0.01 * rng.standard_normal(300)
    assert period(bias, "deg") is None, "a single step from 350 to 5, far larger than the changes before"
    assert period(np.where(rng.random(300) < 0.5, 0.0, 1.0), "1") is None
    assert period(np.mod(340.0 + np.arange(100.0), 360.0), "m") is None


def test_runs_of_equal_readings() -> None:
    at, starts, lengths = equal_readings(np.array([1.0, 1.0, np.nan, 1.0, 2.0, 2.0]))
    np.testing.assert_array_equal(at, [0, 1, 3, 4, 5])
    assert [(int(a), int(n)) for a, n in zip(starts, lengths, strict=True)] == [(0, 3), (3, 2)]
    assert all(a < b for a, b in pairwise(starts))
    assert Repeat(10, 15).on_phase is None
