"""Thresholds of predicted readings by bounds: exact on linear plants, never exceeded, and reached by the worst noise."""

from __future__ import annotations

import numpy as np
import pytest
from toy_plants import BOUND, bounded_chain, chain

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.stochastic_thresholds.bounded_readings import WITHIN, BoundedReadings
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import Chebyshev
from fusion_sfdia.detectors.stochastic_thresholds.threshold_rules import alpha_for, false_alarm_of
from fusion_sfdia.filters.estimators import Extended
from fusion_sfdia.plant.plant import Plant


def detector(plant: Plant) -> Chebyshev:
    return Chebyshev(plant, lam=0.0, rule="bound", moments=Extended(), accommodate=False)


def test_the_threshold_is_the_effect_of_the_worst_noise() -> None:
    plant = bounded_chain()
    F = plant.step_jacobian_at(0.0, plant.x0, plant.input_at(0.0), plant.dt)
    y = np.zeros((3, 6))
    _, d = run(detector(plant), detector(plant).init(), plant.dt * np.arange(1, 4), y, np.zeros((3, len(plant.inputs))))
    expected = np.abs(F) @ np.full(6, BOUND) + 0.05 + BOUND  # of readings that are each a state: |F| d + w + d
    np.testing.assert_allclose(d.threshold[1:], np.broadcast_to(expected, (2, 6)), rtol=1e-11)  # widened by 1e-12 for rounding


def test_noise_within_its_bounds_never_alarms() -> None:
    plant = bounded_chain()
    rng = np.random.default_rng(3)
    steps, runs = 400, 20
    x = plant.x0 + np.zeros((runs, 6))
    u = np.zeros((steps, runs, len(plant.inputs)))
    y = np.empty((steps, runs, 6))
    for k in range(steps):
        x = plant.step(k * plant.dt, x, u[k], plant.dt) + rng.choice([-0.05, 0.05], size=x.shape)
        y[k] = plant.output((k + 1) * plant.dt, x, u[k]) + rng.choice([-BOUND, BOUND], size=x.shape)
    y[rng.random(y.shape) < 0.2] = np.nan  # a missing reading has the bound from past readings
    one = detector(plant)
    _, d = run(one, one.init((runs,)), plant.dt * np.arange(1, steps + 1), y, u)
    assert 0.99 < d.scores.max() <= 1.0  # noise of two values meets its bounds now and then


def test_sensors_without_a_bound_have_a_bound_in_standard_deviations() -> None:
    plant = chain(6)
    one = detector(plant).diagnoser
    assert isinstance(one, BoundedReadings)
    np.testing.assert_allclose(one._noise, WITHIN * plant.sensor_sigma)


def test_the_rule_bound_takes_no_probability() -> None:
    assert false_alarm_of("bound", 1.0) == 0.0
    with pytest.raises(ValueError, match="has no false alarms; leave"):
        alpha_for("bound", 0.01)
    with pytest.raises(ValueError, match="has no false alarms; leave"):
        Chebyshev(chain(6), rule="bound", false_alarm=0.01)
