"""The frozen model on plants with a wrong law, and on the tanks: slow drifts, process faults, and what follows them."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from toy_plants import tanks
from wrong_laws import DAY, DT, PLANTS, WrongLaw, drift, exchanger_pair, tank_cascade

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.saved_detectors import load_detector, save_detector
from fusion_sfdia.detectors.verdicts import Verdict
from fusion_sfdia.diagnosis.diagnose import diagnose_run
from fusion_sfdia.diagnosis.events import events_of
from fusion_sfdia.diagnosis.prepared import prepared
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.learning.commissioning.parameters import at, declared
from fusion_sfdia.learning.frozen_model.frozen_bank import LONGEST, NO_SINGLE_CAUSE, OUTSIDE, Found, FrozenBank
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.signals import Sensor

Array = NDArray[Any]

PLANT = tanks()
ONSET, ROWS = 400, 300


@cache
def on_tanks() -> FrozenBank:
    found = simulate(PLANT, 1500, [1], process_noise=True)
    return FrozenBank.fit(PLANT, Log(found.t, found.y[:, 0], found.u), 1e-3)


@cache
def of(make: Any, days: float = 3.0) -> tuple[WrongLaw, FrozenBank]:
    law = make()
    return law, FrozenBank.fit(law.plant(), law.record(days, 21, building=11), 1 / DAY)


def decisions(detector: FrozenBank, log: Log) -> Decision:
    return run(detector, detector.init((), float(log.t[0]) - detector.plant.dt), log)[1]


def with_bias(size: float, sensor: int, first: int, last: int, slope: bool = False) -> Log:
    found = simulate(PLANT, 900, [5], process_noise=True)
    y = found.y[:, 0].copy()
    grown = np.linspace(0, 1, last - first) if slope else np.ones(last - first)
    y[first:last, sensor] += size * PLANT.sensor_sigma[sensor] * grown
    return Log(found.t, y, found.u)


@pytest.mark.long
def test_healthy_tanks_are_silent() -> None:
    d = decisions(on_tanks(), with_bias(0.0, 0, ONSET, ONSET + 1))
    assert not d.isolated.any() and d.process is not None and not d.process.any()


def test_a_slow_drift_is_named_and_nothing_follows_its_end() -> None:
    d = decisions(on_tanks(), with_bias(12.0, 2, ONSET, ONSET + ROWS, slope=True))
    during, after = d.isolated[ONSET : ONSET + ROWS], d.isolated[ONSET + ROWS + 30 :]
    assert np.mean(during[:, 2]) > 0.4 and not np.delete(during, 2, axis=1).any()
    assert np.mean(after.any(axis=1)) < 0.02
    assert np.nanmax(d.fault_size[:, 2]) == pytest.approx(12 * PLANT.sensor_sigma[2], rel=0.35)


def test_a_level_sensor_and_its_outlet_are_one_of_two() -> None:
    """The flow is the outlet's coefficient times the root of the level: the two look alike in every slow change."""
    d = decisions(on_tanks(), with_bias(12.0, 0, ONSET, ONSET + ROWS, slope=True))
    assert d.suspect is not None
    names = (*PLANT.sensor_names, *(h.name for h in on_tanks().process_hypotheses))
    seen = {tuple(np.array(names)[row]) for row in d.suspect[ONSET : ONSET + ROWS] if row.any()}
    assert seen and all(PLANT.sensor_names[0] in one for one in seen)
    assert not np.delete(d.isolated, 0, axis=1).any()


def test_a_frozen_sensor_is_named() -> None:
    log = with_bias(0.0, 0, ONSET, ONSET + 1)
    y = log.y.copy()
    y[ONSET : ONSET + 60, 1] = y[ONSET, 1]
    d = decisions(on_tanks(), log._replace(y=y))
    assert np.mean(d.isolated[ONSET + 6 : ONSET + 60, 1]) > 0.95 and not np.delete(d.isolated, 1, axis=1).any()


def test_saved_and_loaded_it_decides_the_same(tmp_path: Path) -> None:
    save_detector(tmp_path / "frozen.npz", on_tanks())
    other = load_detector(tmp_path / "frozen.npz", PLANT)
    log = with_bias(10.0, 2, ONSET, ONSET + 100)
    one, two = decisions(on_tanks(), log), decisions(other, log)
    np.testing.assert_array_equal(one.isolated, two.isolated)
    np.testing.assert_array_equal(one.residual, two.residual)


def test_hypotheses_without_a_size_become_events_of_their_own() -> None:
    log = with_bias(0.0, 0, ONSET, ONSET + 1)
    d = decisions(on_tanks(), log)
    assert d.process is not None
    tested = on_tanks().process_hypotheses
    assert tested[-2:] == (NO_SINGLE_CAUSE, OUTSIDE)
    d.process[100:120, -2] = d.process[300:320, -1] = True
    found = [e for e in events_of(on_tanks(), log.t, d, 3) if e.kind != "undecided"]
    assert [e.kind for e in found] == ["process", "outside"] and all(np.isnan(e.size) for e in found)


@pytest.mark.parametrize(
    "make",
    [pytest.param(m, marks=pytest.mark.slow if m is tank_cascade else pytest.mark.long) for m in PLANTS],
    ids=lambda make: make.__name__,
)
def test_a_wrong_law_blames_no_healthy_sensor(make: Any) -> None:
    """A day that was not learnt; a verdict of some rows may be "outside"."""
    law, detector = of(make)
    d = decisions(detector, law.record(1.0, 22, building=11))
    assert np.mean(d.isolated.any(axis=1)) <= 0.002
    assert d.process is not None and np.mean(d.process[:, :-1].any(axis=1)) <= 0.02


@pytest.mark.parametrize(
    ("make", "sensor"),
    [pytest.param(tank_cascade, 4, marks=pytest.mark.slow), pytest.param(exchanger_pair, 2, marks=pytest.mark.long)],
)
def test_a_drift_on_a_plant_with_a_wrong_law_is_named(make: Any, sensor: int) -> None:
    law, detector = of(make)
    count = len(law.sensors)
    log = law.record(0.6, 23 + sensor, building=11, bias=drift(sensor, count, ONSET * DT, ROWS, 10.0))
    d = decisions(detector, log)
    during, after = d.isolated[ONSET : ONSET + ROWS], d.isolated[ONSET + ROWS + 30 :]
    assert np.mean(during[:, sensor]) > 0.4 and np.mean(np.delete(during, sensor, axis=1).any(axis=1)) <= 0.005
    assert np.mean(after.any(axis=1)) <= 0.1
    found = diagnose_run(detector, log)
    assert found.state is Verdict.SENSOR and law.sensors[sensor].name in found.verdict


@pytest.mark.slow
@pytest.mark.parametrize("rows", [60])
def test_a_process_fault_on_a_plant_with_a_wrong_law_is_no_sensor(rows: int) -> None:
    law, detector = of(tank_cascade)

    def weaker(t: Array) -> Array:
        factor = np.ones((t.size, len(law.parameters)))
        factor[:, 0] -= 0.3 * np.clip((t / DT - ONSET) / rows, 0, 1)
        return factor

    d = decisions(detector, law.record(0.6, 31, building=11, change=weaker))
    assert d.process is not None
    assert np.mean(d.process[ONSET + rows :].any(axis=1)) > 0.8 and np.mean(d.isolated.any(axis=1)) <= 0.01


@pytest.mark.parametrize("size", [5.0, 15.0])
def test_a_lasting_bias_that_the_filter_follows_is_not_the_process(size: float) -> None:
    """Windows that contain its beginning see the filter on its way, not what it is where the cause has lasted."""
    follows = np.array([[0.99, 0.0], [0.02, 0.99]])
    sensors = [Sensor("a", "x0", sigma=1.0), Sensor("b", "x1", sigma=1.0)]
    plant = linear_plant(
        "slow", follows, np.eye(2), sensors, dt=1.0, x0=np.zeros(2), process_cov=np.full(2, 0.03**2), initial_cov=np.ones(2)
    )
    healthy, other = (simulate(plant, n, [s], truth="model", process_noise=True) for n, s in ((3000, 1), (900, 5)))
    detector = FrozenBank.fit(plant, Log(healthy.t, healthy.y[:, 0], healthy.u), 1e-3)
    y = other.y[:, 0].copy()
    y[ONSET:, 0] += size
    d = decisions(detector, Log(other.t, y, other.u))
    assert d.process is not None
    assert d.isolated[ONSET + 30 :, 0].mean() > 0.95 and not d.isolated[:, 1].any() and not d.process[ONSET:].any()


def test_a_second_fault_beside_a_lasting_one_is_named_and_the_repair_of_the_first_is_seen() -> None:
    follows = 0.95 * np.eye(3) + 0.03 * np.eye(3, k=-1)
    sensors = [Sensor(name, f"x{i}", sigma=1.0) for i, name in enumerate("abc")]
    plant = linear_plant(
        "three", follows, np.eye(3), sensors, dt=1.0, x0=np.zeros(3), process_cov=np.full(3, 0.03**2), initial_cov=np.ones(3)
    )
    healthy, other = (simulate(plant, n, [s], truth="model", process_noise=True) for n, s in ((3000, 1), (1400, 5)))
    detector = FrozenBank.fit(plant, Log(healthy.t, healthy.y[:, 0], healthy.u), 1e-3)
    first, second, repair = ONSET, ONSET + LONGEST + 100, ONSET + LONGEST + 500
    y = other.y[:, 0].copy()
    y[first:repair, 0] += 10.0
    y[second:, 2] -= 8.0
    d = decisions(detector, Log(other.t, y, other.u))
    assert d.process is not None
    assert not d.isolated[:, 1].any() and not d.process[first:].any()
    assert d.isolated[first + 10 : repair, 0].mean() > 0.95 and d.isolated[second + 10 :, 2].mean() > 0.95
    assert not d.isolated[repair + 15 :, 0].any() and not d.isolated[:second, 2].any()
    np.testing.assert_allclose(np.nanmedian(d.fault_size[second + 60 : repair][:, [0, 2]], axis=0), [10.0, -8.0], atol=0.5)
    assert np.all((np.abs(d.residual) > d.threshold)[second + 10 : repair, 0])


@pytest.mark.parametrize(("left", "named"), [(0.03, True), (0.11, False)])
def test_a_sensor_whose_offset_leaves_a_tenth_of_a_large_change_is_not_named(left: float, named: bool) -> None:
    """An offset of a reading bends no equation, so that a fault of a sensor leaves little whatever its size."""
    detector = on_tanks()
    count, causes = len(PLANT.sensors), len(PLANT.sensors) + len(detector.process_hypotheses) - 2
    total, one, no = np.array([100.0]), np.ones((1, causes)), np.array([False])
    own = np.full((1, causes), 20.0)
    own[0, 2] = (1 - left) * total[0]
    found = Found(~no, total, own, one, one, total, no, one < 1, np.array([0]), no)
    _, isolated, _, process, suspect, _ = detector._causes(detector._start((1,), 0), found, np.ones((1, count)))
    assert isolated[0, 2] == named and not np.delete(isolated, 2, axis=1).any() and not suspect.any()
    assert process[0, -2] == (not named)


def ageing(months: float) -> FrozenBank:
    """That of the tanks, the first of whose outlets changes by one of its deviations in so many months; 0: none changes."""
    rates = [p.sd / np.sqrt(months * 720) if p.name == "outlet_1" and months else 0.0 for p in PLANT.uncertainty.parameters]
    aged = tuple(replace(p, rate=float(r)) for p, r in zip(PLANT.uncertainty.parameters, rates, strict=True))
    return replace(on_tanks(), plant=replace(PLANT, uncertainty=replace(PLANT.uncertainty, parameters=aged)), commissioned=0.0)


@cache
def worn() -> Log:
    """The tanks with an outlet that is 4 % wider, and from a row on a bias of another sensor."""
    _, values, sd = declared(PLANT)
    found = simulate(at(PLANT, values * [1.04, 1.0, 1.0, 1.0], sd), 500, [7], truth="model", process_noise=True)
    y = found.y[:, 0].copy()
    y[ONSET:, 2] += 12 * PLANT.sensor_sigma[2]
    return Log(found.t, y, found.u)


def test_ageing_as_stated_is_no_fault_and_hides_none() -> None:
    d = decisions(ageing(3.0).dated(datetime(1970, 4, 1)), worn())
    assert d.suspect is not None and d.process is not None
    assert not d.isolated[:ONSET].any() and not d.suspect[:ONSET].any() and not d.process[:, :-1].any()
    assert d.isolated[ONSET + 20 :, 2].mean() > 0.9 and not np.delete(d.isolated, 2, axis=1).any()


def test_a_hundred_times_faster_it_is_found() -> None:
    """Ten of its deviations: the level sensor or its outlet, which look alike."""
    d = decisions(ageing(3.0).dated(datetime(1970, 1, 1) + timedelta(days=0.9)), worn().rows(slice(ONSET)))
    assert d.suspect is not None
    names = (*PLANT.sensor_names, *(h.name for h in on_tanks().process_hypotheses))
    assert d.suspect[ONSET - 50 :, names.index("outlet_1")].all() and not d.isolated.any()


def test_without_a_rate_or_a_date_nothing_ages() -> None:
    none, some = ageing(0.0), ageing(3.0)
    assert none.dated(datetime(1990, 1, 1)) is none and some.dated(None) is some
    assert replace(some, commissioned=None).dated(datetime(1990, 1, 1)).age is None


def test_a_log_and_a_watch_age_by_the_clock_of_their_rows() -> None:
    start = datetime(1970, 4, 1)
    judged = prepared(ageing(3.0), LoadedLog(worn(), Clock(start), ())).detector
    watch = Watch(ageing(3.0))
    for k in range(2):
        watch.update(start + timedelta(seconds=k * PLANT.dt), worn().y[k], worn().u[k])
    for found in (judged, watch.judge):
        assert isinstance(found, FrozenBank) and found.age == 90 * 86400.0
