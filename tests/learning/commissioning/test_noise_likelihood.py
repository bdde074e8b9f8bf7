"""Noise of greatest likelihood: its derivative, and the truth within standard errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom
from toy_plants import chain, readings

from fusion_sfdia.learning.commissioning.noise_likelihood import (
    LEAST,
    PRIOR,
    SHORTEST,
    _moments,
    _noise,
    in_steps,
    likeliest_noise,
    louder_sensors,
    slow_noise,
    state_groups,
    with_noise,
    with_slow_noise,
)
from fusion_sfdia.learning.innovations import fitted
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.slow_noise import SlowNoise, inflation_of

DT = 10.0


def noisy(process: float, louder: int) -> Plant:
    """The chain of which one sensor has three times, and the process `process` times, the stated standard deviation."""
    plant = chain(4, process=0.3)
    sensors = tuple(replace(s, sigma=3.0) if i == louder else s for i, s in enumerate(plant.sensors))
    return replace(plant, sensors=sensors, process_cov=plant.process_cov * process**2)


def log_of(plant: Plant, steps: int, runs: int) -> Log:
    t, _, y, u = readings(plant, steps, runs, seed=7)
    return Log(t, y, u)


def test_steps_of_readings_are_a_resolution_where_they_are_above_the_noise() -> None:
    y = log_of(chain(4, process=0.3), 300, 2).y
    y[..., 1], y[..., 2] = 2 * np.rint(y[..., 1] / 2), 0.5 * np.rint(y[..., 2] / 0.5)
    found = in_steps(chain(4), y)
    assert [s.resolution for s in found.sensors] == [0, pytest.approx(2, rel=1e-12), 0, 0]
    stated = replace(chain(4), sensors=tuple(replace(s, resolution=3.0) for s in chain(4).sensors))
    assert in_steps(stated, y).sensors == stated.sensors


def test_moments_are_the_derivative_of_the_likelihood() -> None:
    plant, log = chain(4, process=0.3), log_of(noisy(2.0, 1), 60, 2)
    use, groups = np.ones(60, bool), state_groups(plant)
    a, b = _moments(plant, log, use, groups)
    step = 1e-4
    for i in range(a.size):
        ends = []
        for sign in (-1, 1):
            factors = np.ones(a.size)
            factors[i] = np.exp(sign * step)
            ends.append(np.sum(fitted(with_noise(plant, _noise(groups, factors, factors)), log).log_likelihood))
        slope = (ends[1] - ends[0]) / (2 * step)
        # central difference: third derivatives of the likelihood are of the order of its terms, a and b
        assert slope == pytest.approx((a[i] - b[i]) / 2, abs=10 * step**2 * (a[i] + b[i]) + 1e-6)


def test_the_true_noise_is_found_within_standard_errors() -> None:
    plant = chain(4, process=0.3)
    found = likeliest_noise(plant, log_of(noisy(2.0, 1), 500, 3), np.arange(500) >= 50)
    expected = np.array([1.0, 9.0, 1.0, 1.0])
    error = np.sqrt(2 / (found.sensors_freedom + PRIOR))
    np.testing.assert_array_less(np.abs(np.log(found.sensors / expected)), 4 * error + PRIOR / found.sensors_freedom)
    error = np.sqrt(2 / (found.process_freedom + PRIOR))
    np.testing.assert_array_less(np.abs(np.log(found.process / 4.0)), 4 * error + PRIOR / found.process_freedom)


def test_process_noise_that_is_not_there_becomes_small_but_not_zero() -> None:
    found = likeliest_noise(chain(4, process=0.3), log_of(noisy(1e-3, 0), 300, 2), np.arange(300) >= 50)
    assert LEAST <= found.process[0] < 0.2


def test_a_louder_sensor_is_found_before_anything_is_learnt_and_a_fault_is_not_noise() -> None:
    plant = chain(4, process=0.3)
    log = log_of(noisy(1.0, 1), 400, 2)
    found = louder_sensors(plant, fitted(plant, log).single).sensor_sigma
    assert found[1] > 2 and found[[0, 2, 3]].tolist() == [1.0, 1.0, 1.0]
    healthy = log_of(plant, 400, 2)
    y = healthy.y.copy()
    y[150:, :, 0] += 8.0
    y[:, :, 2] += np.linspace(0, 20, 400)[:, None]
    y[:100, :, 3] += np.random.default_rng(0).normal(0, 5, (100, 2))
    faulty = louder_sensors(plant, fitted(plant, healthy._replace(y=y)).single)
    assert faulty.sensor_sigma.tolist() == [1.0] * 4


def test_many_sensors_and_few_windows_are_not_taken_for_loud() -> None:
    single = np.random.default_rng(0).standard_normal((200, 60, 4))
    for b in range(60):
        assert louder_sensors(chain(4), single[:, b : b + 1]).sensor_sigma.tolist() == [1.0] * 4


def innovations(rng: np.random.Generator, steps: int, runs: int, share: float = 0.0, samples: float = 1.0) -> Any:
    """White noise of variance 4 (steps, runs) with a slow part."""
    q = np.exp(-1 / samples)
    drive = rng.standard_normal((steps, runs))
    drive[1:] *= np.sqrt(1 - q**2)
    wandering = lfilter([1.0], [1.0, -q], drive, axis=0)
    return 2 * (np.sqrt(1 - share) * rng.standard_normal((steps, runs)) + np.sqrt(share) * wandering)


@pytest.mark.parametrize("runs", [1, 4])
def test_white_noise_shows_none(runs: int) -> None:
    """The limit is that of chi-square for one log of a thousand; with a bounded share and time constant it is hardly more."""
    rng = np.random.default_rng(1)
    found = sum(slow_noise(innovations(rng, 400, runs), DT) is not None for _ in range(300))
    assert found <= binom.ppf(0.999, 300, 5e-3)


@pytest.mark.parametrize(("share", "samples"), [(0.5, 20.0), (0.3, 40.0), (0.8, 5.0)])
def test_sums_vary_as_much_as_those_of_the_slow_noise_that_is_found(share: float, samples: float) -> None:
    """Share and time constant go together; what counts is by how much sums over 30 and 120 samples vary."""
    rng, found = np.random.default_rng(2), []
    for _ in range(40):
        one = slow_noise(innovations(rng, 800, 4, share, samples), DT)
        assert one is not None
        found.append([inflation_of(n, one.share, np.exp(-DT / one.time_constant)) for n in (30, 120)])
    true = [inflation_of(n, share, np.exp(-1 / samples)) for n in (30, 120)]
    logs = np.log(np.array(found) / true)
    assert (np.abs(logs.mean(axis=0)) < 4 * logs.std(axis=0) / np.sqrt(40) + 0.1).all()


def test_a_log_that_is_short_or_has_gaps_is_taken_as_it_is() -> None:
    rng = np.random.default_rng(3)
    assert slow_noise(innovations(rng, SHORTEST - 1, 3, 0.5, 5.0), DT) is None
    single = innovations(rng, 800, 2, 0.5, 20.0)
    single[100:140, 0] = single[:, 1] = np.nan
    assert slow_noise(single, DT) is not None
    assert slow_noise(np.full((200, 2), np.nan), DT) is None


def test_a_sensor_that_shows_none_stays_as_it_is_stated() -> None:
    rng, plant = np.random.default_rng(4), chain(3)
    stated = SlowNoise(0.4, 7.0)
    plant = replace(plant, sensors=tuple(replace(s, noise=stated if s.name == "s1" else None) for s in plant.sensors))
    single = np.stack([innovations(rng, 800, 2, share, 20.0) for share in (0.5, 0.0, 0.0)], axis=-1)
    first, second, third = (s.noise for s in with_slow_noise(plant, single).sensors)
    assert first is not None and first != stated and (second, third) == (stated, None)
