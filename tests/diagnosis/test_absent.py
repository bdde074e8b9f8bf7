"""Sensors that are silent, frozen or never move."""

from __future__ import annotations

import numpy as np
import pytest
from toy_plants import readings, tanks

from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.absent import dropouts, repeats
from fusion_sfdia.diagnosis.diagnose import DiagnosisWarning

NOISE = np.random.default_rng(0).standard_normal((200, 3))


def test_a_dropout_is_where_half_of_the_readings_due_are_missing() -> None:
    y = NOISE.copy()
    y[50:90, 0] = np.nan
    y[120:124, 0] = np.nan  # a few
    y[10:40, 2] = np.nan
    y[12:40:3, 2] = 1.0  # a third is left
    assert dropouts(y) == [[(50, 89)], [], [(10, 38)]]
    assert dropouts(NOISE) == [[], [], []]
    y[:] = NOISE
    y[np.random.default_rng(1).random(y.shape) < 0.1] = np.nan  # here and there
    assert dropouts(y) == [[], [], []]


@pytest.mark.parametrize("share", [0.2, 0.3, 0.5, 0.7])
def test_readings_that_miss_at_random_are_a_dropout_where_far_more_of_them_miss(share: float) -> None:
    rng = np.random.default_rng(2)
    y = rng.standard_normal((1000, 40))
    y[rng.random(y.shape) < share] = np.nan
    y[:, -1] = 0.0
    found = dropouts(y)
    assert sum(len(stretches) for stretches in found) == 0
    y[600:800, :2] = np.nan
    for i, stretches in enumerate(dropouts(y)):
        assert len(stretches) == (i < 2)
        assert all(580 <= a <= 620 and 780 <= b <= 820 for a, b in stretches)


def test_a_slow_sensor_and_a_gap_of_the_log_are_no_dropout() -> None:
    y = np.random.default_rng(0).standard_normal((600, 3))
    y[np.arange(600) % 10 != 0, 0] = np.nan  # read every tenth sample
    y[60:100] = np.nan  # no row
    assert dropouts(y) == [[], [], []]
    y[301:, 0] = np.nan
    assert dropouts(y)[0] == [(310, 599)]


def test_dead_sensors_are_silent_throughout() -> None:
    y = NOISE.copy()
    y[:, 1] = np.nan
    assert dropouts(y) == [[], [(0, 199)], []]
    y[:, :] = np.nan
    assert dropouts(y) == [[], [], []]  # a log without readings is no fault of sensors
    assert dropouts(NOISE[:1]) == [[], [], []]


def test_equal_readings_are_frozen_unless_the_log_holds_them() -> None:
    y = NOISE.copy()
    y[60:90, 0] = y[60, 0]
    y[70:75, 0] = np.nan  # passed over
    y[100:110, 1] = 0.0  # ten
    y[:, 2] = np.repeat(NOISE[:10, 2], 20)  # each held for 20 samples
    assert repeats(y) == [[(60, 89)], [], []]
    assert repeats(np.ones((20, 1))) == [[(0, 19)]] and repeats(np.ones((15, 1))) == [[]]
    assert repeats(np.full((20, 1), np.nan)) == [[]]


def test_how_long_a_healthy_sensor_repeats_a_reading_sets_the_limit() -> None:
    y = NOISE.copy()
    y[60:90] = 0.0
    assert repeats(y, [1, 15, 16]) == [[(60, 89)], [(60, 89)], []]
    y[60:76] = 1.0
    assert repeats(y[:80], [1, 8, 9]) == [[(60, 75)], [(60, 75)], []]


def test_a_dead_and_a_frozen_sensor_are_events() -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 60, 1, seed=0)
    y = y[:, 0].copy()
    y[:, 0] = np.nan
    y[:, 3] = 6e-4  # what it should be
    with pytest.warns(DiagnosisWarning, match="no readings of l1"):
        found = diagnose(LeaveOneOutBank(plant), t, y, u[:, 0])
    dead, frozen = found.events
    assert (dead.hypothesis, dead.fault, dead.start, dead.end, dead.open) == ("l1", "dropout", t[0], t[-1], True)
    assert (frozen.hypothesis, frozen.fault, frozen.open) == ("q2", "freeze", True) and np.isnan(frozen.size)
    assert str(dead) == "l1: 5 s to end of the log, dropout" and found.verdict == "sensors l1, q2"


@pytest.mark.parametrize("after", [0.0, 12.0], ids=["repaired", "biased"])
def test_a_freeze_ends_where_the_readings_move_again_unless_they_are_wrong(after: float) -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 120, 1, seed=0)
    y, sigma = y[:, 0].copy(), plant.sensor_sigma[2]
    y[40:70, 2] = y[40, 2] + 15 * sigma
    y[70:90, 2] += after * sigma
    found = diagnose(LeaveOneOutBank(plant, window=5, false_alarm=1e-6), t, y, u[:, 0])
    (frozen,) = found.events
    trusted = t[np.flatnonzero(found.decisions.isolated[:, 2])[-1]]
    assert (frozen.hypothesis, frozen.fault, frozen.start, frozen.open) == ("q12", "freeze", t[40], False)
    assert trusted > t[69] and frozen.end == (trusted if after else t[69])
