"""A healthy sensor that is slow, coarse or cyclic is named as that and not isolated; a fault of it is still found."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from turning_car import car, turning, within_a_turn

from fusion_sfdia import diagnose, simulate
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.prepared import with_regularities
from fusion_sfdia.learning.monitor.unmodelled_logs import load, signals_of
from fusion_sfdia.logs.check import check_log, without_suspects
from fusion_sfdia.logs.csv_log import write_log
from fusion_sfdia.logs.regular_sensors import regularities
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.log_report import diagnose_log

Array = NDArray[np.float64]

ONE = 1  # the sensor that is slow or coarse
HALF = 150


@pytest.fixture(scope="module")
def tanks() -> Plant:
    return registry.plant("two-tanks")


def recorded(plant: Plant, seed: int, bias: float = 0.0) -> Log:
    """Readings with a bias of so many sigma of one sensor from the middle on."""
    r = simulate(plant, 2 * HALF, seeds=[seed], truth="model", process_noise=True)
    y = r.y[:, 0].copy()
    y[HALF:, ONE] += bias * plant.sensor_sigma[ONE]
    return Log(r.t, y, r.u_of_runs[:, 0])


def repeating(log: Log, rows: int, uneven: int = 0) -> Log:
    new = np.cumsum(np.random.default_rng(rows).integers(rows - uneven, rows + uneven + 1, log.t.size))
    last = np.zeros(log.t.size, int)
    last[new[new < log.t.size]] = new[new < log.t.size]
    y = log.y.copy()
    y[:, ONE] = y[np.maximum.accumulate(last), ONE]
    return log._replace(y=y)


def rounded(log: Log, step: float) -> Log:
    y = log.y.copy()
    y[:, ONE] = step * np.rint(y[:, ONE] / step)
    return log._replace(y=y)


@pytest.mark.parametrize("name", ["loo-glr", "robust-glr"])
@pytest.mark.parametrize(("rows", "uneven"), [(2, 0), (3, 0), (10, 0), (20, 0), (10, 2)])
def test_a_slow_sensor_is_found_and_not_isolated_and_its_bias_is(name: str, rows: int, uneven: int, tanks: Plant) -> None:
    sensor = tanks.sensors[ONE]
    healthy = diagnose(name, repeating(recorded(tanks, 6), rows, uneven), plant=tanks)
    assert [e.hypothesis for e in healthy.events] == []
    assert len(healthy.of_log) == 1
    assert f"{sensor.name} repeats its value, new every" in healthy.of_log[0]
    assert healthy.of_log[0] in healthy.remarks
    faulty = diagnose(name, repeating(recorded(tanks, 6, bias=10.0), rows, uneven), plant=tanks)
    assert {e.hypothesis for e in faulty.events} == {sensor.name}
    assert "bias" in (faulty.events[0].fault, *faulty.events[0].fault_alternatives)
    assert faulty.events[0].start == pytest.approx(HALF * tanks.dt, abs=2.5 * rows * tanks.dt)
    assert faulty.events[0].size == pytest.approx(10 * sensor.noise_sigma, rel=0.4)


@pytest.mark.parametrize("name", ["loo-glr", "robust-glr"])
@pytest.mark.parametrize("steps", [1.0, 2.0, 3.0])
def test_a_coarse_sensor_is_found_and_not_isolated_and_its_bias_is(name: str, steps: float, tanks: Plant) -> None:
    sensor = tanks.sensors[ONE]
    step = steps * sensor.noise_sigma
    healthy = diagnose(name, rounded(recorded(tanks, 6), step), plant=tanks)
    assert [e.hypothesis for e in healthy.events] == []
    assert f"{sensor.name} reads in steps of {step:.4g}" in healthy.of_log[0]
    faulty = diagnose(name, rounded(recorded(tanks, 6, bias=10.0), step), plant=tanks)
    assert {e.hypothesis for e in faulty.events} == {sensor.name}
    assert faulty.events[0].start == pytest.approx(HALF * tanks.dt, abs=3 * tanks.dt)


@pytest.mark.parametrize("name", ["loo-glr", "robust-glr"])
def test_a_coarse_sensor_that_hardly_moves_is_not_frozen(name: str, tanks: Plant) -> None:
    """Steps of three sigma and noise of a twentieth: the reading stays for most of the log."""
    log = recorded(tanks, 6)
    quiet = replace(tanks, sensors=tuple(replace(s, sigma=s.noise_sigma / 20) for s in tanks.sensors))
    step = 3 * tanks.sensors[ONE].noise_sigma
    log.y[:, ONE] = recorded(quiet, 6).y[:, ONE]
    coarse = rounded(log, step)
    assert np.mean(np.diff(coarse.y[:, ONE]) == 0) > 0.5
    stated = replace(tanks, sensors=tuple(replace(s, resolution=step * (i == ONE)) for i, s in enumerate(tanks.sensors)))
    found = diagnose(name, coarse, plant=stated)
    assert [e for e in found.events if e.hypothesis == tanks.sensors[ONE].name] == []


@pytest.mark.parametrize("name", ["loo-glr", "robust-glr"])
def test_a_slow_sensor_that_freezes_is_frozen(name: str, tanks: Plant) -> None:
    log = repeating(recorded(tanks, 6), 4)
    log.y[HALF:, ONE] = log.y[HALF, ONE]
    found = diagnose(name, log, plant=tanks)
    assert "repeats its value, new every 4 rows" in found.of_log[0]
    (event,) = [e for e in found.events if e.hypothesis == tanks.sensors[ONE].name]
    assert event.fault == "freeze"
    assert event.start == pytest.approx(HALF * tanks.dt, abs=16 * tanks.dt)
    assert event.open


def test_a_log_without_any_of_this_is_taken_as_it_is(tanks: Plant) -> None:
    log = recorded(tanks, 6)
    found = regularities(tanks, log)
    assert found.findings(tanks) == []
    assert found.without_repeats(log) is log
    assert found.of(tanks) is tanks


@pytest.mark.parametrize("model", ["turns counted", "modulo in the output"])
@pytest.mark.parametrize("name", ["loo-glr", "robust-glr"])
def test_a_period_that_the_plant_does_not_state_is_found_and_used(name: str, model: str) -> None:
    log = within_a_turn(turning(seed=5))
    found = diagnose(name, log, plant=car(model, period=None))
    assert found.events == ()
    assert len(found.of_log) == 3
    assert "compass_1 jumps by 360 deg" in found.of_log[0]
    assert "Signal(period=360) of heading" in found.of_log[0]
    log.y[100:, 0] = np.mod(log.y[100:, 0] + 10.0, 360.0)
    faulty = diagnose(name, log, plant=car(model, period=None))
    assert [e.hypothesis for e in faulty.events] == ["compass_1"]
    assert faulty.events[0].size == pytest.approx(10.0, abs=1.5)


def test_a_detector_that_is_built_already_is_given_the_period_and_the_resolution(tanks: Plant) -> None:
    step = 3 * tanks.sensors[ONE].noise_sigma
    log = rounded(recorded(tanks, 6), step)
    adapted = with_regularities(registry.detector("loo-glr", tanks), regularities(tanks, log))
    assert adapted.plant.sensors[ONE].resolution == pytest.approx(step)
    assert adapted.plant.sensor_sigma[ONE] >= np.hypot(tanks.sensor_sigma[ONE], step / np.sqrt(12))
    fitted = registry.detector("loo-glr", tanks).fit_thresholds(simulate(tanks, 400, seeds=[1, 2, 3]), 1e-2)  # type: ignore[attr-defined]
    assert with_regularities(fitted, regularities(tanks, log)) is fitted, "its thresholds were fitted to readings as they are"


def test_check_log_and_the_report_state_what_was_found(tanks: Plant, tmp_path: Path) -> None:
    log = repeating(recorded(tanks, 6), 10)
    write_log(tmp_path / "log.csv", tanks, log.t, log.y, log.u)
    read = check_log(tmp_path / "log.csv", tanks)
    (finding,) = [f for f in read.findings if f.kind == "repeat"]
    assert finding.name == tanks.sensors[ONE].name
    assert finding.count == int(np.isnan(without_suspects(tanks, read).log.y[:, ONE]).sum())
    assert "new every 10 rows" in finding.text
    with pytest.warns(UserWarning, match="repeats its value, new every 10 rows"):
        found = diagnose_log(tmp_path / "log.csv", registry.detector("loo-glr", tanks), tmp_path / "out")
    assert found.events == ()


def test_monitor_states_slow_and_cyclic_columns(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    t = np.arange(300.0)
    columns = {
        "time": t,
        "fast": rng.standard_normal(300),
        "slow": rng.standard_normal(30).repeat(10),
        "vane [deg]": np.mod(300 + t, 360),
    }
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([*columns.values()]), delimiter=",", header=",".join(columns), comments="")
    found = load(path, *signals_of(path))
    texts = {f.kind: f.text for f in found.findings if f.kind in ("repeat", "period")}
    assert texts["repeat"].startswith("slow repeats its value, new every 10 rows (10 s)")
    assert texts["period"].startswith("vane jumps by 360 deg")
    assert np.isfinite(found.log.y).all()
