"""A sensor whose readings come late is named with its lag and not isolated, and its bias is still found."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia import diagnose, simulate
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis import lag
from fusion_sfdia.diagnosis.diagnose import Diagnosis, diagnose_run
from fusion_sfdia.diagnosis.lag import (
    EVIDENCE,
    LONGEST,
    Lag,
    _about_medians,
    _flagged,
    _gain,
    earlier,
    explained_by_lag,
    latest,
)
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

HALF = 150


@pytest.fixture(scope="module")
def tanks() -> Plant:
    """Two tanks whose inflow changes by some 30 % every 20 readings."""
    plant = registry.plant("two-tanks")
    change = np.clip(np.random.default_rng(0).standard_normal(40), -2, 2)

    def operation(t: float) -> np.ndarray:  # type: ignore[type-arg]
        return plant.input_at(0.0) * (1 + 0.3 * change[int(max(t, 0.0) / (20 * plant.dt)) % change.size])

    return replace(plant, truth=replace(plant.truth, operation=operation))


def recorded(plant: Plant, i: int, rows: int, bias: float = 0.0) -> Log:
    """Readings of which those of sensor i come so many rows late, with a bias of so many sigma from the middle on."""
    r = simulate(plant, 2 * HALF, seeds=[0], truth="model", process_noise=True)
    y = r.y[:, 0].copy()
    if rows:
        y[rows:, i] = r.y[:-rows, 0, i]
    y[HALF:, i] += bias * plant.sensor_sigma[i]
    return Log(r.t, y, r.u_of_runs[:, 0])


@pytest.mark.parametrize("name", ["loo-glr", "robust-glr"])
@pytest.mark.parametrize(("sensor", "rows"), [("l1", 1), ("l1", 3), ("l1", 10), ("l2", 3), ("l2", 10)])
def test_a_late_sensor_is_named_and_not_isolated(name: str, sensor: str, rows: int, tanks: Plant) -> None:
    found = diagnose(name, recorded(tanks, tanks.sensor_index(sensor), rows), plant=tanks)
    assert found.events == ()
    (text,) = found.of_log
    assert text.startswith(f"{sensor} is late by {rows} row{'s' * (rows > 1)} ({rows * tanks.dt:g} s)")
    assert text in found.remarks


@pytest.mark.parametrize("rows", [3, 10])
def test_the_bias_of_a_late_sensor_is_found_with_its_size_and_time(rows: int, tanks: Plant) -> None:
    i = tanks.sensor_index("l1")
    found = diagnose("loo-glr", recorded(tanks, i, rows, bias=10.0), plant=tanks)
    (event,) = found.events
    assert (event.hypothesis, event.fault) == ("l1", "bias")
    assert event.size == pytest.approx(10 * tanks.sensor_sigma[i], rel=0.1)
    assert event.start == pytest.approx((HALF - rows) * tanks.dt, abs=2 * tanks.dt)
    assert f"l1 is late by {rows} rows" in found.of_log[0]


@pytest.mark.parametrize("kind", ["bias", "drift", "scale", "noise", "freeze"])
def test_a_fault_is_no_lag(kind: str, tanks: Plant) -> None:
    i = tanks.sensor_index("l1")
    log = recorded(tanks, i, 0)
    part, sigma = log.y[HALF:, i], tanks.sensor_sigma[i]
    faulty = {
        "bias": part + 10 * sigma,
        "drift": part + 20 * sigma * np.linspace(0, 1, part.size),
        "scale": part * 1.2,
        "noise": part + 8 * sigma * np.random.default_rng(1).standard_normal(part.size),
        "freeze": np.full(part.size, part[0]),
    }
    log.y[HALF:, i] = faulty[kind]
    found = diagnose("loo-glr", log, plant=tanks)
    assert "l1" in {e.hypothesis for e in found.events}
    assert found.of_log == ()


def test_healthy_readings_are_not_late(tanks: Plant) -> None:
    log = recorded(tanks, 0, 0)
    detector = registry.detector("loo-glr", tanks)
    assert latest(detector, log, diagnose_run(detector, log)) is None
    late = recorded(tanks, 0, 5)
    assert latest(detector, late, diagnose_run(detector, late)) == Lag(0, 5)
    moved = earlier(late, 0, 5)
    np.testing.assert_array_equal(moved.y[:-5, 0], log.y[:-5, 0])
    assert np.isnan(moved.y[-5:, 0]).all()


def evidence(p: Array, y: Array) -> Array:
    """Of each lag the evidence that y follows the prediction p so many rows behind, both in standard deviations."""
    z = [_about_medians(y[k:] - p[: y.size - k], np.ones(y.size - k), k) for k in range(LONGEST + 1)]
    return np.array([np.sum(_gain(z[0], late)[0]) for late in z])


def test_noise_larger_than_stated_is_no_lag() -> None:
    rng, worst, late = np.random.default_rng(0), [], []
    for _ in range(40):
        p = np.cumsum(rng.normal(scale=0.1, size=2 * HALF))  # what is predicted wanders by some standard deviations
        noise = 5 * rng.normal(size=p.size)
        worst.append(np.max(evidence(p, p + noise)))
        steps = p + 10 * (np.arange(p.size) // 20 % 2)
        late.append(int(np.argmax(evidence(steps, np.roll(steps, 2) + noise / 5))))
    assert max(worst) <= EVIDENCE  # with the likelihood itself by chance in 40 * 12 exp(-8) = 0.16 of such tests
    assert late == [2] * 40


@pytest.mark.parametrize(("left", "late"), [(0, True), (100, True), (140, False), (149, False), (150, False)])
def test_a_lag_explains_alarms_that_a_step_leaves(left: int, late: bool, tanks: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    log = recorded(tanks, 0, 0, bias=5.0)
    detector = registry.detector("loo-glr", tanks)
    found = diagnose_run(detector, log)
    assert _flagged(found) == 150

    def again(moved: Log) -> Diagnosis:
        isolated = found.decisions.isolated.copy()
        isolated[: 2 * HALF - left] = False
        return replace(found, decisions=replace(found.decisions, isolated=isolated))

    monkeypatch.setattr(lag, "latest", lambda *_: Lag(0, 1))  # as a model that is off by a part of a row may suggest
    result, shifted = explained_by_lag(detector, log, found, again)
    assert (result is not found, shifted is not log) == (late, late)
