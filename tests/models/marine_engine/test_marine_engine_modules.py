"""The engine's monitoring modules: one for each measured variable, with the gains and bounds of its states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from toy_plants import changed

from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.marine_engine.equations import STATES
from fusion_sfdia.models.marine_engine.modules import GAINS, MODULES, OBSERVER_BOUNDS, alone
from fusion_sfdia.models.marine_engine.plant import SENSORS, marine_engine


def test_each_module_tests_the_variable_of_one_sensor_with_local_sensors() -> None:
    assert [m.variable for m in MODULES.values()] == list(SENSORS.values())
    for name, module in MODULES.items():
        assert set(module.sensors) <= set(SENSORS)
        assert {sensor[2] for sensor in module.sensors} == {name[2]}  # of the module's own subsystem


def test_observers_have_gains_and_bounds_and_the_plant_carries_them() -> None:
    modules = marine_engine().structure.modules
    assert modules is not None
    assert set(GAINS) == set(OBSERVER_BOUNDS) == set(STATES)
    assert (modules.gains, modules.observer_bounds) == (GAINS, OBSERVER_BOUNDS)
    assert GAINS == {"fuel": 1.16, "p_receiver": 900.0, "p_charge": 499.98}  # K24, sec. VII
    constants = {
        "fuel": (1.0, 25.0, 2.0, 20.0),
        "p_receiver": (0.05, 600.0, 900.0, 1000.0),
        "p_charge": (0.03, 500.0, 320.0, 450.0),
    }
    assert constants == OBSERVER_BOUNDS
    assert modules.names == {module.variable: name for name, module in MODULES.items()}


def test_a_module_alone_has_the_bits_it_has_among_the_others_which_know_their_envelopes() -> None:
    plant = marine_engine()
    modules = plant.structure.modules
    assert modules is not None
    readings = simulate(plant, 30, [0, 1], truth="model")
    u = np.broadcast_to(readings.u[:, None], (30, 2, 1))
    every = AdaptiveThreshold(plant)
    expected = run(every, every.init(2), readings.t, readings.y, u)[1]
    widest = every.half_width[every._variable] + [s.noise_bound for s in plant.sensors]
    for variables in (("p_charge",), ("fuel", "T_turbine")):  # of both runs, of each
        one = AdaptiveThreshold(changed(plant, modules=alone(modules, variables)))
        found = run(one, one.init(2), readings.t, readings.y, u)[1]
        for b in range(2):
            own = np.array([v == variables[b % len(variables)] for v in SENSORS.values()])
            np.testing.assert_array_equal(found.residual[:, b, own], expected.residual[:, b, own])
            np.testing.assert_array_equal(found.threshold[:, b, own], expected.threshold[:, b, own])
            np.testing.assert_allclose(found.threshold[:, b, ~own], np.broadcast_to(widest[~own], (30, 9)))
    with pytest.raises(ValueError, match="no compiled form; expected those of `engine_modules` to evaluate one of them alone"):
        alone(replace(modules, monitor=None), ["p_charge"])
