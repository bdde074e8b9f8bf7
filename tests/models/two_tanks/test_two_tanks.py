"""The two tanks, checked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.two_tanks.plant import EQUATIONS, INFLOW, SWING_PERIOD, Tanks, tank_physics, two_tanks

EPS = np.finfo(float).eps


def test_at_rest_levels_are_equal_and_all_flows_the_inflow() -> None:
    """At rest inflow = outlet sqrt(level) twice, so that four times the level takes twice the inflow."""
    plant = registry.plant("two-tanks")
    assert plant.name == "two-tanks" and plant.sensor_names == ("l1", "l2", "q12", "q2")
    for level, inflow in ((1.0, 6e-4), (0.25, 3e-4), (2.25, 9e-4)):
        x, u = np.full(2, level), np.array([inflow])
        # a flow of 1e-3 m3/s rounds by its eps; over an area of .05 m2 and 5 s that is 0.1 eps of level
        np.testing.assert_allclose(plant.step(0.0, x, u, plant.dt), x, rtol=2 * EPS)
        np.testing.assert_allclose(plant.output(0.0, x, u), [level, level, inflow, inflow], rtol=2 * EPS)
    np.testing.assert_array_equal(plant.x0, [1.0, 1.0])
    np.testing.assert_array_equal(plant.input_at(1e6), [INFLOW])


def test_water_is_conserved() -> None:
    """What both tanks gain is what flows in less what flows out: the sum of the equations, and of the discrete step."""
    physics, c = tank_physics(), Tanks()
    assert physics.phi is not None
    rng = np.random.default_rng(0)
    x, u = rng.uniform(0.1, 2.0, (50, 2)), rng.uniform(1e-4, 1e-3, (50, 1))
    z = physics.phi(0.0, x, np.zeros((50, 2)), u, c)
    gain = c.area * np.sum(physics.f(0.0, x, z, u, c), axis=-1)
    np.testing.assert_allclose(gain, u[:, 0] - z[:, 1], rtol=0, atol=20 * EPS * 1e-3)  # flows of 1e-3 m3/s
    plant = two_tanks()
    out, start = 0.0, np.array([1.5, 0.5])
    still = start
    for _ in range(1000):  # the outflow by the trapezoidal rule, 0.1 s at a time
        ahead = plant.step(0.0, still, u[0], 0.1)
        out += 0.05 * float(plant.output(0.0, still, u[0])[3] + plant.output(0.0, ahead, u[0])[3])
        still = ahead
    # the rule errs by T h^2 / 12 |q''|, q'' < q / tau^2 with tau = 167 s sqrt(level) > 100 s: 100 * .01 / 12 * 1e-3 / 1e4
    assert c.area * float(np.sum(still - start)) == pytest.approx(100.0 * u[0, 0] - out, abs=1e-8)


def test_an_empty_inflow_drains_the_upper_tank_by_torricelli() -> None:
    """sqrt(level) falls in a straight line: level = (sqrt(level_0) - outlet t / (2 area))^2."""
    plant, c = two_tanks(), Tanks()
    x, t = np.array([1.0, 0.5]), 100.0
    for k in range(20):
        x = plant.step(5.0 * k, x, np.zeros(1), 5.0)
    # RK4 with h / tau = 5 / 167: 20 local errors of (h / tau)^5 / 120 at most
    assert x[0] == pytest.approx((1.0 - c.outlet_1 * t / (2 * c.area)) ** 2, abs=20 * (5 / 60) ** 5 / 120)


def test_the_equations_accept_intervals() -> None:
    flow = EQUATIONS["flow_12"](Interval(np.array(0.81), np.array(1.21)), Tanks())
    assert flow.lo <= 0.9 * 6e-4 and flow.hi >= 1.1 * 6e-4
    assert flow.hi - flow.lo == pytest.approx(0.2 * 6e-4, rel=1e-9)


def test_the_inflow_swings_when_asked_and_the_levels_follow_late() -> None:
    plant = two_tanks(swing=0.2)
    assert plant.input_at(SWING_PERIOD / 4)[0] == pytest.approx(1.2 * INFLOW)
    signal = simulate(plant, 480, [0]).signal[240:, 0]  # two periods after one is over
    inflow = np.array([plant.input_at(5.0 * k)[0] for k in range(240, 480)])
    upper, lower = np.ptp(signal[:, 2]) / np.ptp(inflow), np.ptp(signal[:, 3]) / np.ptp(inflow)
    # two first-order lags of tau = 167 s at omega = 2 pi / 1200: gains of 1 / sqrt(1 + (omega tau)^2) = 0.753 and its square,
    # but for the square root, whose second order is swing / 4 of it
    assert upper == pytest.approx(0.753, rel=0.05) and lower == pytest.approx(0.753**2, rel=0.05)


def test_the_truth_differs_from_the_model_by_less_than_the_noise_and_has_the_stated_steady_state() -> None:
    plant = two_tanks()
    assert plant.truth.finer is not None
    truth, to_states = plant.truth.finer()
    rested = truth.step(0.0, truth.x0, plant.input_at(0.0), plant.dt)
    np.testing.assert_allclose(rested, truth.x0, rtol=8 * EPS)
    np.testing.assert_array_equal(to_states(rested), rested)
    off = (truth.output(0.0, truth.x0, plant.input_at(0.0)) - np.array([1.0, 1.0, INFLOW, INFLOW])) / plant.sensor_sigma
    # by hand: q = 1.002 INFLOW, sqrt(level) about 1.002 / 1.001 and 1.002 / 0.999, in hundredths
    np.testing.assert_allclose(off, [0.2, 0.6, 0.2, 0.2], atol=0.01)
    assert np.all(np.abs(off) > 0.1) and np.all(np.abs(off) < 1.0)
    # Torricelli at the level of 1 m; below it friction slows the flow: solved by hand below
    friction = truth.output(0.0, np.full(2, 0.25), np.zeros(1))[2:] / (6e-4 * np.array([1.001, 0.999]))
    half = 0.02 / (2 * 0.98)
    np.testing.assert_allclose(friction, np.sqrt(half**2 + 0.25 / 0.98) - half, rtol=1e-12)
    np.testing.assert_allclose(0.98 * friction**2 + 0.02 * friction, 0.25, rtol=1e-12)


@pytest.mark.parametrize("outlet", [0.7, 1.3])
def test_an_outlet_far_off_is_refused(outlet: float) -> None:
    with pytest.raises(ValueError, match=r"outlet is .*; expected a factor .* from 0\.8 to 1\.2"):
        two_tanks(outlet=outlet)


@pytest.mark.parametrize("swing", [-0.1, 0.6, float("nan")])
def test_a_swing_that_empties_a_tank_is_refused(swing: float) -> None:
    with pytest.raises(ValueError, match=r"swing is .*; expected a share of the nominal inflow from 0 to 0\.5"):
        two_tanks(swing=swing)
