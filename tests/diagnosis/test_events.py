"""From decisions to events, and events in words."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from process_bank import INFLOW, OUTLET, SD, SIZE, ProcessBank
from toy_plants import readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.diagnose import Diagnosis, against_the_model
from fusion_sfdia.diagnosis.events import (
    Event,
    GroupEvent,
    OtherEvent,
    ProcessEvent,
    UndecidedEvent,
    UnnamedEvent,
    answered,
    continued,
    events_of,
    follow_ups,
    listed,
    sensors_instead,
    spans,
    verdict,
    with_spread,
)

NEVER = 10**6
PLANT = tanks()
Q12 = PLANT.sensor_index("q12")


def found(*, bias_from: int = 1000, **settings: Any) -> Diagnosis:
    """A diagnosis of 40 readings, 5 s apart, with a bias of 20 sigma of q12 from a step on, by the bank with a fixed rule."""
    settings = {"accept": (NEVER, NEVER), "false_alarm": 1e-6} | settings
    t, _, y, u = readings(PLANT, 40, 1, seed=0)
    y = y[:, 0].copy()
    y[bias_from:, Q12] += 20 * PLANT.sensor_sigma[Q12]
    return diagnose(ProcessBank(PLANT, **settings), t, y, u[:, 0])


def test_nothing_is_found() -> None:
    nothing = found()
    assert nothing.events == () and nothing.verdict == "no fault" == str(nothing)
    assert repr(nothing) == "<Result of 40 readings, 0 events: no fault>"


def test_an_accepted_parameter_is_stated_relative_to_the_model() -> None:
    diagnosis = found(accept=(9, NEVER))
    (event,) = diagnosis.events
    assert event == ProcessEvent("outlet", 45.0, 200.0, SIZE[0], "m2.5/s", True, SD[0], OUTLET.nominal)
    assert event.kind == "process" and diagnosis.process_hypotheses == (OUTLET, INFLOW)
    assert str(event) == "outlet 5.0 % +- 0.8 below the model since 45 s: not a sensor"  # 3e-5 and 5e-6 of 6e-4
    assert diagnosis.verdict == "process or model: outlet"
    assert str(diagnosis) == f"process or model: outlet\n  {event}"


def test_a_pure_number_has_no_unit() -> None:
    event = ProcessEvent("learnt disturbance 1 (T3, L2)", 0.0, 9.0, 17.5, "1", False, 1.4, np.nan)
    assert str(event) == "learnt disturbance 1 (T3, L2) 17.5 +- 1.4 above the model from 0 s to 9 s: not a sensor"
    assert Event("pH", 0.0, 9.0, 0.5, "1", False, fault="bias").extent == "bias 0.5"


def test_an_error_without_nominal_value_is_stated_in_its_unit() -> None:
    (event,) = found(accept=(NEVER, 9), release=(NEVER, 20)).events
    assert str(event) == "error of inflow 4.2e-05 m3/s +- 6e-06 above the model from 45 s to 95 s: not a sensor"


def test_the_process_is_first_then_what_is_undecided_then_sensors() -> None:
    """Even where it is accepted later; of each in order of their start."""
    diagnosis = found(accept=(30, 25), bias_from=20, doubt=(3, 8), between=(4, 0))
    assert [(e.kind, e.hypothesis) for e in diagnosis.events] == [
        ("process", "error of inflow"),
        ("process", "outlet"),
        ("undecided", "outlet or l1"),
        ("sensor", "q12"),
    ]
    expected = "sensor q12; process or model: error of inflow, outlet; cannot tell: outlet or l1"
    assert diagnosis.verdict == expected and repr(diagnosis) == f"<Result of 40 readings, 4 events: {expected}>"
    _, _, undecided, sensor = diagnosis.events
    assert str(undecided) == "cannot tell: outlet or l1, from 15 s to 35 s"  # the more probable first
    assert str(sensor) == "q12: 105 s to end of the log, bias 0.00012 m3/s (0.0001169 to 0.000123), 20 sigma"


def test_what_is_decided_in_the_end_is_no_open_question() -> None:
    """The suspects stand until the sample before the sensor is isolated; between others they stay an open question."""
    decided, other = (found(bias_from=20, doubt=(16, 21), between=between) for between in ((Q12, 4), (0, 4)))
    assert [e.kind for e in decided.events] == [e.kind for e in other.events] == ["undecided", "sensor"]
    assert decided.events[0].end == 100.0 and decided.events[1].start == 105.0
    assert decided.verdict == "sensor q12"
    assert other.verdict == "sensor q12; cannot tell: l1 or outlet"


def test_what_is_undecided_only_while_a_suspect_is_named_is_no_finding() -> None:
    named = Event("q12", 100.0, 500.0, 0.3, "m3/s", open=False, confidence=0.9)
    within = UndecidedEvent("q12 or q2", 200.0, 300.0, np.nan, "", open=False, suspects=("q12", "q2"))
    assert answered(within, [named, within])
    for other in (replace(within, end=600.0), replace(within, start=50.0), replace(within, suspects=("l1", "l2"))):
        assert not answered(other, [named, other])
    assert not answered(within, [replace(named, confidence=0.3), within])
    assert not answered(named, [named])


def test_a_short_alarm_that_ends_by_itself_is_no_open_question() -> None:
    """It is an event all the same; one that lasts to the end is open."""
    short, long, last = (found(doubt=doubt, between=(0, 4)) for doubt in ((9, 11), (9, 12), (40, NEVER)))
    assert short.verdict == "no fault" and len(short.events) == 1
    assert long.verdict == last.verdict == "cannot tell: l1 or outlet"
    assert str(found(doubt=(9, 10), between=(0, 4)).events[0]) == "cannot tell: l1 or outlet, at 45 s"


def test_suspects_are_those_that_stood_together_longest() -> None:
    once = found(doubt=(5, NEVER), between=(1, 5))
    (event,) = once.events
    assert isinstance(event, UndecidedEvent) and event.open and np.isnan(event.size)
    assert event.suspects == ("l2", "error of inflow") and str(event) == "cannot tell: l2 or error of inflow, since 25 s"
    suspect = np.zeros_like(once.decisions.suspect)
    suspect[5:7, [0, 1, 2, 5]] = True  # at first anything
    suspect[7:10, [1, 5]] = True
    suspect[11:14, [0, 5]] = True  # after a gap as often as the two before: the later counts
    detector, decisions = ProcessBank(PLANT), replace(once.decisions, suspect=suspect, probability=None)
    (event,) = events_of(detector, once.t, decisions, 3)
    assert isinstance(event, UndecidedEvent) and event.suspects == ("l1", "error of inflow")
    assert (event.start, event.end) == (once.t[5], once.t[13])
    apart = events_of(detector, once.t, decisions, 1)
    assert [e.hypothesis for e in apart] == ["l2 or error of inflow", "l1 or error of inflow"]


def test_the_table_has_the_same_columns_whether_the_process_is_tested_or_not() -> None:
    pandas = pytest.importorskip("pandas")
    diagnosis = found(accept=(9, NEVER), bias_from=20)
    frame = diagnosis.frame()
    added = ["fault", "start", "end", "size_low", "size_high", "size_sigma", "confidence", "alternatives"]
    known = ["kind", "hypothesis", "start_s", "end_s", "size", "sd", "unit", "nominal", "open"]
    assert list(frame.columns) == known + added
    assert frame["kind"].tolist() == ["process", "sensor"] and isinstance(frame, pandas.DataFrame)
    assert frame["sd"].tolist()[0] == SD[0] and np.isnan(frame["sd"].tolist()[1])
    t, _, y, u = readings(PLANT, 5, 1, seed=0)
    of_sensors = diagnose(LeaveOneOutBank(PLANT), t, y[:, 0], u[:, 0])
    assert list(of_sensors.frame().columns) == known + added
    assert of_sensors.process_hypotheses == ()


def test_sensors_are_those_of_the_bank_without_the_process() -> None:
    t, _, y, u = readings(PLANT, 40, 1, seed=0)
    y = y[:, 0].copy()
    y[20:, Q12] += 20 * PLANT.sensor_sigma[Q12]
    alone = diagnose(LeaveOneOutBank(PLANT, false_alarm=1e-6), t, y, u[:, 0])
    (beside,) = found(accept=(9, NEVER), bias_from=20).events[1:]
    assert alone.events == (replace(beside, confidence=alone.events[0].confidence),)  # of which this bank has its own
    assert alone.verdict == "sensor q12"


def test_a_verdict_holds_until_the_estimate_diverges() -> None:
    t, _, y, u = readings(PLANT, 40, 1, seed=0)
    bank = ProcessBank(PLANT, accept=(9, NEVER))
    diagnosis = diagnose(bank, t, y[:, 0], u[:, 0])
    diagnosis.decisions.diverged[30:] = True
    assert diagnosis.verdict == "process or model: outlet until 155 s, where the estimate diverged"


def test_other_hypotheses_than_sensors_are_no_sensors() -> None:
    when = (1.0, 2.0, 0.5)
    events = [Event("a", *when, "m", False), Event("b", *when, "m", False), OtherEvent("attack", *when, "", False)]
    assert verdict(events, np.arange(3.0)) == "sensors a, b; fault attack"


def test_what_is_rather_something_else_is_named_as_a_possibility() -> None:
    sure, even, unlikely = (Event(n, 1.0, 2.0, 0.5, "m", False, confidence=c) for n, c in (("a", 0.9), ("b", 0.5), ("c", 0.1)))
    assert verdict([sure, even, unlikely], np.arange(3.0)) == "sensors a, b; perhaps c"
    assert verdict([unlikely], np.arange(3.0)) == "perhaps c"
    assert verdict([unlikely, replace(sure, hypothesis="c")], np.arange(3.0)) == "sensor c"
    alone = UndecidedEvent("a", 1.0, 4.0, np.nan, "", False, ("a",))
    assert alone.summary(Clock()) == "perhaps a, from 1 s to 4 s"
    with pytest.warns(DeprecationWarning, match=r"Event\.summary"):
        assert alone.told(Clock()) == alone.summary(Clock())


@pytest.mark.parametrize(("samples", "speaks"), [(2, False), (3, True)])
def test_a_model_is_suspect_where_sensors_disagree_for_longer_than_noise(samples: int, speaks: bool) -> None:
    t, _, y, u = readings(PLANT, 40, 1, seed=0)
    diagnosis = diagnose(LeaveOneOutBank(PLANT), t, y[:, 0], u[:, 0])
    diagnosis.decisions.capped[20 : 20 + samples] = True
    found = against_the_model((), diagnosis.decisions, t, Clock())
    assert found == (("more sensors disagree with it than can be isolated in 3 of 40 samples",) if speaks else ())


@pytest.mark.parametrize(
    ("value", "sd", "expected"),
    [
        (31.4, 4.2, ("31", "4")),
        (31.4, 1.26, ("31.4", "1.3")),
        (31.44, 0.96, ("31.4", "1.0")),
        (5.0, 0.8333, ("5.0", "0.8")),
        (123456.0, 2900.0, ("123000", "3000")),
        (4.2e-9, 6e-10, ("4.2e-09", "6e-10")),
        (3.14159, 0.0, ("3.14", "0")),
        (3.14159, float("nan"), ("3.14", "nan")),
    ],
)
def test_a_value_has_the_digits_that_its_spread_allows(value: float, sd: float, expected: tuple[str, str]) -> None:
    assert with_spread(value, sd) == expected


def test_of_many_names_the_first_are_listed() -> None:
    assert listed(["a", "b", "a", "c", "d", "e"]) == "a, b, c, d, e"  # "1 more" would be no shorter
    assert listed(list("abcdefg"), " or ") == "a or b or c or d or 3 more"


@pytest.mark.parametrize(
    ("held", "gap", "expected"),
    [
        ("", 1, []),
        ("....", 3, []),
        ("####", 1, [(0, 3)]),
        ("#..#", 1, [(0, 0), (3, 3)]),
        ("#..#", 2, [(0, 0), (3, 3)]),
        ("#..#", 3, [(0, 3)]),
        (".##.#...#.", 2, [(1, 4), (8, 8)]),
        ("#.#.#", 2, [(0, 4)]),
    ],
)
def test_spans(held: str, gap: int, expected: list[tuple[int, int]]) -> None:
    assert spans(np.array([c == "#" for c in held], dtype=bool), gap) == expected


def test_a_change_of_the_process_is_taken_back_where_two_sensors_are_named_in_its_place() -> None:
    t = np.arange(100.0)
    leak = ProcessEvent("leak", 10.0, 25.0, 1.0, "m3/s", False, 0.1, 0.0)
    l2, q2 = (Event(name, 27.0, 60.0, 1.0, "m", False) for name in ("l2", "q2"))
    assert sensors_instead(leak, [leak, l2, q2], t) == (l2, q2) == follow_ups(leak, [leak, l2, q2], t)
    assert verdict([leak, l2, q2], t) == "sensors l2, q2"
    for others in ([l2], [l2, replace(l2, size=2.0)], [l2, replace(q2, start=28.0)], [l2, replace(q2, start=25.0)]):
        assert not sensors_instead(leak, [leak, *others], t)
        assert "leak" in verdict([leak, *others], t)
    assert not sensors_instead(replace(leak, open=True), [l2, q2], t)


def test_a_fault_is_over_if_nothing_that_may_be_it_follows() -> None:
    t, nan = np.arange(400.0), np.nan
    bias = Event("l1", 50.0, 99.0, 1.0, "m", False, fault="bias")

    def between(*names: str, start: float = 100.0, end: float = 120.0, open_: bool = False) -> UndecidedEvent:
        return UndecidedEvent(" or ".join(names), start, end, nan, "", open_, names)

    def followed(*others: Event) -> list[Event]:
        return list(follow_ups(bias, [bias, *others], t))

    leak = ProcessEvent("leak", 119.0, 200.0, 1.0, "m3/s", False, 0.1, 0.0)
    for one in (between("l2", "l1"), leak, replace(leak, start=20.0), replace(bias, start=105.0, end=140.0)):
        assert followed(one) == [one]
    assert followed(replace(leak, start=121.0)) == [] == followed(replace(leak, start=60.0, end=99.0))  # too late, over
    assert followed(replace(bias, hypothesis="l2", start=100.0, end=120.0)) == [] == followed(between("l2", "q12"))
    assert followed(named := replace(bias, hypothesis="l2", start=100.0, end=120.0, alternatives=("l1",))) == [named]
    assert followed(between("l2", "l1", end=101.0)) == []  # as noise may raise one
    assert followed(between("l2", "l1", end=101.0, open_=True)) != []
    others, later = between("l2", "q12", end=200.0), replace(leak, start=215.0, end=260.0)
    assert followed(others, later) == [later]  # what is undecided in between tells nothing of l1
    again = replace(bias, start=270.0, end=300.0)
    assert followed(later, replace(leak, start=301.0, end=350.0), again, others) == [later, again]  # that has its own sentence


def test_a_sensor_that_is_named_again_as_far_off_has_one_fault() -> None:
    """Only where the alarm has not ended, to the same side, and not much smaller; a named change of the process stays."""
    t = np.arange(400.0)

    def of(start: float, end: float, size: float) -> Event:
        return Event("l1", start, end, size, "m", False, fault="bias", fault_alternatives=("drift",))

    first, last, more = of(10, 50, 0.8), of(121, 200, 1.0), of(260, 300, 1.1)
    group = GroupEvent("together", 60.0, 120.0, np.nan, "", False, ("l2", "l1"))
    either = UndecidedEvent("l1 or l2", 205.0, 255.0, np.nan, "", False, ("l1", "l2"))
    assert continued([group, either, first, last, more], t) == (either, replace(more, start=10.0))
    assert continued([replace(group, most=("l2",)), first, last], t)[0].kind == "process"
    assert continued([UnnamedEvent("process", 55.0, 118.0, np.nan, "", False), first, last], t) == (replace(last, start=10.0),)
    for other in (replace(last, size=-1.0), replace(last, size=0.3), replace(last, fault="freeze"), of(150, 200, 1.0)):
        assert continued([group, first, other], t) == (group, first, other)
    assert continued([first, of(60, 90, 1.0)], t) == (first, of(60, 90, 1.0))
    brief = replace(of(49, 50, 0.8), fault="spikes")
    assert continued([group, brief, last], t) == (replace(last, start=49.0),)
    assert len(continued([group, replace(brief, start=48.0), last], t)) == 3
    leak = ProcessEvent("leak", 51.0, 120.0, 0.1, "1", False, 0.01, 0.0)
    assert continued([leak, first, last], t) == (leak, replace(last, start=10.0))
