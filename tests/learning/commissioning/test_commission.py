"""Commissioning on the tanks: what is declared is found, what is not is learnt, a log with a fault is refused."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.commissioning.commission import Commissioning
from fusion_sfdia.learning.commissioning.disturbances import FoundDisturbance, with_disturbance
from fusion_sfdia.learning.commissioning.refusals import require_moving
from fusion_sfdia.models.two_tanks.plant import two_tanks
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.secants import secants
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty

RATE = 0.01  # for which this log is long enough
OUTLET = Parameter("outlet", "1", 1.0, 0.05)


def declared() -> Plant:
    plant = two_tanks()
    return replace(plant, uncertainty=secants(plant, (OUTLET,), two_tanks))


def bare() -> Plant:
    return replace(two_tanks(), uncertainty=Uncertainty())


@cache
def healthy(outlet: float = 1.0, steps: int = 160) -> Log:
    """Two runs of tanks with other outlets."""
    recording = simulate(two_tanks(), steps, range(40, 42), truth=two_tanks(outlet=outlet), process_noise=True)
    return Log(recording.t, recording.y, recording.u_of_runs)


def biased(log: Log, sensor: int, size: float, since: int) -> Log:
    y = log.y.copy()
    y[since:, :, sensor] += size
    return log._replace(y=y)


@pytest.mark.slow
def test_a_declared_parameter_moves_to_its_true_value() -> None:
    found = Commissioning.of(declared(), healthy(0.95), false_alarm=RATE)
    assert found.parameters is not None
    assert abs(found.parameters.value[0] - 0.95) < 4 * found.parameters.sd[0]
    assert found.parameters.sd[0] < 0.05 * OUTLET.sd
    (parameter,) = found.plant.uncertainty.parameters
    assert (parameter.nominal, parameter.sd) == (found.parameters.value[0], found.parameters.sd[0])
    x, u = np.array([0.9, 1.1]), found.plant.input_at(0.0)
    there = two_tanks(outlet=parameter.nominal)
    np.testing.assert_array_equal(found.plant.step(0.0, x, u, 5.0), there.step(0.0, x, u, 5.0))


@pytest.mark.slow
def test_a_mismatch_of_which_nothing_is_declared_is_learnt() -> None:
    found = Commissioning.of(bare(), healthy(0.95), false_alarm=RATE)
    assert "disturbances" in found.kept
    assert found.before.nis > 5
    assert pickle.loads(pickle.dumps(found.plant)).x0.tolist() == found.plant.x0.tolist()
    assert abs(found.after.nis - 1) < 4 * np.sqrt(2 / (2 * 130 * 4))


@pytest.mark.slow
@pytest.mark.parametrize("since", [0, 110])
def test_a_log_with_a_biased_sensor_is_refused(since: int) -> None:
    log = biased(healthy(), 1, 10 * 0.01, since)
    with pytest.raises(ValueError, match="'l2' contradicts all others"):
        Commissioning.of(bare(), log, false_alarm=RATE)


@pytest.mark.slow
def test_a_log_of_the_model_itself_changes_nothing() -> None:
    recording = simulate(two_tanks(), 160, range(50, 52), truth="model", process_noise=True)
    found = Commissioning.of(declared(), recording, false_alarm=RATE)
    assert found.kept in ((), ("parameters",))
    if found.parameters is not None:
        assert abs(found.parameters.value[0] - 1.0) < 4 * found.parameters.sd[0]
    np.testing.assert_array_equal(found.plant.sensor_sigma, two_tanks().sensor_sigma)


def test_a_learnt_disturbance_is_named_after_the_sensors_it_moves_most() -> None:
    none = np.empty((0, 0))
    plant = bare()
    for state, reading in (([0.0, 1e-3], [0.0] * 4), ([0.0, 0.0], [0.0, 0.0, 1e-5, 0.0])):
        plant = with_disturbance(plant, FoundDisturbance(np.array(state), np.array(reading), none, none, 0.0, 1.0, 100.0, 1.0))
    names = [d.name for d in plant.uncertainty.disturbances]
    assert names == ["learnt disturbance 1 (l2, q2)", "learnt disturbance 2 (q12)"]


def test_a_frozen_sensor_is_refused() -> None:
    log = healthy()
    y = log.y.copy()
    y[100:120, 0, 2] = y[100, 0, 2]
    with pytest.raises(
        ValueError, match=r"'q12' shows the same reading 20 times in a row .*, until \d+ s of run 0: it is frozen"
    ):
        Commissioning.of(bare(), log._replace(y=y))


def test_equal_readings_of_a_coarse_sensor_are_frozen_only_where_they_are_four_times_as_many_as_otherwise() -> None:
    """A variable that moves slowly, between two steps and then in the middle of one, where its readings repeat."""
    plant, t = bare(), 5.0 * np.arange(1, 601)
    for seed in range(30):
        rng = np.random.default_rng(seed)
        slow = lfilter([0.08], [1.0, -0.98], rng.standard_normal(600))
        y = rng.standard_normal((600, 1, 4))
        y[:, 0, 0] = np.rint(0.5 + slow + 0.2 * y[:, 0, 0])
        require_moving(plant, Log(t, y, np.zeros((600, 1, 1))), "{} of {}".format)
        longest = int(np.diff(np.flatnonzero(np.diff(y[:, 0, 0]) != 0)).max())
        y[100 : 102 + 5 * longest, 0, 0] = y[100, 0, 0]
        with pytest.raises(ValueError, match="it is frozen"):
            require_moving(plant, Log(t, y, np.zeros((600, 1, 1))), "{} of {}".format)


def test_a_log_that_is_too_short_is_refused() -> None:
    log = Log(*(a[:80] for a in healthy()))
    with pytest.raises(ValueError, match="80 samples; expected at least 8"):
        Commissioning.of(bare(), log)
    log = Log(*(a[:120] for a in healthy()))
    with pytest.raises(ValueError, match="expected at least 1000"):
        Commissioning.of(bare(), log)


def test_a_filter_that_diverges_is_refused_with_the_time_since_the_beginning() -> None:
    log, own = healthy(), bare()
    lost = replace(own, output=lambda t, x, u: own.output(t, x, u) + (np.nan if t > 1150 else 0.0))
    with pytest.raises(ValueError, match="diverges 150 s after the beginning of one of the 2 stretches of the healthy log"):
        Commissioning.of(lost, log._replace(t=log.t + 1000.0), false_alarm=RATE)
