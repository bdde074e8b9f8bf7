"""network/detectors: innovations of the Kalman filter, and delays."""

from __future__ import annotations

from typing import Any

import numpy as np

from fusion_sfdia.benchmarks.network.detectors import SETTLE, delays
from fusion_sfdia.benchmarks.network.support.innovations import chi_square, innovations, standardised
from fusion_sfdia.benchmarks.network.support.residuals import owners
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.simulation import run_network


def quiet(t: float) -> np.ndarray[Any, Any]:
    return np.zeros(15)


def test_innovations_are_white_with_the_computed_covariance() -> None:
    runs, steps = 20, 60
    model = network_model(unplugged=("15",))
    found = innovations(model, run_network(model, steps, range(runs), loads=quiet))
    mine = owners(model) == 3
    assert found.sensors.size == 92  # area 15 and its only neighbour no longer read each other's angles
    per_run = chi_square(found, mine)[SETTLE:].mean(axis=0)
    margin = 4.5 * per_run.std(ddof=1) / np.sqrt(runs)  # standard errors
    assert abs(per_run.mean() - mine.sum()) < margin
    z = standardised(found, mine)[SETTLE:]
    lag = np.mean(z[1:] * z[:-1])
    # z_k z_(k-1) of white z has variance 1, sensors correlated at worst wholly
    assert abs(lag) < 4.5 / np.sqrt(runs * (steps - SETTLE))


def test_a_delay_counts_from_the_onset_to_the_first_alarm_after_it() -> None:
    statistic = np.zeros((20, 3))
    onset = SETTLE + 5.0
    statistic[5, 0] = statistic[2, 1] = 9.0  # the reading at the onset is not yet changed
    statistic[6, 0] = statistic[9, 1] = 9.0
    delay, seen = delays(statistic, 1.0, onset)
    assert delay.tolist() == [1.0, 4.0, 14.0] and seen.tolist() == [True, True, False]
