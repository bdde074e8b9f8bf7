"""What was found in the words of those who look after the plant: one sentence an event, and what to check.

The report, the command line, its JSON and `watch` take their sentences from here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.detector import Detector, ProcessHypothesis
from fusion_sfdia.detectors.verdicts import Verdict
from fusion_sfdia.diagnosis.events import (
    CERTAIN,
    EVEN,
    Event,
    GroupEvent,
    OtherEvent,
    ProcessEvent,
    UndecidedEvent,
    UnnamedEvent,
    with_unit,
)
from fusion_sfdia.diagnosis.fault_kinds import NORMAL
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import equation_of, error_of

SIDED = ("bias", "drift")  # faults of which too high and too low are two findings
LEAST = 0.05  # of a sensor's sigma: a smaller size is none


class Kind(NamedTuple):
    """A kind of events for people. rank: its place among findings, from 0; verdict: of a log whose first finding it is; word:
    on a page and beside an axis; one, many: when they are counted.
    """

    rank: int
    verdict: Verdict
    word: str
    one: str
    many: str


KINDS = {
    "sensor": Kind(0, Verdict.SENSOR, "sensor", "faulty sensor", "faulty sensors"),
    "other": Kind(1, Verdict.PROCESS, "other fault", "other fault", "other faults"),
    "process": Kind(2, Verdict.PROCESS, "process", "process change", "process changes"),
    "outside": Kind(3, Verdict.OUTSIDE, "not learnt", "unknown operating condition", "unknown operating conditions"),
    "undecided": Kind(4, Verdict.UNDECIDED, "undecided", "unresolved alarm", "unresolved alarms"),
    # any with a confidence below `EVEN`
    "possible": Kind(5, Verdict.UNDECIDED, "possible", "possible fault", "possible faults"),
}

AGREES, PERSISTS = "it reads as expected again", "the error persists"
# kind of a sensor's fault: what it did, what it has done until now, and how that is said to be over or not
FAULTS = {
    "bias": ("read {size}", "has read {size}", AGREES, PERSISTS),
    "drift": ("drifted until it read {size}", "has drifted until it read {size}", AGREES, PERSISTS),
    "freeze": ("was stuck at one value", "has been stuck at one value", "its reading changes again", "it is still stuck"),
    "noise": ("was noisy{by}", "has been noisy{by}", "it is quiet again", "it is still noisy"),
    "spikes": ("had spikes{of}", "has had spikes{of}", "they have stopped", "they continue"),
    "dropout": ("gave no readings", "has given no readings", "its readings are back", "it is still silent"),
}
UNKNOWN = "whether it is over is not known"
SEEN_TO_END = ("freeze", "dropout")  # in the readings, whatever the verdicts after them
CHECKS = {
    "bias": "Check the sensor's wiring or calibration.",
    "drift": "Check the sensor's calibration, and clean it.",
    "freeze": "Check the sensor, its transmitter and its data link.",
    "noise": "Check the sensor's connectors and shielding.",
    "spikes": "Check the sensor's connectors and shielding.",
    "dropout": "Check the sensor's power, wiring and data link.",
}
OF_PROCESS = {
    "parameter": "Check this part of the plant.",
    "input": "Check the actuator and its feedback, and look for leaks in between.",
    "state": "Check for leaks, blockages and flows that are not in the model.",
    "disturbance": "Look for disturbances at this part of the plant.",
}


class Wording(NamedTuple):
    """How people call a sensor or another hypothesis.

    part: "sensor", or the kind of a `ProcessHypothesis`. name: its name, or its tag. meaning: the quantity in words, check:
    what to do where it is wrong, as the plant states them. low, high: the differences from the model that are possible, in its
    unit.
    """

    part: str
    name: str
    meaning: str = ""
    check: str = ""
    low: float = -math.inf
    high: float = math.inf

    def __str__(self) -> str:
        """Within a sentence: "mixed-air temperature TT04", "sensor l1", "the recorded inflow"."""
        meaning = self.meaning if self.meaning[1:2].isupper() else self.meaning[:1].lower() + self.meaning[1:]
        if self.part == "sensor":
            return f"{meaning or 'sensor'} {self.name}"
        return {"input": "the recorded ", "state": "an unmodelled effect on "}.get(self.part, "") + (meaning or self.name)


Words = Mapping[str, Wording]


def wordings(detector: Detector) -> dict[str, Wording]:
    """The wording of each hypothesis of a detector, by its name."""
    return words_of(detector.plant, detector.process_hypotheses)


def words_of(plant: Plant, tested: Iterable[ProcessHypothesis]) -> dict[str, Wording]:
    """The wording of each sensor of a plant, and of each hypothesis about the process, by its name."""
    found = {s.name: Wording("sensor", s.name, s.meaning, s.check) for s in plant.sensors}
    parameters = {p.name: p for p in plant.uncertainty.parameters}
    inputs, states = {error_of(s.name): s for s in plant.inputs}, {equation_of(s.name): s for s in plant.states}
    for h in tested:
        if p := parameters.get(h.name):
            found[h.name] = Wording(h.kind, p.name, p.meaning, p.check, p.low - p.nominal, p.high - p.nominal)
        elif s := inputs.get(h.name):
            found[h.name] = Wording(h.kind, s.name, s.meaning, s.check, s.low - s.high, s.high - s.low)
        elif s := states.get(h.name):
            found[h.name] = Wording(h.kind, s.name, s.meaning, s.check)
        else:
            found[h.name] = Wording(h.kind, h.name)
    return found


def kind_of(e: Event) -> Kind:
    """The kind of an event for people."""
    return KINDS["possible" if e.confidence < EVEN else e.kind]


def sentence(e: Event, words: Words, clock: Clock, *, ended: bool = True, after: Sequence[Event] = ()) -> str:
    """An event in a sentence, and one on what to do: "Mixed-air temperature TT04 read 1.5 K (1.3 to 1.7) too high from
    2026-03-01 02:07 to 03:59; it reads as expected again. Check the sensor's wiring or calibration."

    ended: whether an event that is closed has been seen to end, rather than the rows or the detector. after: its `follow_ups`,
    which may be the same fault under another name: it is over without them only, unless that is seen in the readings, of a
    sensor that was frozen or silent. An impossible size, beyond the limits that the plant states, or one that rounds to none,
    is left out.
    """
    when = f"since {clock.wall(e.start)}" if e.open else clock.span(e.start, e.end)
    if own := e.statement(when, words):
        return own
    if isinstance(e, UndecidedEvent):
        return _undecided(e, words, when)
    if isinstance(e, ProcessEvent):
        w = words.get(e.hypothesis) or Wording("parameter", e.hypothesis)
        return _taken_back(w, words, when, after) if after else _process(e, w, when)
    if e.kind != "sensor" or isinstance(e, OtherEvent):
        return f"{_first(e.summary(clock))}."
    now = _now(e, words, clock, ended, after)
    return _sensor(e, words.get(e.hypothesis) or Wording("sensor", e.hypothesis), words, when, now)


def by_importance(events: Sequence[Event], passing: Sequence[Event] = ()) -> list[Event]:
    """Events, the most important first: sensors, the process, what was not learnt, what is undecided, and last what is
    improbable, or `passing`; of each what is certain, then what still acts, then the largest, and the longest of unknown sizes.
    """
    ended = set(map(id, passing))

    def key(e: Event) -> tuple[bool, int, bool, bool, float, float, float]:
        size = abs(e.sigmas) if math.isfinite(e.sigmas) else 0.0
        return (id(e) in ended, kind_of(e).rank, e.confidence < CERTAIN, not e.open, -size, e.start - e.end, e.start)

    return sorted(events, key=key)


def alike(events: Sequence[Event]) -> list[list[Event]]:
    """Events that are the same but for their times and sizes together, in the order of the first of each."""
    groups: dict[tuple[str, str, str, bool], list[Event]] = {}
    for e in events:
        groups.setdefault((e.kind, e.hypothesis, e.fault, e.fault in SIDED and e.size < 0), []).append(e)
    return list(groups.values())


def counted(events: Sequence[Event]) -> str:
    """How many of each kind, each hypothesis once: "2 faulty sensors, 1 process change, 1 unresolved alarm"."""
    names: dict[Kind, set[str]] = {}
    for e in by_importance(events):
        names.setdefault(kind_of(e), set()).add(e.hypothesis)
    return ", ".join(f"{len(of)} {kind.many if len(of) > 1 else kind.one}" for kind, of in names.items())


def size_of(e: Event, words: Words) -> str:
    """The size of an event in words with its 95 % interval, "1.5 K (1.3 to 1.7)"; "" where it has none that can be."""
    if isinstance(e, ProcessEvent):
        return _difference(e, words.get(e.hypothesis) or Wording("parameter", e.hypothesis))
    if not math.isfinite(e.size) or e.size == 0 or abs(e.sigmas) < LEAST:
        return ""
    sign = math.copysign(1.0, e.size)
    return _measured(abs(e.size), sign * e.low, sign * e.high, e.unit)


def confidence_of(e: Event) -> str:
    """How probable it is that it is this hypothesis rather than another, as text; "" where it is not known."""
    if not math.isfinite(e.confidence):
        return ""
    return "> 99 %" if e.confidence > 0.99 else f"{100 * e.confidence:.0f} %"


def others_of(e: Event, words: Words) -> list[str]:
    """What else it may be, in words."""
    return [str(words.get(name) or name) for name in e.alternatives]


def _sensor(e: Event, w: Wording, words: Words, when: str, now: str) -> str:
    closed, acts, _, _ = FAULTS.get(e.fault, FAULTS["bias"])
    size, side = size_of(e, words), "too high" if e.size > 0 else "too low"
    off = f"{size} {side}"
    if not size and e.fault in ("", "bias"):
        closed, acts = "gave wrong readings", "has given wrong readings"
    elif not size and e.fault == "drift":
        closed, acts = "drifted", "has drifted"
    did = (acts if e.open else closed).format(
        size=off, by=f", by a standard deviation of {size}," if size else "", of=f" of {size}" if size else ""
    )
    doubt = "perhaps " if e.confidence < EVEN else "probably " if e.confidence < CERTAIN else ""
    instead = f" It may be {_either(others_of(e, words))} instead." if doubt and e.alternatives else ""
    check = _stop(w.check) or CHECKS.get(e.fault, CHECKS["bias"])
    return f"{_first(str(w))} {doubt}{did} {when}; {now}.{instead} {check}"


def _now(e: Event, words: Words, clock: Clock, ended: bool, after: Sequence[Event]) -> str:
    """Whether the fault of a sensor is over, in a part of a sentence."""
    _, _, over, stays = FAULTS.get(e.fault, FAULTS["bias"])
    if e.open:
        return stays
    if not after or (ended and e.fault in SEEN_TO_END):
        return over if ended else UNKNOWN
    first, last = after[0], max(after, key=lambda o: (o.hypothesis == e.hypothesis, o.open, o.end))
    goes_on = last.open or last.hypothesis == e.hypothesis
    parts = [_follow_up(o, e.hypothesis, words, clock) for o in ([first] if last is first or not goes_on else [first, last])]
    then = f"after {clock.wall(last.end)} {over}" if ended else UNKNOWN
    return ", and ".join(parts if goes_on else [*parts, then])


def _follow_up(o: Event, sensor: str, words: Words, clock: Clock) -> str:
    """A finding after the event of a sensor, which may be the same fault, in a part of a sentence."""
    when, open_ = f"since {clock.wall(o.start)}" if o.open else clock.span(o.start, o.end), o.open
    if o.hypothesis == sensor:
        return f"it {'has been' if open_ else 'was'} wrong again {when}"
    if isinstance(o, UndecidedEvent):
        names = ["it", *(str(words.get(name) or name) for name in o.suspects if name != sensor)]
        if sensor not in o.suspects or len(names) == 1:
            return f"it may {'still be' if open_ else 'still have been'} wrong {when}"
        cannot, is_ = ("cannot", "is") if open_ else ("could not", "was")
        return f"{when} it {cannot} be told whether {_either(names)} {is_} at fault"
    if o.kind == "outside":
        return f"{when} operation {'has been' if open_ else 'was'} unlike any healthy log"
    if isinstance(o, GroupEvent):
        return f"{when} readings {'have moved' if open_ else 'moved'} together as never before"
    if isinstance(o, UnnamedEvent):
        return f"{when} the process {'has not fitted' if open_ else 'did not fit'} the model"
    w = words.get(o.hypothesis) or Wording("sensor" if o.kind == "sensor" else "parameter", o.hypothesis)
    if w.part == "sensor":
        return f"{when} {w} {'has been' if open_ else 'was'} taken to be at fault"
    cause = {"input": "an error of ", "parameter": "a change of "}.get(w.part, "")
    return f"{when} {cause}{w} {'has explained' if open_ else 'explained'} the readings"


def _taken_back(w: Wording, words: Words, when: str, instead: Sequence[Event]) -> str:
    """A change of the process in whose place sensors were named."""
    names = dict.fromkeys(str(words.get(o.hypothesis) or o.hypothesis) for o in instead)
    return f"{_first(str(w))} seemed to be the cause {when}; faults of {' and '.join(names)} explain the readings better."


def _process(e: ProcessEvent, w: Wording, when: str) -> str:
    size, side = _difference(e, w), "below" if e.size < 0 else "above"
    been, name = "has been" if e.open else "was", w.meaning or w.name
    name = f"{name} ({w.name})" if w.part == "input" and w.meaning else name
    if w.part == "input":
        differs = f"{been} {size} {side} the recorded one" if size else f"{been} different from the recorded one"
        said = f"{name}: the actual value {differs}"
    elif w.part in ("state", "disturbance"):
        moved = f"{'has ' if e.open else ''}{'lowered' if e.size < 0 else 'raised'}"
        acted = f"{name} {'has acted' if e.open else 'acted'} on the plant"
        said = f"something that the model leaves out {moved} {name}" if w.part == "state" else acted
    elif size and e.nominal == 0:
        said = f"{name} {been} {size}" if e.size > 0 else f"{name} {been} different from the model"
    else:
        said = f"{name} {been} {size} {side} its value in the model" if size else f"{name} {been} different from the model"
    check = _stop(w.check) or OF_PROCESS.get(w.part, OF_PROCESS["parameter"])
    return f"{_first(said)} {when}; no single sensor fault explains this. {check}"


def _undecided(e: UndecidedEvent, words: Words, when: str) -> str:
    names = [str(words.get(name) or name) for name in e.suspects]
    of_start = {str(w) for name in e.suspects if (w := words.get(name)) and w.part == "since start"}
    if of_start:
        others, have = _either([name for name in names if name not in of_start]), "has" if e.open else "had"
        return (
            f"{_first(others)} {have} differed from the model from the first rows on ({when}): either is wrong, and no reading "
            "from before tells which. Check the sensor on site; a model tuned on a healthy log tells them apart."
        )
    if len(names) == 1:
        may = "may have been" if e.open else "may briefly have been"
        return f"{_first(names[0])} {may} wrong {when}; the evidence is weak. Check it on site."
    do = "have not shown" if e.open else "did not show"
    check = "Check them on site, in this order." if e.open else "Check them on site if it happens again."
    return f"The readings {do} {when} whether {_either(names)} {'is' if e.open else 'was'} at fault. {check}"


def _difference(e: ProcessEvent, w: Wording) -> str:
    """How far the process is from the model, in percent of the nominal value where that is not 0; "" where that cannot be."""
    share = math.isfinite(e.nominal) and e.nominal != 0
    sure = math.isfinite(e.size) and abs(e.size) > (e.sd if math.isfinite(e.sd) else 0.0)
    if not sure or not w.low <= e.size <= w.high or (share and e.size / e.nominal < -1) or w.part in ("state", "disturbance"):
        return ""
    scale, unit = (100.0 / abs(e.nominal), "%") if share else (1.0, e.unit)
    size, sd = abs(e.size) * scale, NORMAL * e.sd * scale
    return _measured(size, size - sd, size + sd, unit)


def _measured(value: float, low: float, high: float, unit: str) -> str:
    """A value with its interval, to the first digit of half of its width, the second where that is 1; alone to three digits."""
    half = abs(high - low) / 2
    if not (math.isfinite(half) and half > 0):
        return with_unit(f"{value:.3g}", unit)
    low, high = min(low, high), max(low, high)
    places = -math.floor(math.log10(half))
    places += half < 1.9 * 10.0**-places
    shown = [_rounded(v, places) for v in (value, low, high)]
    return f"{with_unit(shown[0], unit)} ({shown[1]} to {shown[2]})"


def _rounded(value: float, places: int) -> str:
    """A number to that many decimal places, with a power of ten where it is very small or large."""
    if -6 < places < 5 or value == 0:
        return f"{round(value, places) + 0.0:.{max(places, 0)}f}"
    return f"{value:.{max(0, places + math.floor(math.log10(abs(value))))}e}"


def _either(names: Sequence[str]) -> str:
    return " or ".join(dict.fromkeys(names))


def _first(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


def _stop(text: str) -> str:
    """A text as a sentence."""
    text = _first(text) if text[:2].islower() else text  # not pH
    return text if not text or text[-1] in ".!?" else f"{text}."
