"""How real_logs.py counts: labelled events found and named, and false alarms, of verdicts on the rows of labelled logs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from real_logs_data import Judged, Recorded

Array = NDArray[Any]

JOINED = 16  # rows: labels, and alarms, that are fewer apart are one event
SHARE = 0.1  # of the rows of an event in which a verdict must stand to count: ten times what the promised rate gives by chance
LATE = 2  # rows after an event that belong to it: a spike is seen once the next reading is there
RIGHT, WRONG, UNDECIDED, MISSED = OUTCOMES = ("named right", "named wrong", "undecided", "missed")
PROCESS = "process"


class Found(NamedTuple):
    """What a method says of each row of a log: alarm (K,), sensors named (K, N), operation outside what was learnt (K,)."""

    alarm: Array
    named: Array
    outside: Array


class Event(NamedTuple):
    """A labelled event: rows first to last of log k; the sensor, -1 for the process; the kind as labelled."""

    log: int
    first: int
    last: int
    sensor: int
    kind: str


class Outcome(NamedTuple):
    """What a method made of an event: one of OUTCOMES; found: whether in alarm; delay: rows to the first alarm, NaN without."""

    event: Event
    outcome: str
    found: bool
    delay: float


def spans(hits: Array, joined: int = JOINED) -> Iterator[tuple[int, int]]:
    """First and last rows of the stretches of hits (K,), those fewer rows apart as one."""
    rows = np.flatnonzero(hits)
    for part in np.split(rows, np.flatnonzero(np.diff(rows) > joined) + 1):
        if part.size:
            yield int(part[0]), int(part[-1])


def events_of(recorded: Recorded) -> list[Event]:
    """All labelled events of the judged logs."""
    found = []
    for k, one in enumerate(recorded.judged):
        found += [Event(k, a, b, -1, PROCESS) for a, b in spans(one.process)]
        for i in range(one.label.shape[1]):
            for code, kind in enumerate(recorded.kinds, start=1):
                found += [Event(k, a, b, i, kind) for a, b in spans(one.label[:, i] == code)]
    return found


def counted(one: Judged, found: Found) -> Array:
    """Rows in alarm (K,) but those that name only sensors without a reading: no label says whether those have a fault."""
    there = np.isfinite(one.log.y)
    return np.asarray(found.alarm & ~(found.named.any(axis=1) & ~(found.named & there).any(axis=1)))


def outcome(event: Event, one: Judged, found: Found) -> Outcome:
    """What the verdicts on a log made of one event in it.

    A row is wrong with a sensor that has a reading and no label, right with that of the event and no such one; the event is
    what more of its rows are, else undecided, if in alarm or outside what was learnt. Rows that name only other labelled
    sensors say nothing about this one. A fault of the process is found also where operation is outside what was learnt.
    """
    rows = slice(event.first, event.last + 1 + LATE)
    least = max(1, int(np.ceil(SHARE * (event.last + 1 - event.first))))
    named, label, there = found.named[rows], one.label[rows], np.isfinite(one.log.y[rows])
    alarm, outside = counted(one, found)[rows], found.outside[rows]
    own = named[:, event.sensor] if event.sensor >= 0 else np.zeros(len(named), bool)
    spread = label > 0
    spread[1:] |= spread[:-1]
    spread[1:] |= spread[:-1]  # LATE rows after a label as well
    wrong = (named & ~spread & there).any(axis=1)
    about = alarm & (own | wrong | ~named.any(axis=1))
    hits = about | (outside if event.kind == PROCESS else False)
    is_found = bool(np.sum(hits) >= least)
    right, mistaken = (int(np.sum(which)) for which in (own & alarm & ~wrong, wrong & alarm))
    if right >= least and right >= mistaken:
        what = RIGHT
    elif mistaken >= least:
        what = WRONG
    else:
        what = UNDECIDED if np.sum(about | outside) >= least else MISSED
    return Outcome(event, what, is_found, float(np.argmax(hits)) if is_found else np.nan)


class Rates(NamedTuple):
    """Of the healthy rows: how many, the shares in alarm and outside what was learnt, and how many alarms begin in them."""

    rows: int
    alarm: float
    outside: float
    events: int


def rates(judged: Sequence[Judged], found: Sequence[Found]) -> Rates:
    """False alarms of a method."""
    rows = alarm = outside = events = 0
    for one, verdict in zip(judged, found, strict=True):
        hits = counted(one, verdict)
        rows += int(np.sum(one.healthy))
        alarm += int(np.sum(hits & one.healthy))
        outside += int(np.sum(verdict.outside & one.healthy))
        events += sum(bool(one.healthy[a]) for a, _ in spans(hits))
    return Rates(rows, alarm / rows, outside / rows, events)
