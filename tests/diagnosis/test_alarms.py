"""A flood of changes raises one alarm in ten minutes for one cause."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from toy_plants import readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.alarms import Alarms, cause_of
from fusion_sfdia.diagnosis.changes import Alarm, Change
from fusion_sfdia.diagnosis.device_health import DeviceHealth
from fusion_sfdia.diagnosis.events import Event, ProcessEvent, UndecidedEvent
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live.lines import change_line


def sensor(number: int, what: str, t: float, name: str = "l1", **more: Any) -> Change:
    return Change(number, what, t, Event(name, t, t, 0.5, "m", what == "opened", sigmas=9.0, **more))


def alarms_of(changes: list[Change]) -> list[Alarm | None]:
    alarms = Alarms()
    return [alarms.with_alarm(c).alarm for c in changes]


def test_a_cause_that_flaps_for_two_hours_is_one_alarm() -> None:
    flood = [sensor(k // 2 + 1, ("opened", "closed")[k % 2], 10.0 * k) for k in range(720)]
    found = alarms_of(flood)
    assert [a and a.new for a in found] == [True] + [False] * 719
    assert {a and a.id for a in found} == {1}
    assert [a and a.active for a in found] == [True, False] * 360


def test_what_returns_after_ten_minutes_is_a_new_alarm_and_before_it_is_not() -> None:
    changes = [sensor(1, "opened", 0.0), sensor(1, "closed", 5.0)]
    assert alarms_of([*changes, sensor(2, "opened", 604.9)])[-1] == Alarm(1, new=False, active=True)
    assert alarms_of([*changes, sensor(2, "opened", 605.0)])[-1] == Alarm(2, new=True, active=True)
    late = Change(1, "named", 5000.0, sensor(1, "closed", 5.0, fault="bias").event)  # of the event that is over
    assert alarms_of([*changes, late])[-1] == Alarm(1, new=False, active=False)
    assert alarms_of([sensor(1, "opened", 0.0), sensor(2, "opened", 5000.0)])[-1] == Alarm(1, new=False, active=True)
    both = [sensor(1, "opened", 0.0), sensor(2, "opened", 1.0), sensor(1, "closed", 2.0), sensor(2, "closed", 3.0)]
    assert [a and a.active for a in alarms_of(both)] == [True, True, True, False]


def test_one_cause_is_a_sensor_a_hypothesis_what_is_undecided_or_blindness() -> None:
    leak = ProcessEvent("leak", 0.0, 1.0, 0.5, "m", True, 0.1, 1.0)
    unsure = [UndecidedEvent(" or ".join(s), 0.0, 1.0, np.nan, "", True, s) for s in (("l1", "leak"), ("l2", "leak"))]
    changes = [
        sensor(1, "opened", 0.0), sensor(2, "opened", 0.0, "l2"), Change(3, "opened", 0.0, leak),
        *(Change(4 + k, "opened", float(k), e) for k, e in enumerate(unsure)),
        Change(6, "blind", 9.0, reason="x"), Change(7, "reset", 9.0, reason="x"), Change(0, "health", 9.0, reason="x"),
    ]  # fmt: skip
    assert [cause_of(c) for c in changes] == [
        "sensor l1", "sensor l2", "process leak", "undecided", "undecided", "blind", None, None,
    ]  # fmt: skip
    assert [a and (a.id, a.new) for a in alarms_of(changes)] == [
        (1, True), (2, True), (3, True), (4, True), (4, False), (5, True), None, None,
    ]  # fmt: skip


def test_a_reset_ends_what_stands_but_not_blindness() -> None:
    alarms = Alarms()
    for change in (sensor(1, "opened", 0.0), Change(2, "blind", 1.0, reason="x"), Change(3, "reset", 2.0, reason="x")):
        alarms.with_alarm(change)
    assert alarms.standing == {} and alarms.raised["blind"].open == (2,)
    assert alarms.with_alarm(sensor(4, "opened", 3.0)).alarm == Alarm(1, new=False, active=True)
    assert alarms.standing == {"l1": DeviceHealth.OFF_SPEC}
    assert alarms.with_alarm(Change(2, "sees again", 4.0, reason="x")).alarm == Alarm(2, new=False, active=False)


def test_any_flood_has_new_alarms_of_a_cause_at_least_ten_minutes_apart() -> None:
    rng, alarms, t, standing = np.random.default_rng(0), Alarms(), 0.0, dict[str, int]()
    new, count = defaultdict[str, list[float]](list), 3000
    for number in range(1, count + 1):
        t += float(rng.exponential(120.0))
        name = f"s{rng.integers(3)}"
        known = standing.pop(name, None)
        change = alarms.with_alarm(sensor(number, "opened", t, name) if known is None else sensor(known, "closed", t, name))
        if known is None:
            standing[name] = number
        assert change.alarm
        if change.alarm.new:
            new[name].append(change.t)
    assert len(new) == 3 and all(b - a >= 600.0 for times in new.values() for a, b in pairwise(times))
    assert sum(map(len, new.values())) == alarms.count < count / 2  # half of the changes open an event


def test_alarms_are_in_the_lines_and_survive_a_restart(tmp_path: Path) -> None:
    t, _, y, u = readings(tanks(), 120, 1, seed=1)
    y = y[:, 0].copy()
    y[20:, 0] += np.where(np.arange(100) % 20 < 6, 0.5, 0.0)  # a contact that is loose
    rows = list(zip(t, y, u[:, 0], strict=True))

    def lines(watch: Watch, some: list[Any]) -> list[str]:
        return [change_line(c, Clock(), {}) for row in some for s in watch.update(*row) for c in s.changes]

    whole = Watch(LeaveOneOutBank(tanks(), window=1), refused=print)
    first = Watch(LeaveOneOutBank(tanks(), window=1), refused=print)
    expected = lines(whole, rows)
    before = lines(first, rows[:70])
    first.save(tmp_path / "w.state")
    again = Watch.load(tmp_path / "w.state", LeaveOneOutBank(tanks(), window=1), refused=print)
    assert before + lines(again, rows[70:]) == expected
    of_l1 = [line for line in expected if '"l1"' in line]
    assert sum('"opened"' in line for line in of_l1) > 2 and sum('"alarm_new": true' in line for line in of_l1) == 1
    assert Alarms.of(str(whole.alarms)) == whole.alarms
    ahead = str(whole.alarms)
    whole.last()
    assert str(whole.alarms) == ahead
