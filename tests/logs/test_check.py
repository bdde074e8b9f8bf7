"""Units suspected wrong: none in healthy logs and for usual faults, all usual mix-ups of clear readings."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from realistic_logs import vessel
from toy_plants import tanks

from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.fault_draws import draw_apart
from fusion_sfdia.diagnosis.fault_effects import apply_faults
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.logs.check import suspected_units, unlike_healthy
from fusion_sfdia.logs.loaded_log import REMARKABLE
from fusion_sfdia.logs.mix_ups import mix_up
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal
from fusion_sfdia.plants import two_tanks

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


def test_gauge_and_absolute_pressure_are_told_apart() -> None:
    atmosphere = 101325.0
    y = np.array([3.4e5, 3.6e5, 3.8e5])
    for wrong, words, factor in (
        (y - atmosphere, "a gauge pressure, bar(g), taken for an absolute one", 1.0),
        (y + atmosphere, "an absolute pressure, bar(a), taken for a gauge one", 1.0),
        ((y - atmosphere) / 1e3 + atmosphere, "a gauge pressure, 1000 times too small", 1e3),
        ((y - atmosphere) / 1e3, "a gauge pressure, bar(g), taken for an absolute one, 1000 times too small", 1e3),
    ):
        found = mix_up(wrong, 1.03 * y, "Pa")  # of a model 3 % off
        assert found is not None and found.text.endswith(words), words
        assert found.factor == factor and found(wrong) == pytest.approx(y)
    near_it = atmosphere + np.array([0.0, 500.0, 1000.0])  # an atmosphere off is there a sensor at 0
    assert mix_up(near_it - atmosphere, near_it, "Pa") is None and mix_up(1.5 * near_it, near_it, "Pa") is None
    assert mix_up(y - 0.6 * atmosphere, y, "Pa") is None  # a bias


def test_a_bias_of_an_atmosphere_that_ends_is_no_mix_up() -> None:
    plant, y = vessel(), np.full((STEPS, 3), np.nan)
    t, u = 60.0 * np.arange(STEPS), np.tile([s.nominal for s in vessel().inputs], (STEPS, 1))
    e = plant.output(0.0, plant.x0, u[0])[1]
    y[:, 1] = e - 101325.0 + np.random.default_rng(0).normal(0.0, 1e3, STEPS)
    assert [f.name for f in suspected_units(plant, Log(t, y, u))] == ["PT101"]
    y[120:, 1] += 101325.0
    assert suspected_units(plant, Log(t, y, u)) == []


def two_tanks_at(inflow: float, stated: float, *, level: float = 1.0) -> list[str]:
    """Findings on a log of two tanks, whose inflow over its nominal value is stated as so many times more, as is a level."""
    plant = two_tanks()
    usual, x, y = np.array([s.nominal for s in plant.inputs]), plant.x0, []
    rng, t = np.random.default_rng(0), plant.dt * np.arange(1, STEPS + 1)
    for k in range(STEPS):
        x = plant.guard(plant.step(t[k] - plant.dt, x, inflow * usual, plant.dt))[0]
        y.append(plant.output(t[k], x, inflow * usual) + plant.sensor_sigma * rng.standard_normal(len(plant.sensors)))
    u = np.tile(stated * inflow * usual, (STEPS, 1))
    return [
        str(f)
        for f in suspected_units(plant, Log(t, np.array(y) * [level, 1.0, 1.0, 1.0], u))
        if f.kind == "input unit suspected"
    ]


@pytest.mark.parametrize(
    ("stated", "words"), [(1e3, "1000 times too large"), (1e-3, "1000 times too small"), (3600.0, "per hour")]
)
def test_an_input_in_another_unit_is_suspected(stated: float, words: str) -> None:
    assert "input unit suspected" in REMARKABLE
    for inflow in (0.7, 1.0):
        (found,) = two_tanks_at(inflow, stated)
        assert found.startswith("input inflow looks") and words in found and "its nominal value is" in found
    assert len(two_tanks_at(1.0, stated, level=1e3)) == 1  # with a sensor in another unit, too


def test_an_input_that_is_far_from_its_nominal_value_is_not_suspected_where_the_readings_follow_it() -> None:
    for inflow in (0.0, 1e-3, 0.012, 0.1, 3.0):
        assert two_tanks_at(inflow, 1.0) == [], inflow


@pytest.mark.parametrize("error", [KeyError("flow"), SystemExit(0), TypeError("complex"), np.linalg.LinAlgError("singular")])
@pytest.mark.parametrize("which", ["step", "output"])
def test_of_a_model_that_fails_nothing_is_suspected(which: str, error: BaseException) -> None:
    plant = tanks()
    own: Any = getattr(plant, which)

    def fails(t: float, *arguments: Any) -> Any:
        if t > 50:
            raise error
        return own(t, *arguments)

    recording = simulate(plant, STEPS, [0])
    assert names(replace(plant, **{which: fails}), recording, 0, recording.y[:, 0]) == []


def rooms(seed: int, rows: int = 400) -> Log:
    """Outdoor and room temperature (degC), a flow and a valve (%), over four days."""
    rng, t = np.random.default_rng(seed), 864.0 * np.arange(rows)
    day = np.sin(2 * np.pi * t / 86400)
    y = np.stack([8 + 4 * day, 21 + 0.3 * day, 1.6 + 0.1 * day, 30 + 10 * day], axis=1)
    return Log(t, y + rng.normal(size=y.shape) * [0.5, 0.1, 0.03, 2.0], np.zeros((rows, 0)))


@pytest.mark.parametrize(("unit", "cure"), [("1", "state the units of both logs"), ("degC", "state its unit in a map")])
def test_readings_in_another_unit_than_the_healthy_ones_are_found_without_a_model(unit: str, cure: str) -> None:
    sensors = [Signal("outdoors", unit), Signal("room", unit), Signal("flow", "1"), Signal("valve", "1")]
    healthy, log = [rooms(0), rooms(1)], rooms(2)
    assert unlike_healthy(sensors, healthy, log) == []
    log.y[:, :2] = 1.8 * log.y[:, :2] + 32
    outdoors, room = unlike_healthy(sensors, healthy, log)
    text = r"room looks as if in degF, not degC: usually (69\.\d+)BEHIND, in the healthy logs (2[01](?:\.\d+)?)BEHIND; .*"
    found = re.fullmatch(text.replace("BEHIND", "" if unit == "1" else " degC"), room.text)
    assert found is not None and float(found[1]) == pytest.approx(1.8 * float(found[2]) + 32, abs=0.1)
    assert room.text.endswith(cure)
    assert outdoors.text.startswith("outdoors looks as if in degF, not degC") and outdoors.kind == "unit suspected"


def test_another_operation_or_a_fault_is_no_mix_up_of_units_with_healthy_readings() -> None:
    sensors, healthy = [Signal(name) for name in ("outdoors", "room", "flow", "valve")], [rooms(0)]
    for column, change in ((0, -20.0), (1, 3.0), (1, 30.0), (2, 5.0), (3, 65.0)):
        log = rooms(2)
        log.y[:, column] += change
        assert unlike_healthy(sensors, healthy, log) == [], (column, change)
    for factor, texts in ((10.0, []), (1e5, ["flow looks 100000 times too large"])):
        log = rooms(2)
        log.y[:, 2] *= factor
        assert [f.text.split(":")[0] for f in unlike_healthy(sensors, healthy, log)] == texts
    log = rooms(2)
    log.y[200:, 1] = 1.8 * log.y[200:, 1] + 32  # from then on: no unit of the column
    assert unlike_healthy(sensors, healthy, log) == []
