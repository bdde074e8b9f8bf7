"""The errors of readings are what their names state: sizes and correlations of long draws, the same bits for the same seed."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.plants import two_tanks
from fusion_sfdia.study.errors import READING_ERRORS, autoregressive, in_steps, moving_average, with_a_late_sensor, with_jitter

LONG = 200_000
SIZES = {
    "size-0.3": 0.09,
    "size-3": 9.0,
    "variance-3": 3.0,
    "changing-size": 4.5,
    "offsets": 1.0 + 1 / 3,
    "outliers": 1.0 + 0.01 * 100.0,
}


@pytest.mark.parametrize("error", READING_ERRORS, ids=lambda e: e.name)
def test_noise_has_the_variance_that_its_name_states(error) -> None:
    e = error.noise(stream(1, error.name), (LONG // 50, 50))
    values = np.mean(e**2, axis=0)  # of 50 sensors
    # variance of the mean of squares over the sensors, measured: heavy tails and slow noise have more
    spread = np.std(values) / np.sqrt(50)
    tails = 0.2 if error.name == "student-3" else 0.0  # its fourth moment is infinite
    assert abs(np.mean(values) - SIZES.get(error.name, 1.0)) < 4 * spread + tails
    assert np.array_equal(e, error.noise(stream(1, error.name), (LONG // 50, 50)))


@pytest.mark.parametrize(("rho", "lag_1"), [((0.8,), 0.8), ((0.95,), 0.95), ((1.2, -0.4), 1.2 / 1.4)])
def test_autoregressive_noise_has_its_correlation_from_the_first_row_on(rho, lag_1) -> None:
    e = autoregressive(np.random.default_rng(2), (2, LONG), rho)
    found = np.mean(e[0] * e[1]) / np.sqrt(np.mean(e[0] ** 2) * np.mean(e[1] ** 2))
    assert abs(found - lag_1) < 4 * (1 - lag_1**2) / np.sqrt(LONG)
    assert abs(np.mean(e[0] ** 2) - 1.0) < 4 * np.sqrt(2 / LONG)


def test_moving_average_is_correlated_over_its_length_alone() -> None:
    e = moving_average(np.random.default_rng(3), (6, LONG), 5)
    near, far = np.mean(e[0] * e[1]), np.mean(e[0] * e[5])
    assert abs(near - 0.8) < 4 / np.sqrt(LONG) * np.sqrt(2)
    assert abs(far) < 4 / np.sqrt(LONG)


def test_readings_are_made_of_the_signal_as_stated() -> None:
    plant, rng = two_tanks(), np.random.default_rng(4)
    signal = np.cumsum(np.ones((40, len(plant.sensors))), axis=0)
    none = np.zeros_like(signal)
    stepped = partial(in_steps, size=3.0)(rng, plant, signal, none)
    ratio = stepped / (3.0 * plant.sensor_sigma)
    assert np.allclose(ratio, np.round(ratio), atol=1e-6)
    assert np.all(np.abs(stepped - signal) <= 1.5 * plant.sensor_sigma * (1 + 1e-9))
    late = with_a_late_sensor(rng, plant, signal, none)
    shifted = [i for i in range(signal.shape[1]) if not np.array_equal(late[:, i], signal[:, i])]
    assert len(shifted) == 1
    assert np.array_equal(late[1:, shifted[0]], signal[:-1, shifted[0]])
    jittered = with_jitter(rng, plant, signal, none)
    assert np.all(np.abs(jittered - signal) <= 0.3 + 1e-12)
    assert np.all(np.ptp(jittered - signal, axis=1) < 1e-12)  # a row is read at one time
