"""Units suspected wrong: none in healthy logs and for usual faults, all usual mix-ups of clear readings."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia import registry
from fusion_sfdia.core.log import Log
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.fault_draws import draw_apart
from fusion_sfdia.evaluation.fault_effects import apply_faults
from fusion_sfdia.evaluation.simulate import Recording, simulate
from fusion_sfdia.logs.suspects import mix_up, suspected_units

STEPS = 200


@pytest.fixture(scope="module", params=["two-tanks", "marine-engine", "power-network", "gas-pipeline"])
def run(request: pytest.FixtureRequest) -> tuple[Plant, Recording]:
    plant = registry.plant(request.param)
    return plant, simulate(plant, STEPS, [0, 1], process_noise=True)


def names(plant: Plant, recording: Recording, seed: int, y: np.ndarray) -> list[str]:
    return [f.name for f in suspected_units(plant, Log(recording.t, y, recording.u_of_runs[:, seed]))]


def test_none_in_healthy_logs_nor_for_usual_faults(run: tuple[Plant, Recording]) -> None:
    plant, recording = run
    for seed in range(2):
        y = recording.y[:, seed]
        assert names(plant, recording, seed, y) == []
        for preset in ("strong-bias", "strong-drift"):
            faults = draw_apart([(preset, None)], plant, STEPS, seed)
            faulty = apply_faults(plant, recording.t, y[:, None], faults, seed, signal=recording.signal[:, [seed]]).y[:, 0]
            assert names(plant, recording, seed, faulty) == [], preset


def test_a_factor_is_found_in_the_sensor_that_has_it(run: tuple[Plant, Recording]) -> None:
    plant, recording = run
    n = len(plant.sensors)
    for i in (0, n // 2, n - 1):
        for factor in (1e3, 10.0, 0.01, 3600.0):
            y = recording.y[:, 0].copy()
            y[:, i] *= factor
            found = names(plant, recording, 0, y)
            assert found == [plant.sensor_names[i]] or (plant.name == "power-network" and not found)  # its readings are about 0


def test_degrees_celsius_and_fahrenheit_for_kelvin() -> None:
    plant = registry.plant("gas-pipeline")
    recording = simulate(plant, 60, [0])
    i = plant.sensor_index("T_0")
    for unit, convert in (("degC", lambda v: v - 273.15), ("degF", lambda v: 1.8 * v - 459.67)):
        y = recording.y[:, 0].copy()
        y[:, i] = convert(y[:, i])
        (found,) = suspected_units(plant, Log(recording.t, y, recording.u_of_runs[:, 0]))
        assert found.name == "T_0" and f"as if in {unit}, not K" in found.text


def test_a_fault_that_begins_in_the_log_and_a_dead_sensor_are_no_mix_ups() -> None:
    plant = registry.plant("two-tanks")
    recording = simulate(plant, STEPS, [0])
    for change in (slice(100, None), slice(0, 100)):
        y = recording.y[:, 0].copy()
        y[change, 0] *= 1000.0
        assert names(plant, recording, 0, y) == []
    dead = recording.y[:, 0].copy()
    dead[:, 0] = 1e-3
    assert names(plant, recording, 0, dead) == []


def test_mix_up_by_hand() -> None:
    y = np.array([1.0, 2.0, 3.0])
    assert mix_up(1e3 * y, y, "m").factor == 1e-3  # type: ignore[union-attr]
    assert mix_up(2e3 * y, y, "m") is None  # no usual mix-up, though close to one
    gauge = mix_up(1.5 * y - 1.01325, 1.5 * y, "bar")
    assert gauge is not None and "barg" in gauge.text and gauge.offset == pytest.approx(1.01325)
    assert mix_up(1.1 * y, y, "m") is None and mix_up(2.0 * y, y, "m") is None
