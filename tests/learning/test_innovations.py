"""Whiteness of innovations: right for the right plant, and wrong where the noise or the model is."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_sfdia import Plant, Sensor, Signal
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.innovations import whiteness
from fusion_sfdia.models.two_tanks.plant import two_tanks

STEPS = 1000


def test_the_right_plant_has_white_innovations_and_wrong_ones_have_not() -> None:
    """Four standard errors; the noise of l1 doubled in the filter, and the process noise 100 times too small."""
    plant = two_tanks()
    log = simulate(plant, STEPS, [3], truth="model", process_noise=True, start="sampled")
    readings = (log.t, log.y[:, 0], log.u)
    right = whiteness(plant, *readings)
    assert abs(right.nis - 1) <= 4 * np.sqrt(2 / (4 * STEPS))
    assert np.all(np.abs(right.variance - 1) <= 4 * np.sqrt(2 / STEPS))
    assert np.all(np.abs(right.autocorrelation) <= 4 / np.sqrt(right.pairs))
    l1 = plant.sensors[0]
    noisy = replace(plant, sensors=(replace(l1, sigma=2 * l1.noise_sigma), *plant.sensors[1:]))
    assert whiteness(noisy, *readings).variance[0] < 0.5
    quiet = whiteness(replace(plant, process_cov=plant.process_cov / 1e4), *readings)
    assert quiet.nis > 1.1 and np.max(quiet.autocorrelation * np.sqrt(quiet.pairs)) > 4


def test_pairs_are_readings_one_after_the_other() -> None:
    plant = two_tanks()
    log = simulate(plant, 40, [3], truth="model")
    y = log.y[:, 0].copy()
    y[::2, 0] = np.nan
    y[30, 1] = np.nan
    found = whiteness(plant, log.t, y, log.u, warm_up=len(y) - 20)
    assert found.pairs.tolist() == [0, 17, 19, 19] and np.isnan(found.autocorrelation[0])


def test_a_gap_is_stepped_over_as_rows_without_readings_are() -> None:
    plant = two_tanks()
    log = simulate(plant, 120, [3], truth="model")
    y, kept = log.y[:, 0].copy(), np.ones(120, bool)
    y[60:80], kept[60:80] = np.nan, False
    plant = replace(plant, numerics=replace(plant.numerics, fixed_dt=True))
    with_rows, without = whiteness(plant, log.t, y, log.u), whiteness(plant, log.t[kept], y[kept], log.u[kept])
    for one, other in zip(with_rows, without, strict=True):
        assert np.allclose(one, other, rtol=1e-9)


def test_readings_of_a_cyclic_sensor_count_on_the_turn_that_is_expected() -> None:
    """A compass near north shows 0 or 360 degrees."""
    heading = (Signal("heading", "deg", initial_sigma=1.0, process_sigma=0.1, period=360.0),)
    sensors = (Sensor("north", "heading", "deg", sigma=1.0),)
    plant = Plant("compass", heading, sensors, lambda t, x, u, dt: x, lambda t, x, u: x, dt=1.0)
    y = np.random.default_rng(0).normal(size=(200, 1))
    apart = whiteness(plant, np.arange(200.0), y, np.zeros((200, 0)))
    wrapped = whiteness(plant, np.arange(200.0), np.mod(y, 360.0), np.zeros((200, 0)))
    assert np.allclose(wrapped.variance, apart.variance) and apart.variance[0] < 2


def test_too_short_a_recording_is_refused() -> None:
    plant = two_tanks()
    log = simulate(plant, 20, [3], truth="model")
    with pytest.raises(ValueError, match="record more"):
        whiteness(plant, log.t[:20], log.y[:20, 0], log.u[:20])
