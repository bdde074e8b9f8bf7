"""Gaps of a log: how far a plant steps at once, the steps in between, and when it starts anew."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from toy_plants import Array, changed, tanks

from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.plant.gaps import MOST_BRIDGES, Gap, bridged, longest_step
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal


def euler(rate: float, t_start: float, x: Array, u: Array, dt: float) -> Array:
    return x - dt * rate * x


def first(t: float, x: Array, u: Array) -> Array:
    return x[..., [0, 0]]


def leak(rate: float) -> Plant:
    """An own plant with one state that decays, in Euler steps of 1 s, without a stated largest step; read twice."""
    return Plant(
        "leak",
        (Signal("level", nominal=1.0, initial_sigma=0.1, process_sigma=0.01),),
        (Sensor("a", "level", sigma=0.01), Sensor("b", "level", sigma=0.01)),
        partial(euler, rate),
        first,
        dt=1.0,
    )


def test_a_plant_without_a_stated_step_gets_one_from_its_step() -> None:
    assert longest_step(leak(0.02)) == pytest.approx(0.1 / 0.02, rel=1e-9)
    assert longest_step(leak(0.5)) == 1.0  # its own dt is always admitted
    assert longest_step(leak(0.0)) == np.inf  # an integrator: exact
    assert longest_step(changed(leak(0.02), max_dt=7.0)) == 7.0
    assert longest_step(changed(leak(0.02), fixed_dt=True)) == 1.0
    assert longest_step(tanks()) == tanks().numerics.max_dt < np.inf
    broken = replace(leak(0.02), step=lambda t, x, u, dt: x * np.nan)
    assert longest_step(broken) == 1.0


def test_an_euler_step_does_not_leap_over_a_gap() -> None:
    """In one step of 60 s the factor on the state is 1 - 0.2 * 60 = -11; in 60 steps it is 0.8^60."""
    plant = leak(0.2)
    t = np.r_[1.0:21.0, 81.0:121.0]
    noise = 0.01 * np.random.default_rng(0).standard_normal((t.size, 2))
    y = np.exp(np.log(0.8) * t)[:, None] + noise
    found = diagnose(LeaveOneOutBank(plant), t, y, np.zeros((t.size, 0)))
    assert found.events == () and not found.decisions.diverged.any()
    assert found.gaps == (Gap(20.0, 81.0, 61, False),)
    assert found.remarks == ["gap from 20 s to 81 s: predicted in 61 steps"]
    assert abs(found.decisions.estimate[20, 0]) < 0.05
    whole = np.full((120, 2), np.nan)
    whole[t.astype(int) - 1] = y
    empty = diagnose(LeaveOneOutBank(plant), np.arange(1.0, 121.0), whole, np.zeros((120, 0)))
    np.testing.assert_allclose(found.decisions.estimate, empty.decisions.estimate[t.astype(int) - 1], rtol=1e-12)
    assert empty.gaps == ()


def test_steps_lead_through_a_gap_under_interpolated_inputs() -> None:
    plant = tanks()  # 5 s
    t, y = np.array([5.0, 10.0, 30.0, 35.0]), np.arange(16.0).reshape(4, 4)
    track, gaps = bridged(plant, Log(t, y, np.array([[0.0], [1.0], [5.0], [6.0]])))
    np.testing.assert_allclose(track.t, [5, 10, 15, 20, 25, 30, 35])
    np.testing.assert_allclose(track.u[:, 0], [0, 1, 2, 3, 4, 5, 6])
    np.testing.assert_array_equal(track.y[track.own], y)
    assert np.isnan(track.y[~track.own]).all() and gaps == (Gap(10.0, 30.0, 4, False),)
    np.testing.assert_array_equal(np.isfinite(track.begins), [True, *[False] * 6])
    assert track.begins[0] == 0.0


def test_a_log_without_gaps_is_its_own_track() -> None:
    log = Log(np.arange(1.0, 5.0), np.ones((4, 2)), np.zeros((4, 0)))
    track, gaps = bridged(leak(0.02), log)
    assert (track.t is log.t, track.y is log.y, track.u is log.u, gaps) == (True, True, True, ())
    assert track.own.all() and np.flatnonzero(np.isfinite(track.begins)).tolist() == [0] and track.begins[0] == 0.0


def test_what_takes_too_many_steps_starts_anew() -> None:
    plant = tanks()
    later = 20.0 + 5.0 * (MOST_BRIDGES + 1)
    t = np.r_[5.0:25.0:5.0, later, later + 5.0]
    y, u = np.full((6, 4), np.nan), np.zeros((6, 1))
    track, gaps = bridged(plant, Log(t, y, u))
    assert gaps == (Gap(20.0, later, MOST_BRIDGES + 1, True),)
    np.testing.assert_array_equal(track.t, t)
    np.testing.assert_array_equal(track.begins, [0, np.nan, np.nan, np.nan, later - 5, np.nan])
    near = np.r_[5.0:25.0:5.0, later - 5.0]
    track, gaps = bridged(plant, Log(near, y[:5], u[:5]))
    assert not gaps[0].reset and track.t.size == 4 + MOST_BRIDGES


def test_a_diagnosis_after_a_fresh_start_is_that_of_the_rest_alone() -> None:
    plant = tanks()
    rng = np.random.default_rng(1)
    y = plant.output(0.0, plant.x0, np.array([6e-4])) + plant.sensor_sigma * rng.standard_normal((30, 4))
    u, t = np.full((30, 1), 6e-4), 5.0 * np.arange(1, 31)
    t[15:] += 1e6
    detector = LeaveOneOutBank(plant)
    with pytest.warns(UserWarning, match="no row for 1e\\+06 s before 1000080 s, 2e\\+05 steps of the model: the estimate"):
        found = diagnose(detector, t, y, u)
    rest = diagnose(detector, t[15:], y[15:], u[15:])
    np.testing.assert_array_equal(found.decisions.estimate[15:], rest.decisions.estimate)
    assert found.remarks[0].endswith("too long to predict across, the diagnosis starts anew after it")
