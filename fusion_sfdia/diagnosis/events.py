"""From Decisions of one run to events, and events in words: sensors, process or model, or no decision between hypotheses."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.common.errors import warn_renamed
from fusion_sfdia.detectors.detector import SHOWN_BY, Decision, Detector, ProcessHypothesis

Array = NDArray[Any]

MOST_NAMES = 4  # in a sentence
LASTING = 3  # samples
TOGETHER = 20  # samples: findings less far apart may be of one fault, as spikes and noise raise many
REPLACED = 2  # samples
STAYS = 0.5  # of a size: a sensor that is named again with less has another fault
CERTAIN = 0.95  # a confidence below is stated
NO_FAULT = "no fault"
EVEN = 0.5  # a confidence below which it is rather something else
NEVER_MOVED = " (never moved when healthy)"  # ends the name of a sensor in that of the hypothesis


@dataclass(frozen=True)
class Event:
    """A sensor that is isolated, silent or frozen from start to end (s).

    Attributes
    ----------
    hypothesis : str
        The name of the sensor.
    start : float
        In s.
    end : float
        In s.
    size : float
        Of the fault, in the sensor's unit.
    unit : str
        Of the size.
    open : bool
        Whether it still acts at the end of the data.
    fault : str
        Its kind, see `fault_kinds`; "" where it is not known.
    low, high : float
        95 % interval of the size; NaN where not known.
    sigmas : float
        The size over the sigma of the sensor's noise; NaN where not known.
    confidence : float
        Probability that it is this sensor and not another; NaN where not known.
    alternatives : tuple of str
        The other hypotheses that could not be excluded when it was isolated.
    fault_alternatives : tuple of str
        Kinds that the fault may be as well.

    Examples
    --------
    >>> from fusion_sfdia.events import Event
    >>> event = Event("l1", 300.0, 500.0, 0.08, "m", open=False, fault="bias")
    >>> event.kind, event.end - event.start
    ('sensor', 200.0)
    """

    kind: ClassVar[str] = "sensor"
    hypothesis: str
    start: float
    end: float
    size: float
    unit: str
    open: bool
    fault: str = field(default="", kw_only=True)
    low: float = field(default=math.nan, kw_only=True)
    high: float = field(default=math.nan, kw_only=True)
    sigmas: float = field(default=math.nan, kw_only=True)
    confidence: float = field(default=math.nan, kw_only=True)
    alternatives: tuple[str, ...] = field(default=(), kw_only=True)
    fault_alternatives: tuple[str, ...] = field(default=(), kw_only=True)

    def __str__(self) -> str:
        return self.summary(Clock())

    def summary(self, clock: Clock) -> str:
        """The event in words, with the times of a clock.

        Parameters
        ----------
        clock : Clock
            Of the log.

        Returns
        -------
        str
            In one line.
        """
        end = "end of the log" if self.open else clock.at(self.end)
        doubts = [f"confidence {self.confidence:.2f}"] if self.confidence < CERTAIN else []
        doubts += [f"not excluded: {listed(self.alternatives)}"] if self.alternatives else []
        return "; ".join([f"{self.hypothesis}: {clock.at(self.start)} to {end}, {self.extent}", *doubts])

    def told(self, clock: Clock) -> str:
        """The former name of `summary`.

        Parameters
        ----------
        clock : Clock
            As of `summary`.

        Returns
        -------
        str
            As of `summary`.
        """
        warn_renamed("Event.told", "Event.summary")
        return self.summary(clock)

    def fields(self, clock: Clock) -> dict[str, Any]:
        """For programs: its kind, its fields by name, and its times by ISO 8601, None where the clock has no start.

        Parameters
        ----------
        clock : Clock
            Of the log.

        Returns
        -------
        dict of str to any
            By the names of the attributes, with kind, start_time and end_time.
        """
        return {"kind": self.kind, **asdict(self), "start_time": clock.iso(self.start), "end_time": clock.iso(self.end)}

    def statement(self, when: str, words: Mapping[str, object]) -> str:
        """What a technician is told of an event of its own kind; "" where its kind, size and suspects are all there is to tell.

        Parameters
        ----------
        when : str
            From when to when, in words.
        words : mapping of str
            What each hypothesis is called.

        Returns
        -------
        str
            Sentences.
        """
        return ""

    @property
    def extent(self) -> str:
        """Kind and size in words."""
        kind = " or ".join([self.fault, *self.fault_alternatives])
        if not math.isfinite(self.size):
            return kind or "size unknown"
        size = with_unit(f"{kind or 'size'} {self.size:.4g}", self.unit)
        if not math.isfinite(self.low):
            return size
        return f"{size} ({self.low:.4g} to {self.high:.4g}), {abs(self.sigmas):.3g} sigma"

    @property
    def period(self) -> str:
        """When, in words."""
        return self.when(Clock())

    def when(self, clock: Clock) -> str:
        """When, in words, with the times of a clock.

        Parameters
        ----------
        clock : Clock
            Of the log.

        Returns
        -------
        str
            A part of a sentence.
        """
        if self.open:
            return f"since {clock.at(self.start)}"
        return (
            f"at {clock.at(self.start)}" if self.start == self.end else f"from {clock.at(self.start)} to {clock.at(self.end)}"
        )


@dataclass(frozen=True)
class OtherEvent(Event):
    """Another hypothesis than a sensor that a detector isolates; it has no unit."""

    kind: ClassVar[str] = "other"


@dataclass(frozen=True)
class ProcessEvent(Event):
    """A process hypothesis that is accepted from start to end (s).

    Attributes
    ----------
    size : float
        How far the process is above the model, a median over the event, in the unit of the hypothesis.
    sd : float
        The standard deviation of the size, a median over the event, in the same unit.
    nominal : float
        The value of the model, in the same unit; NaN where there is none.

    Notes
    -----
    The other attributes are those of `Event`.

    Examples
    --------
    >>> from fusion_sfdia.events import ProcessEvent
    >>> event = ProcessEvent("outlet_1", 300.0, 500.0, -6e-5, "m2.5/s", open=False, sd=1e-5, nominal=6e-4)
    >>> event.kind, event.difference
    ('process', 'outlet_1 10 % +- 2 below the model')
    """

    kind: ClassVar[str] = "process"
    sd: float
    nominal: float

    def summary(self, clock: Clock) -> str:
        """The event in words, with the times of a clock.

        Parameters
        ----------
        clock : Clock
            Of the log.

        Returns
        -------
        str
            In one line.
        """
        return f"{self.difference} {self.when(clock)}: not a sensor"

    @property
    def difference(self) -> str:
        """How far the process is from the model, in percent of the nominal value where that is not 0."""
        share = np.isfinite(self.nominal) and self.nominal != 0
        scale, unit = (100.0 / abs(self.nominal), "%") if share else (1.0, self.unit)
        size, sd = with_spread(abs(self.size) * scale, self.sd * scale)
        return f"{self.hypothesis} {with_unit(size, unit)} +- {sd} {'below' if self.size < 0 else 'above'} the model"


@dataclass(frozen=True)
class UnnamedEvent(Event):
    """From start to end (s) readings differ from the model as neither one sensor nor one of its unknowns explains."""

    kind: ClassVar[str] = "process"

    def summary(self, clock: Clock) -> str:
        """The event in words, with the times of a clock."""
        return f"process {self.when(clock)}: no single sensor and no single unknown of the model explains the readings"

    def statement(self, when: str, words: Mapping[str, object]) -> str:
        """What a technician is told."""
        fit = "has not fitted" if self.open else "did not fit"
        return (
            f"The process {fit} the model {when}; no single sensor or cause explains the readings. Check how the plant is "
            "being run, and its inputs."
        )


@dataclass(frozen=True)
class GroupEvent(Event):
    """From start to end (s) several readings moved together as never in the healthy logs: the process.

    most: the channels that are furthest off.
    """

    kind: ClassVar[str] = "process"
    most: tuple[str, ...] = ()

    def summary(self, clock: Clock) -> str:
        """The event in words, with the times of a clock."""
        by = f", most: {listed(self.most)}" if self.most else ""
        return f"process {self.when(clock)}: readings that move together as never in the healthy logs{by}; no sensor alone"

    def statement(self, when: str, words: Mapping[str, object]) -> str:
        """What a technician is told."""
        moved, most = "have moved" if self.open else "moved", [str(words.get(name) or name) for name in self.most]
        by = f", {listed(most)} most of all" if most else ""
        return (
            f"Readings {moved} together {when} as never in the healthy logs{by}; no sensor alone explains that. Check how the "
            "plant is being run."
        )


@dataclass(frozen=True)
class OperationEvent(Event):
    """From start to end (s) operation was as in no healthy log, so that what looks wrong may be right."""

    kind: ClassVar[str] = "outside"

    def summary(self, clock: Clock) -> str:
        """The event in words, with the times of a clock."""
        return f"{self.hypothesis} {self.when(clock)}: what looks wrong may be right there"

    def statement(self, when: str, words: Mapping[str, object]) -> str:
        """What a technician is told."""
        return (
            f"Operation {when} {'has been' if self.open else 'was'} unlike any healthy log; readings that look wrong may be "
            "right. Check whether it was intended; if so, learn from it."
        )


@dataclass(frozen=True)
class RecorderEvent(Event):
    """From start to end (s) several sensors stopped in the same row: the recorder, or its link."""

    kind: ClassVar[str] = "outside"

    def summary(self, clock: Clock) -> str:
        """The event in words, with the times of a clock."""
        return f"recorder stopped {self.when(clock)}: several sensors repeat or miss their readings since the same row"

    def statement(self, when: str, words: Mapping[str, object]) -> str:
        """What a technician is told."""
        did = "have repeated or missed" if self.open else "repeated or missed"
        return f"Several sensors {did} their readings {when}, all from the same row on. Check the recorder and its link."


@dataclass(frozen=True)
class StillEvent(Event):
    """A sensor that never moved in the healthy logs moved from start to end (s), by size."""

    kind: ClassVar[str] = "outside"

    def summary(self, clock: Clock) -> str:
        """The event in words, with the times of a clock."""
        return f"{self.hypothesis} moved {self.when(clock)}, by {with_unit(f'{self.size:.4g}', self.unit)}; never when healthy"

    def statement(self, when: str, words: Mapping[str, object]) -> str:
        """What a technician is told."""
        sensor, size = self.hypothesis.removesuffix(NEVER_MOVED), with_unit(f"{abs(self.size):.3g}", self.unit)
        name = str(words.get(sensor) or sensor)
        moved = "has moved" if self.open else "moved"
        return (
            f"{name[:1].upper()}{name[1:]} {moved} by {size} {when}, which it never did in the healthy logs. Check it on site."
        )


@dataclass(frozen=True)
class UndecidedEvent(Event):
    """An alarm from start to end (s) that no hypothesis explains clearly better than others; it has no size.

    Attributes
    ----------
    suspects : tuple of str
        The names of those that stood together longest, the most probable first.

    Notes
    -----
    The other attributes are those of `Event`.

    Examples
    --------
    >>> from math import nan
    >>> from fusion_sfdia.events import UndecidedEvent
    >>> event = UndecidedEvent("l1 or inflow", 300.0, 500.0, nan, "", open=False, suspects=("l1", "inflow"))
    >>> event.kind
    'undecided'
    """

    kind: ClassVar[str] = "undecided"
    suspects: tuple[str, ...]

    def summary(self, clock: Clock) -> str:
        """The event in words, with the times of a clock.

        Parameters
        ----------
        clock : Clock
            Of the log.

        Returns
        -------
        str
            In one line.
        """
        return f"{unsure(self.suspects)}, {self.when(clock)}"


def events_of(detector: Detector, t: Array, decisions: Decision, gap: int) -> tuple[Event, ...]:
    """Events of Decisions (K, ...) at times t (K,) s: the process first, then what is undecided, then sensors and others; of
    each in order of their start.

    Events of one hypothesis less than `gap` samples apart are one.
    """
    sensors = detector.plant.sensors
    found: list[Event] = []
    for i, name in enumerate(detector.hypotheses):
        kind, unit = (Event, sensors[i].unit) if i < len(sensors) else (OtherEvent, "")
        for a, b in spans(decisions.isolated[:, i], gap):
            size, fault = median(decisions.fault_size[a : b + 1, i]), ""
            if decisions.shown_by is not None:
                held = decisions.shown_by[a : b + 1, i][decisions.isolated[a : b + 1, i]]
                fault = SHOWN_BY[Counter(held.tolist()).most_common(1)[0][0]]
            found.append(kind(name, *_when(t, a, b), size if not fault else np.nan, unit, b == len(t) - 1, fault=fault))
    found.sort(key=lambda e: (e.start, e.hypothesis))
    tested = detector.process_hypotheses
    names = (*detector.hypotheses, *(h.name for h in tested))
    return (*_process(tested, t, decisions, gap), *_undecided(names, t, decisions, gap), *found)


def _process(tested: Sequence[ProcessHypothesis], t: Array, decisions: Decision, gap: int) -> list[Event]:
    if decisions.process is None or decisions.process_size is None or decisions.process_sd is None:
        return []
    found: list[Event] = []
    for j, h in enumerate(tested):
        for a, b in spans(decisions.process[:, j], gap):
            if not h.has_size:
                known = {"outside": OperationEvent, "recorder": RecorderEvent, "together": GroupEvent}
                kind = known.get(h.kind, UnnamedEvent)
                found.append(kind(h.name, *_when(t, a, b), float("nan"), "", b == len(t) - 1))
                continue
            if h.kind == "still":
                size = median(decisions.process_size[a : b + 1, j])
                found.append(StillEvent(h.name, *_when(t, a, b), size, h.unit, b == len(t) - 1))
                continue
            size, sd = (median(values[a : b + 1, j]) for values in (decisions.process_size, decisions.process_sd))
            found.append(ProcessEvent(h.name, *_when(t, a, b), size, h.unit, b == len(t) - 1, sd, h.nominal))
    return sorted(found, key=lambda e: (e.start, e.hypothesis))


def _undecided(names: Sequence[str], t: Array, decisions: Decision, gap: int) -> list[Event]:
    if decisions.suspect is None:
        return []
    found: list[Event] = []
    for a, b in spans(np.any(decisions.suspect, axis=-1), gap):
        sets = [tuple(np.flatnonzero(held).tolist()) for held in decisions.suspect[a : b + 1] if np.any(held)]
        chosen = list(Counter(reversed(sets)).most_common(1)[0][0])  # the later one at a tie
        known = np.zeros((1, len(names))) if decisions.probability is None else decisions.probability[a : b + 1]
        likely = np.nan_to_num(known).mean(axis=0)
        suspects = tuple(names[i] for i in sorted(chosen, key=lambda i: -likely[i]))
        when = _when(t, a, b)
        found.append(UndecidedEvent(" or ".join(suspects), *when, float("nan"), "", b == len(t) - 1, suspects))
    return found


def _when(t: Array, a: int, b: int) -> tuple[float, float]:
    return float(t[a]), float(t[b])


def verdict(events: Sequence[Event], t: Array) -> str:
    """What the events of readings at times t (K,) say together, in the order of findings: sensors, process or model, what is
    undecided, or no fault.
    """
    parts = []
    likely = [e for e in events if not e.confidence < EVEN]
    for kind, word in (("sensor", "sensor"), ("other", "fault")):
        if named := [e.hypothesis for e in likely if e.kind == kind]:
            parts.append(f"{word}{'s' * (len(set(named)) > 1)} {listed(named)}")
    if process := [e.hypothesis for e in events if e.kind == "process" and not sensors_instead(e, events, t)]:
        parts.append(f"process or model: {listed(process)}")
    if outside := [e.hypothesis for e in events if e.kind == "outside"]:
        parts.append(f"outside what was learnt: {listed(outside)}")
    for suspects in dict.fromkeys(e.suspects for e in open_questions(events, t)):
        parts.append(unsure(suspects))
    known = {e.hypothesis for e in likely}
    if others := [e.hypothesis for e in events if e.confidence < EVEN and e.hypothesis not in known]:
        parts.append(f"perhaps {listed(others)}")
    return "; ".join(parts) or NO_FAULT


def unsure(suspects: Sequence[str]) -> str:
    """What an alarm that no hypothesis explains clearly may be."""
    return f"perhaps {suspects[0]}" if len(suspects) == 1 else f"cannot tell: {listed(suspects, ' or ')}"


def open_questions(events: Sequence[Event], t: Array) -> list[UndecidedEvent]:
    """What the readings at times t (K,) leave undecided.

    Not an alarm that ends within LASTING samples, as noise may raise one; nor one of whose suspects one is isolated or accepted
    while it lasts or in the sample after.
    """
    found = []
    for e in events:
        if isinstance(e, UndecidedEvent):
            first, last = np.searchsorted(t, (e.start, e.end))
            after = t[min(last + 1, len(t) - 1)]
            decided = any(o.hypothesis in e.suspects and o.start <= after and o.end >= e.start for o in events)
            if not decided and (e.open or last - first >= LASTING - 1):
                found.append(e)
    return found


def sensors_instead(e: Event, events: Iterable[Event], t: Array) -> tuple[Event, ...]:
    """The sensors that were named in the place of an event of the process; none where it was not taken back.

    Two faults that begin together may look at first as one change of the process. A detector that sees later that they are two
    names both sensors when it withdraws the change, at most `REPLACED` samples after its end.
    """
    if e.kind != "process" or e.open:
        return ()
    last = int(np.searchsorted(t, e.end))
    reach = float(t[min(last + REPLACED, len(t) - 1)])
    found = tuple(o for o in events if o.kind == "sensor" and e.end < o.start <= reach)
    return found if len({o.hypothesis for o in found}) > 1 else ()


def follow_ups(e: Event, events: Iterable[Event], t: Array) -> tuple[Event, ...]:
    """The findings after an event of a sensor that may be the same fault under another name, in order of their start.

    These are those of which it is a suspect or an alternative, those of the process or of operation, and the next event of the
    sensor itself, which is the last: findings that last longer than the event, and begin at most TOGETHER samples after it, or
    after such a finding, or after one that is undecided between others. Without any, the fault is over. Of an event of the
    process: `sensors_instead`.
    """
    if e.kind != "sensor":
        return sensors_instead(e, events, t)

    def until(end: float) -> float:
        return float(t[min(int(np.searchsorted(t, end)) + TOGETHER, len(t) - 1)])

    reach, found = until(e.end), list[Event]()
    for o in sorted((o for o in events if o.end > e.end), key=lambda o: o.start):
        if o.start > reach:
            break
        suspects = o.suspects if isinstance(o, UndecidedEvent) else (o.hypothesis, *o.alternatives)
        if isinstance(o, UndecidedEvent) and not o.open and np.sum((t >= o.start) & (t <= o.end)) < LASTING:
            continue  # as noise may raise one
        if e.hypothesis in suspects or o.kind in ("process", "outside"):
            found.append(o)
            if o.hypothesis == e.hypothesis:
                break
        elif o.kind != "undecided":
            continue
        reach = max(reach, until(o.end))
    return tuple(found)


def continued(events: Sequence[Event], t: Array) -> tuple[Event, ...]:
    """The events with those of a sensor as one that are of one bias or drift, at times t (K,).

    These are two of which the second is among the `follow_ups` of the first with another finding in between, so that the alarm
    has not ended, is to the same side and at least `STAYS` as large. The one event has the size of the second, and takes the
    place of what was found in between without a name, several readings that moved together, this one among the most, or a
    process that did not fit: the sensor explains it. The first of less than LASTING samples may be of spikes as well: so few
    show no kind.
    """
    found = list(events)
    for e in sorted((e for e in events if e.kind == "sensor"), key=lambda e: e.start, reverse=True):
        *between, last = follow_ups(e, found, t) or (e,)
        brief = e.fault == "spikes" and np.searchsorted(t, e.end) - np.searchsorted(t, e.start) < LASTING - 1
        lasting = last.kind == "sensor" and last.fault in ("bias", "drift") and (brief or e.fault in ("bias", "drift"))
        if not (between and lasting and last.hypothesis == e.hypothesis and last.size * np.sign(e.size) >= STAYS * abs(e.size)):
            continue
        fault = "drift" if "drift" in (e.fault, last.fault) else last.fault
        sure = e if e.confidence > last.confidence else last
        one = replace(
            last, start=e.start, fault=fault, confidence=sure.confidence, alternatives=sure.alternatives,
            fault_alternatives=tuple(kind for kind in last.fault_alternatives if kind != fault),
        )  # fmt: skip
        same = [
            o
            for o in between
            if o.end <= last.start and (isinstance(o, UnnamedEvent) or (isinstance(o, GroupEvent) and e.hypothesis in o.most))
        ]
        gone = set(map(id, (last, *same)))
        found = [one if o is e else o for o in found if id(o) not in gone]
    return tuple(found)


def answered(e: Event, events: Iterable[Event]) -> bool:
    """Whether an alarm was undecided only while one of its suspects was named, as its fault began before and ended after."""
    return isinstance(e, UndecidedEvent) and any(
        o.hypothesis in e.suspects and o.start <= e.start and e.end <= o.end and not o.confidence < EVEN for o in events
    )


def throughout(events: Sequence[Event], t: Array) -> list[str]:
    """The sensors that are off from the first of the readings at t (K,), or LASTING samples after, to the last.

    A frozen or silent sensor is not among them: what it lacks is no question of units.
    """
    early = t[min(LASTING, len(t) - 1)]
    named = [e for e in events if e.kind == "sensor" and e.fault not in ("freeze", "dropout")]
    return [e.hypothesis for e in named if e.open and e.start <= early < e.end]


def listed(names: Sequence[str], between: str = ", ", most: int = MOST_NAMES) -> str:
    """Names in a sentence, each once, of many the first few."""
    once = list(dict.fromkeys(names))
    more = len(once) - most
    return between.join(once) if more < 2 else f"{between.join(once[:most])}{between}{more} more"


def with_unit(value: str, unit: str) -> str:
    """A value as text with its unit, which a pure number has not."""
    return value if unit in ("", "1") else f"{value} {unit}"


def with_spread(value: float, sd: float) -> tuple[str, str]:
    """A value and its standard deviation as text, to the first digit of the latter, or the second after a 1."""
    if not (math.isfinite(value) and math.isfinite(sd) and sd > 0):
        return f"{value:.3g}", f"{sd:.3g}"
    places = -math.floor(math.log10(sd))
    places += round(sd, places) < 2 * 10.0**-places  # of 0.0149 and 1.49 the second digit, too
    if not -6 < places < 6:
        return f"{value:.3g}", f"{sd:.1g}"
    return f"{round(value, places):.{max(places, 0)}f}", f"{round(sd, places):.{max(places, 0)}f}"


def spans(held: Array, gap: int = 1) -> list[tuple[int, int]]:
    """Return first and last index of each run of True in held (K,); runs less than `gap` samples apart are joined."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(int)))
    joined: list[tuple[int, int]] = []
    for a, b in zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True):
        if joined and a - joined[-1][1] - 1 < gap:
            joined[-1] = (joined[-1][0], b)
        else:
            joined.append((a, b))
    return joined


def median(sizes: Array) -> float:
    """The median of the numbers that are finite, NaN without any."""
    known = sizes[np.isfinite(sizes)]
    return float(np.median(known)) if known.size else float("nan")
