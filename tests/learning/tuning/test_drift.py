"""A drift over a healthy log: seen in sensors and parameters, named with what else explains it, and no other log refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest
from scipy.stats import t as student

from fusion_sfdia import Plant, Sensor, Signal, linear_plant, simulate
from fusion_sfdia.learning.commissioning.commission import as_runs
from fusion_sfdia.learning.tuning.stationary import REFUSED, require_no_drift, trends
from fusion_sfdia.learning.tuning.tune import tune
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty

STEPS, SETTLE = 260, 20
NAMES = ("a", "b", "c")
PLANT = linear_plant(
    "vessel",
    np.array([[0.9]]),
    np.ones((3, 1)),
    [Sensor(name, "level", "m", sigma=0.02) for name in NAMES],
    dt=1.0,
    states=(Signal("level", "m", initial_sigma=0.1, process_sigma=0.05),),
)


def step(t: float, x: np.ndarray, u: np.ndarray, dt: float, theta: np.ndarray) -> np.ndarray:
    return PLANT.step(t, x, u, dt) + 0 * theta


def output(t: float, x: np.ndarray, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """The readings, c with a zero that is not known exactly."""
    return PLANT.output(t, x, u) + theta * np.array([0.0, 0.0, 1.0])


def leaking(t: float, x: np.ndarray, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """The readings under a leak, which each sensor shows in its place."""
    return PLANT.output(t, x, u) + theta * np.array([1.0, 0.8, 1.2])


def with_zero(sd: float, rate: float = 0.0) -> Plant:
    zero = Parameter("zero of c", "m", sd=sd, rate=rate, source="a data sheet")
    return replace(PLANT, uncertainty=Uncertainty((zero,), step=step, output=output))


def log_of(seed: int, drift: dict[str, float] | None = None, plant: Plant = PLANT, runs: int = 1) -> Log:
    """A healthy log of runs, with sensors that drift by so many sigma over all of them, one after the other."""
    recording = simulate(plant, STEPS, range(seed, seed + runs), process_noise=True)
    y = recording.y.copy()
    over = ((np.arange(runs)[:, None] + np.linspace(0, 1, STEPS)) / runs).T
    for name, size in (drift or {}).items():
        y[..., NAMES.index(name)] += size * 0.02 * over
    return as_runs(plant, (Log(recording.t, y, recording.u_of_runs),))


def judge(log: Log, plant: Plant = PLANT) -> None:
    require_no_drift(
        plant, log, SETTLE, plant.sensor_sigma, lambda k, b: f"{log.t[k]:g} s" + f" of run {b}" * (log.y.shape[1] > 1)
    )


def test_the_slope_of_a_healthy_log_is_of_students_t_whatever_noise_is_stated() -> None:
    louder = replace(PLANT, sensors=tuple(replace(s, sigma=0.06) for s in PLANT.sensors))
    of = [trends(louder, log_of(seed), SETTLE, louder.sensor_sigma) for seed in range(12)]
    slopes = np.array([(one.change / one.error)[0] for one in of])
    assert all(set(one.freedom) == {12 - 2} for one in of)
    assert kstest(slopes, student(10).cdf).pvalue > 1e-3
    assert np.all(np.abs(slopes) < student.isf(REFUSED / 2, 10))


@pytest.mark.parametrize("runs", [1, 3])
def test_a_drift_is_found_with_its_size(runs: int) -> None:
    found = trends(PLANT, log_of(3, {"b": 5.0}, runs=runs), SETTLE, PLANT.sensor_sigma)
    share = 1 - SETTLE / STEPS if runs == 1 else 1.0  # of the drift after settling
    assert abs(found.change[1] - 5.0 * share) < 4 * found.error[1] < 2.0
    assert np.argmax(found.ratio) == 1 and found.names == NAMES
    # the covariance of all readings tells the sensors apart: of three, one that drifts is two against one
    assert found.ratio[1] > 3 * found.ratio[0]


def test_a_drifting_sensor_is_named_with_size_and_cure() -> None:
    judge(log_of(5))
    judge(log_of(5, {"b": 1.0}))  # of its calibration
    cure = r"repair or recalibrate it, or leave its readings out \(NaN\)"
    with pytest.raises(
        ValueError, match=rf"sensor 'b' drifts from 21 s to 260 s, by \+0\.\d+ m \(\+[45]\.\d sigma\) .*: {cure}"
    ):
        judge(log_of(5, {"b": 5.0}))
    with pytest.raises(ValueError, match=r"sensor 'c' drifts from 21 s of run 0 to 260 s of run 2, by -0\.\d+ m"):
        judge(log_of(5, {"c": -5.0}, runs=3))


def test_readings_that_are_missing_are_no_change() -> None:
    """A sensor 2 sigma off, which is a matter of calibration, without readings in half of the log."""
    log = log_of(5)
    log.y[..., 1] += 0.04
    log.y[150:, :, 1] = np.nan
    judge(log)
    found = trends(PLANT, log, SETTLE, PLANT.sensor_sigma)
    assert 4 <= found.freedom[1] < found.freedom[0] == found.freedom[2] == 10 and abs(found.change[1]) < 4 * found.error[1]
    log.y[150:] = np.nan
    log.y[:, :, 2] = np.nan
    assert trends(PLANT, log, SETTLE, PLANT.sensor_sigma).freedom[2] == 0
    judge(log)


def test_a_parameter_that_follows_a_drift_does_not_hide_it() -> None:
    drifting = log_of(7, {"c": 6.0})
    for sd in (0.02, 1.0):
        judge(log_of(7), with_zero(sd))
        with pytest.raises(ValueError, match=r"sensor 'c' drifts .*; zero of c would explain it about as well: "):
            judge(drifting, with_zero(sd))
    hours = (STEPS - SETTLE) / 3600
    judge(drifting, with_zero(1.0, rate=0.12 / np.sqrt(hours)))  # a random walk of 6 sigma of c


def test_a_parameter_may_move_as_far_as_the_plant_declares() -> None:
    """One that no sensor alone imitates: the level in the vessel is another, by a leak."""
    drifting = log_of(7)
    over = np.linspace(0, 0.4, STEPS)[:, None, None]
    drifting = drifting._replace(y=drifting.y + over * np.array([1.0, 0.8, 1.2]))
    leak = replace(with_zero(1.0).uncertainty, output=leaking, parameters=(Parameter("leak", "m", sd=1.0),))
    judge(drifting, replace(PLANT, uncertainty=leak))
    small = replace(leak, parameters=(Parameter("leak", "m", sd=0.1),))
    with pytest.raises(
        ValueError, match=r"^leak moves from 21 s to 260 s, by \+3\.\d times its declared deviation: give a log"
    ):
        judge(drifting, replace(PLANT, uncertainty=small))


def test_a_log_too_short_for_a_slope_is_left_to_the_other_tests() -> None:
    short = Log(*(part[: SETTLE + 59] for part in log_of(5, {"b": 60.0})))
    assert not trends(PLANT, short, SETTLE, PLANT.sensor_sigma).freedom.any()
    judge(short)


@pytest.mark.slow
def test_tune_refuses_what_it_could_learn_as_a_parameter() -> None:
    plant = with_zero(0.1)
    drifting = log_of(5, {"c": 5.0})
    with pytest.raises(ValueError, match=r"sensor 'c' drifts from .* zero of c would explain it about as well"):
        tune(plant, drifting, false_alarm=0.05, detector="loo-glr")
    assert tune(plant, log_of(5), false_alarm=0.05, detector="loo-glr").quality["samples"] > 200
