"""The governor: another speed, a heavier propeller, limits, and refused settings."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.marine_engine.faults import EngineFault
from fusion_sfdia.models.marine_engine.governor import Governor, governed_settings
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.plant import marine_engine

C = engine_parameters()
PLANT = marine_engine()


NOMINAL = 1000 / 60  # 1/s


def test_the_governor_holds_the_balance_and_reaches_another_speed() -> None:
    # the steady speed is the reference to 1e-12 of the equilibrium, and so is the setting
    np.testing.assert_allclose(governed_settings(lambda t: NOMINAL, 5), 1.0, atol=1e-10)
    settings = governed_settings(lambda t: NOMINAL if t < 1 else 0.9 * NOMINAL, 4000)
    recording = simulate(PLANT, 4000, [0], inputs=settings, truth="model")
    speed = np.sqrt(2 * np.pi / C.load * recording.signal[:, 0, PLANT.sensor_index("S(2){3}")])
    np.testing.assert_allclose(speed[:100], NOMINAL, rtol=1e-10)
    assert speed[-1] == pytest.approx(0.9 * NOMINAL, rel=1e-3)  # the charge air, the slowest, has e^(-0.279 39) = 2e-5 to go
    assert settings.min() >= 0.2 and settings.max() <= 1.0


def test_the_governor_counters_a_heavier_propeller() -> None:
    heavy = [EngineFault("heavy-propeller", 0.1, onset=10.0)]
    speed = 0.9 * NOMINAL
    settings = governed_settings(lambda t: speed, 5000, load=0.8, process_faults=heavy)
    engine = marine_engine(load=0.8, process_faults=heavy)
    recording = simulate(marine_engine(load=0.8), 5000, [0], inputs=settings, truth=engine)
    torque = recording.signal[:, 0, PLANT.sensor_index("S(2){3}")]
    assert np.sqrt(2 * np.pi / C.load * torque[900]) == pytest.approx(speed, rel=0.01)
    assert np.sqrt(2 * np.pi / (1.1 * C.load) * torque[-1]) == pytest.approx(speed, rel=1e-3)
    assert settings[-1] > settings[900]


def test_the_governor_does_not_wind_up_at_a_limit() -> None:
    # a reference that cannot be reached for 20 s: as soon as it decreases, the setting decreases
    settings = governed_settings(lambda t: 1.2 * NOMINAL if t < 20 else 0.9 * NOMINAL, 2010)[:, 0]
    np.testing.assert_array_equal(settings[:2000], 1.0)
    assert settings[2000] < 1.0


def test_bad_governors_and_speeds_are_named() -> None:
    with pytest.raises(ValueError, match=r"the governor's integral gain is -1\.0"):
        Governor(integral=-1.0)
    with pytest.raises(ValueError, match=r"the reference speed at 0 s is 0\.0; expected a positive number in 1/s"):
        governed_settings(lambda t: 0.0, 5)
