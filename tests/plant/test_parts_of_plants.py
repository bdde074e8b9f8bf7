"""A first plant of six fields, and the optional groups of a plant: what they give and what they refuse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from toy_plants import Array, tank_physics, tanks

from fusion_sfdia.detectors.detector import Detector, run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.plant.discretise import discretise
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Numerics, Plant, Structure, Truth
from fusion_sfdia.plant.signals import Sensor, Signal

FEED, DRAIN, DT = 0.1, 0.1, 1.0  # m/s, 1/s, s


def step(t: float, x: Array, u: Array, dt: float) -> Array:
    """A tank fed at a constant rate, drained in proportion to its level, which is at rest at 1 m."""
    return x + dt * (FEED - DRAIN * x)


def output(t: float, x: Array, u: Array) -> Array:
    """Level, level and outflow."""
    return np.concatenate([x, x, DRAIN * x], axis=-1)


SENSORS = (Sensor("l1", "level", "m", 0.01), Sensor("l2", "level", "m", 0.01), Sensor("q", "outflow", "m/s", 0.001))
LEVEL = Signal("level", "m", nominal=1.0, low=0.0, high=3.0, initial_sigma=0.02, process_sigma=0.001)
FIRST = Plant("tank", (LEVEL,), SENSORS, step, output, DT)


def test_the_states_give_what_is_not_given() -> None:
    np.testing.assert_array_equal(FIRST.x0, [1.0])
    np.testing.assert_array_equal(FIRST.initial_cov, [0.02**2])
    np.testing.assert_array_equal(FIRST.process_cov, [0.001**2])
    assert (FIRST.numerics, FIRST.truth, FIRST.structure) == (Numerics(), Truth(), Structure())
    given = replace(FIRST, x0=[2.0], initial_cov=[[4.0]], process_cov=[9.0])  # the plant's own values come first
    assert (given.x0.tolist(), given.initial_cov.tolist(), given.process_cov.tolist()) == ([2.0], [[4.0]], [9.0])
    assert replace(given, x0=None, initial_cov=None, process_cov=None).initial_cov.tolist() == FIRST.initial_cov.tolist()


@pytest.mark.parametrize("make", [partial(LeaveOneOutBank, window=15), CentralFilter], ids=["loo-glr", "kf-chi2"])
def test_a_plant_of_six_fields_is_diagnosed(make: Callable[[Plant], Detector]) -> None:
    """Noise of the stated sigmas; from 20 s on sensor l1 reads ten sigma too much."""
    rng = np.random.default_rng(1)
    y = output(0.0, np.ones((40, 1)), np.zeros(0)) + FIRST.sensor_sigma * rng.standard_normal((40, 3))
    detector = make(FIRST)
    t, u = np.arange(1.0, 41.0), np.zeros((40, 0))
    assert not run(detector, detector.init(), t, y, u)[1].alarm.any()
    y[19:, 0] += 10 * 0.01
    decision = run(detector, detector.init(), t, y, u)[1]
    assert np.flatnonzero(decision.alarm)[0] == 19
    if isinstance(detector, LeaveOneOutBank):
        assert decision.isolated[19].tolist() == [True, False, False]
        # one reading of the remaining ones errs by less than 0.01 m
        assert np.all(np.abs(decision.estimate[19:, 0] - 1.0) < 3 * 0.01)


def test_physics_and_matrices_take_the_values_of_their_states_too() -> None:
    physics = tank_physics()
    stated = replace(physics, states=tuple(replace(s, initial_sigma=0.1, process_sigma=0.2) for s in physics.states))
    sensors = tanks().sensors
    found = discretise(stated, sensors, dt=5.0)
    assert found.x0.tolist() == [s.nominal for s in physics.states]
    np.testing.assert_allclose([found.initial_cov, found.process_cov], [[0.01, 0.01], [0.04, 0.04]], rtol=1e-15)
    with pytest.raises(ValueError, match="no initial_sigma of the states level_1, level_2"):
        discretise(physics, sensors, dt=5.0)
    linear = linear_plant("tank", np.eye(1) * 0.9, np.ones((3, 1)), SENSORS, dt=DT, states=(LEVEL,))
    assert (linear.x0.tolist(), linear.process_cov.tolist()) == ([1.0], [0.001**2])


@pytest.mark.parametrize("what", ["initial_sigma", "process_sigma"])
def test_a_sigma_of_a_state_is_finite_and_not_negative_and_never_assumed(what: str) -> None:
    for bad in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=f"signal 'level': {what} is {bad}; it must be finite and at least 0"):
            replace(LEVEL, **{what: bad})
    assert replace(LEVEL, **{what: 0.0}) is not None
    cov = {"initial_sigma": "initial_cov", "process_sigma": "process_cov"}[what]
    with pytest.raises(ValueError, match=rf"plant 'tank': no {what} of the states level; give .*{what}=.*, or {cov} of the"):
        Plant("tank", (replace(LEVEL, **{what: None}),), SENSORS, step, output, DT)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(FIRST, truth={"finer": None}), "plant 'tank': truth is {'finer': None}; expected a Truth object"),
        (lambda: replace(FIRST, structure=Truth()), "structure is Truth.*; expected a Structure object"),
        (lambda: replace(FIRST, numerics=None), "numerics is None; expected a Numerics object"),
        (lambda: Numerics(step_jacobian=np.eye(1)), "step_jacobian is array.*; expected a function or None"),
        (lambda: Numerics(output_jacobian=np.eye(1)), "output_jacobian is array.*; expected a function or None"),
        (lambda: Numerics(max_dt=0.0), "max_dt is 0.0 s; it must be positive, inf for no limit"),
        (lambda: Truth(operation=[1.0]), "operation is .1.0.; expected a function or None"),
        (lambda: Truth(feedback=[1.0]), "feedback is .1.0.; expected a function or None"),
        (lambda: Truth(finer=FIRST), "finer is Plant.*; expected a function or None"),
        (lambda: Structure(modules={}), "modules is {}; expected Modules or None"),
        (lambda: Structure(areas=3), "areas is 3; expected Areas or None"),
        (lambda: Sensor("s", "x", sigma=1.0, scale=0.0), "sensor 's': scale is 0.0; it must be finite and not 0"),
    ],
)
def test_what_does_not_belong_to_a_group_is_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_the_scale_of_sensors_follows_their_units() -> None:
    plant = tanks()
    np.testing.assert_array_equal(plant.sensor_scale, np.ones(4))
    other = plant.in_units({"l1": ("mm", 1e3)}).in_units({"l1": ("um", -1e3), "q2": ("l/s", 1e3)})
    np.testing.assert_array_equal(other.sensor_scale, [-1e6, 1.0, 1.0, 1e3])
