"""Residuals of one kind throughout, and stretches unlike the others."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter
from toy_plants import chain

from fusion_sfdia.learning.tuning.stationary import require_even, require_no_spike, require_stationary
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.signals import Signal

PLANT = chain(3)


def residuals(seed: int = 0, runs: int = 2, colour: float = 0.0) -> np.ndarray:
    white = np.random.default_rng(seed).standard_normal((800, runs, 3))
    return lfilter([np.sqrt(1 - colour**2)], [1, -colour], white, axis=0)


def judge(residual: np.ndarray) -> None:
    require_even(PLANT, residual, np.empty((*residual.shape[:2], 0)), "{} s of run {}".format)


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_a_healthy_log_passes_also_with_missing_readings_and_a_wrong_scale(colour: float) -> None:
    for seed in range(5):
        residual = residuals(seed, colour=colour) * np.array([1.0, 0.3, 4.0])
        residual[100:200, 0, 1] = np.nan
        judge(residual)


def test_a_noisy_stretch_is_named() -> None:
    residual = residuals()
    residual[300:400, 1, 2] *= 4
    with pytest.raises(
        ValueError, match=r"not stationary: from 300 s of run 1 to 399 s of run 1 .* 's2'.* is 4\.\d times as large"
    ):
        judge(residual)


def test_a_quiet_stretch_is_named() -> None:
    residual = residuals()
    residual[300:400, 1, 2] *= 0.1
    with pytest.raises(ValueError, match=r"'s2'.* is 0\.1\d times as large"):
        judge(residual)


def test_a_drift_is_named() -> None:
    residual = residuals()
    residual[:, 0, 0] += np.linspace(0, 5, 800)
    with pytest.raises(ValueError, match=r"of run 0 .*'s0'.* of its standard deviations off"):
        judge(residual)


def test_a_half_that_the_other_does_not_predict_is_named() -> None:
    first, second = residuals(0), residuals(1)
    judged = partial(require_stationary, PLANT, (first, second), np.empty((800, 2, 0)), 400, "{} s of run {}".format)
    judged()
    first[400:, :, 1] *= 2.5
    where = "from 0 s of run 0 to 399 s of run 0, from 0 s of run 1 to 399 s of run 1"
    with pytest.raises(ValueError, match=rf"shows {where} does not hold .* sensor 's1', .* is 2\.\d times as large"):
        judged()


def test_a_spike_is_named() -> None:
    residual = np.random.default_rng(1).standard_normal((800, 2, 3))
    residual[[70, 90], 1, 1] = 15.0, -30.0
    with pytest.raises(ValueError, match=r"'s1' contradicts all others at 90 s of run 1, .* as does 1 more reading; leave"):
        require_no_spike(PLANT, residual, np.empty((800, 2, 0)), "{} s of run {}".format)
    residual[70, 1, 1] = 0.0
    with pytest.raises(ValueError, match=r"by \d+\.\d of its standard deviations; leave spikes out"):
        require_no_spike(PLANT, residual, np.empty((800, 2, 0)), "{} s of run {}".format)


@pytest.mark.parametrize(("shift", "convention"), [(1, "until the sample"), (-1, "at the sample")])
def test_spikes_at_steps_of_an_input_are_put_down_to_its_convention(shift: int, convention: str) -> None:
    given = {"dt": 1.0, "input_matrix": np.ones((3, 2)), "inputs": (Signal("other"), Signal("speed"))}
    plant = linear_plant(
        "driven", np.eye(3) / 2, np.eye(3), PLANT.sensors, **given, initial_cov=np.ones(3), process_cov=np.ones(3)
    )
    rng = np.random.default_rng(3)
    speed = np.repeat(rng.standard_normal((10, 2)), 80, axis=0)
    acted = np.stack([rng.standard_normal(speed.shape), np.roll(speed, shift, axis=0)], axis=-1)
    residual = rng.standard_normal((800, 2, 3))
    residual[..., 1] += 40 * (speed - acted[..., 1])
    cure = rf"1\d of 1\d rows .* a step of input 'speed', .* state inputs = \"{convention}\" in the map"
    with pytest.raises(ValueError, match=cure):
        require_no_spike(plant, residual, acted, "{} s of run {}".format)
    elsewhere = np.roll(acted, 40, axis=0)
    with pytest.raises(ValueError, match="; leave spikes out"):
        require_no_spike(plant, residual, elsewhere, "{} s of run {}".format)
