"""The bank of moving horizons: false-alarm probability, weak and simultaneous faults."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom
from toy_plants import chain, readings, tanks

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.moving_horizon_bank import MovingHorizon
from fusion_sfdia.filters.estimators import Unscented

PLANT = chain(3, sensors=5)


def test_alarms_begin_at_most_at_the_stated_rate() -> None:
    plant = chain(6)
    t, _, y, u = readings(plant, 200, 40, seed=6)
    bank = MovingHorizon(plant, false_alarm=0.02)
    _, d = run(bank, bank.init((40,)), t, y, u)
    begins = np.any(d.isolated[1:] & ~d.isolated[:-1], axis=-1)
    assert 0 < begins.sum() <= binom.ppf(0.9999, len(t) * 40, 0.02)


@pytest.mark.parametrize("estimator", [None, Unscented()], ids=["extended", "unscented"])
@pytest.mark.parametrize("plant", [chain(12), tanks()], ids=["chain", "tanks"])
def test_a_weak_bias_is_detected_and_its_sensor_isolated(plant, estimator) -> None:  # type: ignore[no-untyped-def]
    t, _, y, u = readings(plant, 100, 20, seed=7)
    y = y.copy()
    y[60:, :, 1] += 3.0 * plant.sensor_sigma[1]
    bank = MovingHorizon(plant) if estimator is None else MovingHorizon(plant, estimator)
    _, d = run(bank, bank.init((20,)), t, y, u)
    assert d.isolated[74:, :, 1].mean() > 0.8  # 14 samples later, when a whole horizon contains the fault
    assert np.delete(d.isolated, 1, axis=-1).mean() < 0.01


def test_simultaneous_faults_are_isolated_at_once_up_to_max_faults_and_readmitted() -> None:
    plant = chain(12)
    t, _, y, u = readings(plant, 120, 20, seed=8)
    y = y.copy()
    y[40:70, :, [2, 7]] += 15.0
    for most in (2, 1):
        bank = MovingHorizon(plant, max_faults=most)
        _, d = run(bank, bank.init((20,)), t, y, u)
        assert np.all(d.isolated[40:70].sum(axis=-1) == most)
        assert d.capped[40].all() == (most == 1) and not d.capped[:40].any()
        if most == 2:
            assert d.isolated[40:70, :, [2, 7]].all() and d.isolated[90:, :, [2, 7]].mean() < 0.02
            assert abs(d.fault_size[60:70][..., [2, 7]].mean() - 15.0) < 1.0  # of 400 numbers of deviation 1 or 2
        np.testing.assert_array_equal(np.isnan(d.fault_size), ~d.isolated)


def test_a_horizon_needs_two_samples() -> None:
    with pytest.raises(ValueError, match="window, in samples, is 1"):
        MovingHorizon(PLANT, window=1)
