"""The states of NAMUR NE 107: of an event, and of each sensor as rows arrive."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnosis_schema import schema
from toy_plants import readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.detector import ProcessHypothesis
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.verdicts import ALL_FAR, NO_THRESHOLDS, TOO_MANY, Conclusion, Verdict
from fusion_sfdia.diagnosis.device_health import UNHEARD, DeviceHealth, health_of, sensor_health
from fusion_sfdia.diagnosis.events import Event, OperationEvent, OtherEvent, ProcessEvent, UndecidedEvent
from fusion_sfdia.diagnosis.watch import Sample, Watch
from fusion_sfdia.live.lines import change_line, sample_line

GOOD, FAILURE, CHECK, OFF, MAINTENANCE = DeviceHealth
Y = np.ones(4)


def event(kind: type[Event] = Event, *more: Any, **fields: Any) -> Event:
    return kind("l1", 0.0, 10.0, 0.05, "m", True, *more, **fields)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (event(fault="dropout", confidence=1.0), FAILURE),
        (event(fault="freeze", sigmas=1.0), FAILURE),
        (event(fault="freeze", confidence=0.3), FAILURE),
        (event(fault="bias", sigmas=-3.0, confidence=0.9), MAINTENANCE),
        (event(fault="bias", sigmas=-3.1, confidence=0.9), OFF),
        (event(fault="drift", sigmas=2.0), MAINTENANCE),
        (event(fault="drift", sigmas=20.0), OFF),
        (event(fault="drift"), OFF),
        (event(fault="noise", sigmas=2.0), OFF),
        (event(fault="spikes", sigmas=30.0), MAINTENANCE),
        (event(sigmas=2.0), OFF),  # isolated, its kind is not known yet
        (event(sigmas=20.0, confidence=0.4), CHECK),
        (event(UndecidedEvent, ("l1", "leak")), CHECK),
        (event(OperationEvent), CHECK),
        (event(ProcessEvent, 0.1, 1.0), None),
        (event(OtherEvent), None),
    ],
)
def test_an_event_has_a_state_by_its_kind_and_size(found: Event, expected: DeviceHealth | None) -> None:
    assert health_of(found) is expected


def test_the_numbers_are_those_of_opc_ua_for_devices() -> None:
    names = ("NORMAL", "FAILURE", "CHECK_FUNCTION", "OFF_SPEC", "MAINTENANCE_REQUIRED")
    assert {s.name: s.value for s in DeviceHealth} == dict(zip(names, range(5), strict=True))
    assert schema()["$defs"]["change"]["properties"]["device_health"]["enum"] == list(names)


def test_a_sensor_without_an_event_is_good_where_it_is_judged_and_nothing_speaks_against_it() -> None:
    plant, detector = tanks(), LeaveOneOutBank(tanks(), window=1)
    _, decision = detector.step(detector.init(), 5.0, Y, np.zeros(1))
    judged = replace(decision, residual=np.zeros(4), threshold=np.ones(4), suspect=None)
    unheard = replace(judged, residual=np.array([0.0, np.nan, 0.0, 0.0]))

    def states(d: Any, verdict: Verdict, reason: str = "", recent: Any = (), **standing: DeviceHealth) -> tuple[Any, ...]:
        return sensor_health(plant, d, Conclusion(verdict, reason), recent, standing)

    assert states(judged, Verdict.HEALTHY) == (GOOD,) * 4
    assert states(judged, Verdict.PROCESS) == (GOOD,) * 4  # the process differs, no sensor
    assert states(judged, Verdict.SENSOR, l1=FAILURE) == (FAILURE, GOOD, GOOD, GOOD)
    outside = ProcessHypothesis("operation", "", "outside", np.nan)
    unlike = replace(judged, process=np.array([True]))
    found = sensor_health(plant, unlike, Conclusion(Verdict.SENSOR), (), {"l1": FAILURE}, (outside,))
    assert found == (FAILURE, CHECK, CHECK, CHECK)  # the verdict names l1 alone, but operation is as in no healthy log
    leak = outside._replace(kind="parameter")
    assert sensor_health(plant, unlike, Conclusion(Verdict.PROCESS), (), {}, (leak,)) == (GOOD,) * 4
    assert states(judged, Verdict.BLIND, l1=FAILURE) == (FAILURE, CHECK, CHECK, CHECK)
    for verdict, reason in (
        (Verdict.BLIND, ""),
        (Verdict.OUTSIDE, ""),
        (Verdict.UNDECIDED, ALL_FAR),
        (Verdict.UNDECIDED, TOO_MANY),
    ):
        assert states(judged, verdict, reason) == (CHECK,) * 4
    no_threshold = replace(judged, threshold=np.full(4, np.inf))
    assert states(no_threshold, Verdict.UNDECIDED, NO_THRESHOLDS) == (CHECK,) * 4
    assert states(unheard, Verdict.HEALTHY, recent=[unheard] * (UNHEARD - 1) + [judged]) == (GOOD,) * 4
    assert states(unheard, Verdict.HEALTHY, recent=[unheard] * UNHEARD + [judged]) == (GOOD, CHECK, GOOD, GOOD)
    suspected = replace(judged, suspect=np.array([False, False, True, True, True]))
    assert states(suspected, Verdict.UNDECIDED) == (GOOD, GOOD, CHECK, CHECK)
    alone = replace(judged, residual=np.array([0.0, 0.0, 0.0, -1.1]))
    assert states(alone, Verdict.UNDECIDED) == (GOOD, GOOD, GOOD, CHECK)
    assert states(alone, Verdict.SENSOR, l2=OFF) == (GOOD, OFF, GOOD, GOOD)


def watched(kinds: bool = True) -> tuple[Watch, list[Sample]]:
    """230 rows with a bias of l1 from 50 to 79, in which q2 is silent from 100 to 159."""
    t, _, y, u = readings(tanks(), 230, 1, seed=1)
    y = y[:, 0].copy()
    y[50:80, 0] += 0.5
    y[100:160, 3] = np.nan
    watch = Watch(LeaveOneOutBank(tanks(), window=1), kinds=kinds, refused=print)
    return watch, [s for row in zip(t, y, u[:, 0], strict=True) for s in watch.update(*row)]


def test_states_come_and_go_with_the_events_and_are_in_the_lines() -> None:
    watch, samples = watched()
    of_l1, of_q2 = ([s.device_health[i] for s in samples] for i in (0, 3))
    assert of_l1[50:80] == [OFF] * 30 and of_l1[90:] == [GOOD] * len(of_l1[90:])
    silent = of_q2.index(FAILURE)
    assert 100 < silent < 150 and set(of_q2[silent:160]) == {FAILURE} and of_q2[-1] is GOOD
    lines = [json.loads(change_line(c, Clock(), {})) for s in samples for c in s.changes]
    assert {"FAILURE"} == {e["device_health"] for e in lines if e.get("fault") == "dropout"}
    line = json.loads(sample_line(samples[60], tanks(), watch.detector.hypotheses, Clock()))
    assert line["device_health"]["l1"] == "OFF_SPEC" and line["device_health"].keys() == set(tanks().sensor_names)


def test_a_silent_sensor_whose_kind_is_not_looked_for_is_not_good() -> None:
    _, samples = watched(kinds=False)
    of_q2 = [s.device_health[3] for s in samples]
    assert of_q2[:139] == [GOOD] * 139 and of_q2[139:160] == [CHECK] * 21 and of_q2[160] is GOOD
    assert UNHEARD == 40
