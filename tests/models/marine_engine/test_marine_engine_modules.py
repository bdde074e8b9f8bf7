"""The engine's monitoring modules: one for each measured variable, with the gains and bounds of its states."""

from __future__ import annotations

from fusion_sfdia.models.marine_engine.equations import STATES
from fusion_sfdia.models.marine_engine.modules import GAINS, MODULES, OBSERVER_BOUNDS
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
    assert modules.names == {module.variable: name for name, module in MODULES.items()}
