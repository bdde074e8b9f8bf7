"""Residuals of one kind throughout, and stretches unlike the others."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter
from toy_plants import chain

from fusion_sfdia.learning.tuning.stationary import require_even, require_stationary

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
