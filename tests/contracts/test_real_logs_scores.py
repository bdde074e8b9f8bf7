"""How the page on recorded logs counts: events found and named, and false alarms."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

ROWS, SENSORS, FIRST, LAST = 200, 3, 100, 119  # the event is that of sensor 1, in 20 rows: two of them are a tenth


@pytest.fixture
def scores(root: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(root / "docs" / "results"))
    return importlib.import_module("real_logs_scores")


def judged(**labels: int) -> Any:
    """A log with the event, and with further labelled readings in the same rows: s0=1 is one of sensor 0."""
    label = np.zeros((ROWS, SENSORS), np.int8)
    label[FIRST : LAST + 1, 1] = 1
    for name, kind in labels.items():
        label[FIRST : LAST + 1, int(name[1:])] = kind
    none = np.zeros(ROWS, bool)
    return SimpleNamespace(log=SimpleNamespace(y=np.zeros((ROWS, SENSORS))), label=label, process=none, healthy=~none)


def found(scores: ModuleType, rows: slice, *names: int, alarm: bool = True, outside: bool = False) -> Any:
    """Verdicts that name some sensors in some rows."""
    hits = np.zeros(ROWS, bool)
    hits[rows] = True
    named = np.zeros((ROWS, SENSORS), bool)
    named[np.ix_(hits, list(names))] = True
    return scores.Found(hits & alarm, named, hits & outside)


@pytest.mark.parametrize(
    ("verdict", "what", "is_found"),
    [
        (dict(rows=slice(105, 107), names=(1,)), "named right", True),
        (dict(rows=slice(105, 106), names=(1,)), "missed", False),  # one row of twenty may be chance
        (dict(rows=slice(120, 122), names=(1,)), "named right", True),  # two rows late
        (dict(rows=slice(123, 140), names=(1,)), "missed", False),
        (dict(rows=slice(105, 110), names=(2,)), "named wrong", True),
        (dict(rows=slice(105, 110), names=(1, 2)), "named wrong", True),  # a healthy one as well
        (dict(rows=slice(105, 110), names=()), "undecided", True),
        (dict(rows=slice(105, 110), names=(), alarm=False, outside=True), "undecided", False),
        (dict(rows=slice(0, 100), names=(1,)), "missed", False),
    ],
)
def test_an_event_is_named_right_or_wrong_undecided_or_missed(
    scores: ModuleType, verdict: dict[str, Any], what: str, is_found: bool
) -> None:
    of = found(scores, verdict.pop("rows"), *verdict.pop("names"), **verdict)
    made = scores.outcome(scores.Event(0, FIRST, LAST, 1, "bias"), judged(), of)
    assert (made.outcome, made.found) == (what, is_found)


def test_a_row_that_names_another_labelled_sensor_says_nothing_of_this_one(scores: ModuleType) -> None:
    event, of = scores.Event(0, FIRST, LAST, 1, "bias"), found(scores, slice(105, 110), 0)
    assert scores.outcome(event, judged(), of).outcome == "named wrong"
    assert scores.outcome(event, judged(s0=1), of).outcome == "missed"


def test_operation_outside_finds_a_fault_of_the_process_and_names_nothing(scores: ModuleType) -> None:
    event = scores.Event(0, FIRST, LAST, -1, scores.PROCESS)
    one = judged(s1=0)
    made = scores.outcome(event, one, found(scores, slice(103, 110), alarm=False, outside=True))
    assert (made.outcome, made.found, made.delay) == ("undecided", True, 3)
    assert scores.outcome(event, one, found(scores, slice(103, 110), 2)).outcome == "named wrong"


def test_labels_and_alarms_that_are_close_are_one(scores: ModuleType) -> None:
    one, recorded = judged(), SimpleNamespace(kinds=("bias", "drift"))
    one.label[130, 1], one.label[160, 1], one.label[161, 1] = 1, 1, 2
    recorded.judged = [one]
    assert [e[1:] for e in scores.events_of(recorded)] == [(100, 130, 1, "bias"), (160, 160, 1, "bias"), (161, 161, 1, "drift")]
    false = found(scores, slice(10, 20), 0)
    false.alarm[30] = false.alarm[60] = True
    assert scores.rates([one], [false]) == (ROWS, 12 / ROWS, 0.0, 2)


def test_an_alarm_that_names_only_a_sensor_without_a_reading_does_not_count(scores: ModuleType) -> None:
    one, of = judged(), found(scores, slice(10, 20), 0)
    one.log.y[:, 0] = np.nan
    assert scores.rates([one], [of]).alarm == 0
    of.named[15, 2] = True
    assert scores.rates([one], [of]).alarm == 1 / ROWS
