"""Physics that a user states: what sensors of one quantity and driven readings let a monitor name, and what it does not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factor_logs import factors, log_of, signals
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.learning.monitor.causes import MOVED, ONE_OF, OUTSIDE, Causes
from fusion_sfdia.learning.monitor.monitor import Monitor
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.physics import StatedPhysics
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

ROWS, FAULTY = 1500, slice(600, 800)
A, B = 8, 9  # the sensors of one quantity, "s8" and "s9"
PUMP = Signal("pump", "%")


def slow(rng: np.random.Generator, kept: float, sd: float) -> Array:
    x, n = np.zeros(ROWS), np.sqrt(1 - kept**2) * sd * rng.standard_normal(ROWS)
    for k in range(1, ROWS):
        x[k] = kept * x[k - 1] + n[k]
    return x


def plant(seed: int, gains: tuple[float, ...] = (1.0, -1.7), sd: float = 1.0, moved: float = 0.0) -> Array:
    """Eight readings of factors, and some of a quantity that these do not show, which may move by so much."""
    rng = np.random.default_rng([seed, 7])
    q = slow(rng, 0.97, sd)
    q[FAULTY] += moved
    twins = [20.0 * k + g * (q + slow(rng, 0.6, 0.25)) for k, g in enumerate(gains)]
    return np.column_stack([factors(seed, ROWS), *twins])


def learnt(y: Array, **stated: Any) -> Monitor:
    return Monitor.of_logs(signals(y.shape[1]), [log_of(y)], **stated)


def judged(monitor: Monitor, y: Array) -> Causes:
    return monitor.judge(log_of(y))[0].causes


def off(y: Array, sensor: int, size: float) -> Array:
    y = y.copy()
    y[FAULTY, sensor] += size
    return y


@pytest.fixture(scope="module")
def pair() -> Monitor:
    return learnt(plant(9410), same=["s8", "s9"])


@pytest.mark.parametrize(("wrong", "size"), [(A, 4.0), (B, -6.0)])
def test_of_two_of_one_quantity_the_one_that_stepped_is_named(pair: Monitor, wrong: int, size: float) -> None:
    y = off(plant(9411), wrong, size)
    before = judged(learnt(plant(9410)), y)
    assert before.named[FAULTY, wrong].mean() < 0.3 and (before.kind[FAULTY] == ONE_OF).mean() > 0.6
    found = judged(pair, y)
    assert found.named[FAULTY, wrong].mean() > 0.9
    assert not np.delete(found.named[FAULTY], wrong, axis=1).any()


def test_a_quantity_that_moves_is_no_fault_of_its_sensors(pair: Monitor) -> None:
    quiet = judged(pair, plant(9411))
    found = judged(pair, plant(9411, moved=6.0))
    assert (found.kind[FAULTY] != 0).mean() > 0.5
    assert (found.named | found.suspect)[FAULTY, A:].any(axis=1).mean() <= quiet.named[FAULTY].any(axis=1).mean() + 0.02


def test_where_neither_stands_out_it_is_one_of_the_two(pair: Monitor) -> None:
    y = plant(9411)
    y[200:, A] += np.minimum(np.arange(ROWS - 200) / 1300, 1.0) * 1.2  # within what the quantity does by itself
    found = judged(pair, y)
    told = found.suspect[1000:, A] & found.suspect[1000:, B] & (found.kind[1000:] == ONE_OF)
    assert told.mean() > 0.3 and not found.named[1000:, B].any()


def test_a_quantity_that_stood_still_when_healthy_has_sensors_all_the_same() -> None:
    gains, size = (1.0, 1.0), 1.5
    healthy, y = plant(9420, gains, 0.08), off(plant(9421, gains, 0.08), A, size)
    plain, monitor = learnt(healthy), learnt(healthy, same=[["s8", "s9"]])
    told = judged(monitor, y)
    assert told.named[FAULTY, A].mean() > 0.8 and not told.named[FAULTY, B].any()
    alone, both = (judged(of, plant(9421, gains, 0.08, moved=size)) for of in (plain, monitor))
    assert (alone.named | alone.suspect)[FAULTY, A:].any(axis=1).mean() > 0.1
    assert not (both.named | both.suspect)[FAULTY, A:].any() and (both.kind[FAULTY] != 0).mean() > 0.5


def test_of_three_the_one_against_the_others_is_named_even_while_their_quantity_moves() -> None:
    gains = (1.0, 0.6, 1.0)
    monitor = learnt(plant(9430, gains), same=["s8", "s9", "s10"])
    found = judged(monitor, off(plant(9431, gains), A + 2, 1.5))
    assert found.named[FAULTY, A + 2].mean() > 0.8 and not np.delete(found.named[FAULTY], A + 2, axis=1).any()


def test_gains_are_those_of_the_sensors_and_disagreement_is_the_smallest_of_all_others(pair: Monitor) -> None:
    sd = pair.channels.sd
    gain = pair.learnt.stated.gain
    ratio = (gain[B] / sd[B]) / (gain[A] / sd[A])  # of units of the quantity per unit of the reading
    assert ratio == pytest.approx(1 / -1.7, rel=0.05)
    assert (pair.learnt.stated.group[[0, A, B]] == [-1, 0, 0]).all()


def test_row_by_row_and_from_a_file_it_decides_the_same(pair: Monitor, tmp_path: Path) -> None:
    log = log_of(off(plant(9411), B, -6.0)[580:680])
    whole = pair.diagnose(log).decisions
    pair.save(tmp_path / "m.sfdia")
    again = Monitor.load(tmp_path / "m.sfdia")
    assert again.physics == pair.physics and "s8, s9: stated to measure one quantity" in str(again)
    stream = again.stream()
    rows = [s.decision for row in zip(*log, strict=True) for s in stream.update(*row)]
    for name in ("isolated", "suspect", "process"):
        assert (np.array([getattr(d, name) for d in rows]) == getattr(whole, name)).all()


def driven(seed: int, pump: float = 50.0, flow: float = 0.0, pressure: float = 0.0) -> Log:
    """Factors, a flow and a pressure that nothing else shows, and the pump, which never moved when healthy."""
    rng, u = np.random.default_rng([seed, 8]), np.full((ROWS, 1), 50.0)
    more = [slow(rng, 0.95, 1.0) + 0.3 * rng.standard_normal(ROWS) for _ in range(2)]
    more[0][FAULTY] += flow
    more[1][FAULTY] += pressure
    u[FAULTY] = pump
    return Log(60.0 * np.arange(ROWS), np.column_stack([factors(seed, ROWS), *more]), u)


def test_a_driven_reading_that_moves_alone_is_wrong_and_with_its_driver_or_others_it_is_not() -> None:
    sensors = [*signals(8), Signal("flow", "m3/h"), Signal("pressure", "bar")]
    stated = {"drives": {"pump": ["flow", "pressure"]}}
    plain, monitor = (Monitor.of_logs(sensors, [driven(9440)], inputs=[PUMP], **k) for k in ({}, stated))

    def found(of: Monitor, **moved: float) -> Causes:
        return of.judge(driven(9441, **moved))[0].causes

    assert (found(plain, flow=8.0).kind[FAULTY] == MOVED).mean() > 0.8
    assert found(monitor, flow=8.0).named[FAULTY, 8].mean() > 0.8
    assert found(monitor, flow=8.0, pressure=-8.0).named[FAULTY].any(axis=1).mean() < 0.05
    by_pump = found(monitor, flow=8.0, pump=60.0)
    assert not by_pump.named[FAULTY, 8].any() and (by_pump.kind[FAULTY] == OUTSIDE).mean() > 0.8
    assert monitor.update([LoadedLog(driven(9442), Clock(), ())]).physics == monitor.physics
    assert "flow, pressure: stated to move with pump" in str(monitor)


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"same": "s8"}, r"same is 's8'; expected names of sensors or groups"),
        ({"same": ["s8"]}, "same: s8 is no group; expected two sensors or more"),
        ({"same": [["s8", "s9"], ["s9", "s1"]]}, "same: 's9' stands twice, in s8, s9 and in s9, s1; join the groups"),
        ({"same": [["s8", "t9"]]}, "same: 't9' is no column of the logs; expected a sensor, one of s0, s1"),
        ({"same": [["s8", "pump"]]}, "same: 'pump' is an input of the logs"),
        ({"drives": ["pump"]}, r"drives is \['pump'\]; expected what each input drives"),
        ({"drives": {"pump": ["flow"]}}, "drives pump: 'flow' is no column"),
        (
            {"drives": {"s1": ["s2"]}},
            "drives: 's1' is a sensor of the logs; state it as an input; expected an input, one of pump",
        ),
        ({"drives": {"pump": 3}}, "drives pump: 3; expected names of sensors"),
    ],
)
def test_what_does_not_fit_is_refused(stated: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StatedPhysics(**stated).require(signals(10), [PUMP])


def test_unlike_units_need_a_quantity_that_moved_when_healthy() -> None:
    y = plant(9420, (1.0, 1.0), 0.02)
    sensors = [*signals(8), Signal("s8", "degC"), Signal("s9", "degF")]
    with pytest.raises(ValueError, match=r"s8 \[degC\] and s9 \[degF\]|s9 \[degF\] and s8 \[degC\]"):
        Monitor.of_logs(sensors, [log_of(y)], same=["s8", "s9"])


def test_a_sensor_that_is_left_out_is_not_compared() -> None:
    y = plant(9410, (1.0, 1.0, 1.0))
    y[::2, 10] = np.nan
    monitor = learnt(y, same=["s8", "s9", "s10"])
    assert "s10: left out, so not compared with others of s8, s9, s10" in monitor.remarks
    assert monitor.learnt.stated.groups[0].tolist() == [A, B]
