"""A slow sensor is found while rows arrive and isolated only where it is faulty; its repeats are missing, as in a log."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia import diagnose, simulate
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.slow_sensors import KEPT, UNDECIDED, SlowSensors
from fusion_sfdia.diagnosis.watch import Sample, Watch
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.regularity import Repeat, repeated
from fusion_sfdia.study.random_plants import random_plant

Array = NDArray[np.float64]

ONE, HALF = 1, 150


@pytest.fixture(scope="module")
def tanks() -> Plant:
    return registry.plant("two-tanks")


def recorded(plant: Plant, rows: int, bias: float = 0.0, seed: int = 6) -> Log:
    """A log in which one sensor brings a new value every few rows, with a bias of so many sigma from the middle on."""
    r = simulate(plant, 2 * HALF, seeds=[seed], truth="model", process_noise=True)
    y = r.y[:, 0].copy()
    y[HALF:, ONE] += bias * plant.sensor_sigma[ONE]
    y[:, ONE] = y[np.arange(len(y)) // rows * rows, ONE]
    return Log(r.t, y, r.u_of_runs[:, 0])


def watched(watch: Watch, log: Log) -> list[Sample]:
    found = [sample for row in zip(*log, strict=True) for sample in watch.update(*row)]
    return [*found, *watch.finish()]


def isolated(samples: Iterable[Sample]) -> Array:
    return np.array([sample.decision.isolated for sample in samples])


@pytest.mark.parametrize("name", ["loo-glr", "robust-glr"])
@pytest.mark.parametrize("rows", [2, 3, 10, 20])
@pytest.mark.parametrize("bias", [0.0, 10.0])
def test_a_watch_decides_as_diagnose_does(name: str, rows: int, bias: float, tanks: Plant) -> None:
    log, said = recorded(tanks, rows, bias), []
    watch = Watch(registry.detector(name, tanks), refused=said.append)
    found = isolated(watched(watch, log))
    np.testing.assert_array_equal(found, diagnose(name, log, plant=tanks).decisions.isolated)
    assert found[:, ONE].any() == bool(bias)
    assert said == [f"{tanks.sensor_names[ONE]} repeats its value, new every {rows} rows: its repeats are taken as missing"]


@pytest.mark.parametrize("name", ["random plant 9407", "two-tanks"])
@pytest.mark.parametrize("bias", [0.0, 10.0])
def test_readings_that_a_logger_writes_again_are_no_faults(name: str, bias: float) -> None:
    plant = random_plant(9407) if name.startswith("random") else registry.plant(name)
    r = simulate(plant, 2 * HALF, seeds=[3], truth="model", process_noise=True)
    y, rng = r.y[:, 0].copy(), np.random.default_rng(8)
    y[HALF:, ONE] += bias * plant.sensor_sigma[ONE]
    new = rng.random(y.shape) > 0.5
    y = np.take_along_axis(y, np.maximum.accumulate(np.where(new, np.arange(len(y))[:, None], 0)), axis=0)
    log = Log(r.t, y, r.u_of_runs[:, 0])
    sensor = plant.sensor_names[ONE]
    found = diagnose("robust-glr", log, plant=plant)
    assert "repeats its value" in found.of_log[0]
    named = [(e.hypothesis, e.fault) for e in found.events if e.kind == "sensor"]
    assert named == ([(sensor, "bias")] if bias else [])
    said: list[str] = []
    live = isolated(watched(Watch(registry.detector("robust-glr", plant), refused=said.append), log))
    assert any("repeats its value" in line for line in said)
    assert not np.delete(live, ONE, axis=1).any()
    assert np.mean(live[HALF:, ONE]) > 0.9 if bias else not live.any()


def test_a_watch_that_is_saved_goes_on_with_the_same_bits(tanks: Plant, tmp_path: Path) -> None:
    log, said = recorded(tanks, 10, bias=10.0), []
    detector = registry.detector("loo-glr", tanks)
    whole = watched(Watch(detector, refused=said.append), log)
    first = Watch(detector, refused=said.append)
    part = watched(first, log.rows(slice(83)))
    first.save(tmp_path / "state.npz")
    again = Watch.load(tmp_path / "state.npz", detector, refused=said.append)
    rest = watched(again, log.rows(slice(83, None)))
    np.testing.assert_array_equal(isolated([*part, *rest]), isolated(whole))
    assert len([line for line in said if "repeats its value" in line]) == 2, "the second watch knows what was said"


def without_repeats(plant: Plant, column: Array) -> Array:
    """Which readings of the sensor are kept, with others that move."""
    slow, rng = SlowSensors(plant, lambda line: None), np.random.default_rng(0)
    kept = []
    for value in column:
        y = rng.standard_normal(len(plant.sensors))
        y[ONE] = value
        kept.append(slow.take(y)[ONE])
    return np.isfinite(kept)


def test_a_sensor_that_reads_anew_keeps_all_readings_and_its_freeze(tanks: Plant) -> None:
    y = np.random.default_rng(1).standard_normal(100)
    y[60:] = y[60]
    assert without_repeats(tanks, y).all()


def test_coarse_readings_are_kept_once_they_are_known(tanks: Plant) -> None:
    y = 2 * np.rint(np.random.default_rng(2).standard_normal(400) / 2)
    kept = without_repeats(tanks, y)
    assert kept[UNDECIDED:].all()


def test_a_slow_sensor_that_freezes_and_a_dead_one_are_kept(tanks: Plant) -> None:
    y = np.repeat(np.random.default_rng(3).standard_normal(60), 5)
    y[200:] = y[200]
    kept = without_repeats(tanks, y)
    np.testing.assert_array_equal(np.flatnonzero(kept[:200]), np.arange(0, 200, 5))
    assert kept[200 + 2 * 5 :].all()
    assert without_repeats(tanks, np.full(200, 4.0))[UNDECIDED:].all()


@pytest.mark.parametrize("seed", range(4))
def test_uneven_repeats_are_those_of_a_log(tanks: Plant, seed: int) -> None:
    rng = np.random.default_rng(seed)
    y = np.repeat(rng.standard_normal(100), rng.integers(6, 11, 100))
    kept = without_repeats(tanks, y)
    np.testing.assert_array_equal(kept, ~repeated(y, Repeat(8, UNDECIDED)))


def test_a_reading_that_is_written_again_at_random_is_missing_once_that_is_known(tanks: Plant) -> None:
    rng = np.random.default_rng(7)
    new = rng.random(400) > 0.4
    y = rng.standard_normal(400)[np.maximum.accumulate(np.where(new, np.arange(400), 0))]
    kept = without_repeats(tanks, y)
    np.testing.assert_array_equal(kept[50:], new[50:])


def test_memory_is_constant(tanks: Plant) -> None:
    slow = SlowSensors(tanks, lambda line: None)
    shapes = {name: a.shape for name, a in slow.arrays().items()}
    for y in np.random.default_rng(5).standard_normal((3 * KEPT, len(tanks.sensors))):
        slow.take(y)
    assert {name: a.shape for name, a in slow.arrays().items()} == shapes
    other = SlowSensors(tanks, lambda line: None)
    with pytest.raises(ValueError, match="last of slow sensors has shape"):
        other.restore(slow.arrays() | {"last": np.zeros(1)})
