"""Delays of biases that are added to healthy readings: those of a detector whose delay is known."""

from __future__ import annotations

import numpy as np
import pytest
from toy_plants import chain, readings

from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.learning.tuning.tune import delays
from fusion_sfdia.plant.log import Log

PLANT = chain(3, process=0.3)


@pytest.mark.slow
def test_large_biases_are_found_at_once_and_the_sensor_that_is_deaf_never() -> None:
    t, _, y, u = readings(PLANT, 200, 2, seed=4)
    y[..., 2] = np.nan  # a sensor that is never read
    found = delays(LeaveOneOutBank(PLANT, false_alarm=1e-4), Log(t, y, u), 20, sizes=(3.0, 20.0))
    assert found.sizes == (3.0, 20.0) and found.within == 60.0
    np.testing.assert_array_equal(found.delay[1], [0.0, 0.0, np.inf])
    np.testing.assert_array_equal(found.detected_share[:, 2], 0.0)
    assert np.all(found.delay[0, :2] > 0) and np.all(found.detected_share[1, :2] == 1)
