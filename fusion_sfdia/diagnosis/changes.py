"""From the decisions of one row after another to events that open and close, in bounded memory."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.batch_detector import BatchDetector
from fusion_sfdia.detectors.detector import Decision, Detector, stack
from fusion_sfdia.detectors.storage import SavedArrays, whole_numbers
from fusion_sfdia.detectors.verdicts import Conclusion, Verdict
from fusion_sfdia.diagnosis.device_health import DeviceHealth, health_of
from fusion_sfdia.diagnosis.events import Event, events_of, follow_ups
from fusion_sfdia.diagnosis.sensor_events import rivals_at
from fusion_sfdia.diagnosis.sentences import Words, sentence

Array = NDArray[Any]

KEPT = 600  # samples, from which size and kind of an event are taken


class Alarm(NamedTuple):
    """The alarm to which a change belongs, see `Alarms`.

    Attributes
    ----------
    id : int
        1, 2, ...
    new : bool
        Whether the change raises it; otherwise it updates one that was raised before.
    active : bool
        Whether its cause stands after the change.

    Examples
    --------
    >>> from fusion_sfdia.events import Alarm
    >>> Alarm(id=1, new=True, active=True).new
    True
    """

    id: int
    new: bool
    active: bool


class Change(NamedTuple):
    """Something that a row decides, at its time t (s).

    Attributes
    ----------
    id : int
        1, 2, ... in the order of the rows.
    what : str
        "opened", where a hypothesis is isolated, accepted or suspected; "closed", where it is no longer, with the id of the
        opening; "named", where a second look at the last samples states the kind of fault and its size with an interval, or
        states them anew, or, of a detector that learnt without a model, where the event has stood for `gap` samples,
        its size over these; with the id of the opening or, of a sensor that is silent or frozen and not isolated, a new one;
        "health", where the verdict on the model has changed, with the line of `diagnose` as reason; "reset", where the detector
        has started anew, for the stated reason; "blind", where nothing can be judged, for the stated reason, and "sees again",
        where that is over, with the id of "blind".
    t : float
        Time of the row in s.
    event : Event or None
        As `diagnose` has it, with the size at that time, when it opens with confidence and alternatives; None for a reset,
        health and sight.
    reason : str
        In words, of those that have one.
    alarm : Alarm or None
        The alarm to which it belongs; None of a reset and of health.
    after : tuple of Event
        Of an event of a sensor that is closed, the findings since then that may be the same fault; without any it is over.

    Examples
    --------
    >>> from fusion_sfdia import Watch, simulate
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> recording = simulate(plant, 40, seeds=[1])
    >>> y = recording.y[:, 0] + 0.2 * (recording.t > 100)[:, None] * [1.0, 0.0, 0.0, 0.0]
    >>> watch = Watch(CentralFilter(plant, false_alarm=1e-6))
    >>> change = next(watch.events(zip(recording.t, y, recording.u)))
    >>> change.what, change.t, change.event.hypothesis, change.alarm.new
    ('opened', 105.0, 'l1', True)
    """

    id: int
    what: str
    t: float
    event: Event | None = None
    reason: str = ""
    alarm: Alarm | None = None
    after: tuple[Event, ...] = ()

    def sentence(self, words: Words, clock: Clock) -> str:
        """The change in words for people: its reason, or its event as `Diagnosis.sentence` has it.

        Parameters
        ----------
        words : mapping of str to Wording
            How people call each hypothesis, as of `Diagnosis.words`.
        clock : Clock
            Of the rows.

        Returns
        -------
        str
            With the times of the clock.
        """
        if self.event is None:
            return self.reason
        return sentence(self.event, words, clock, ended=not self.reason, after=self.after)

    @property
    def device_health(self) -> DeviceHealth | None:
        """The state by NAMUR NE 107 that it means for its sensors while it stands; None where it says nothing of a sensor."""
        if self.event is None:
            return DeviceHealth.CHECK_FUNCTION if self.what in ("blind", "sees again") else None
        return health_of(self.event)


class OpenEvent(NamedTuple):
    """An event that is not closed: its id, the times (s) at which it began and last held, and the samples since then."""

    id: int
    start: float
    last: float
    missed: int


class Sight(NamedTuple):
    """Whether rows are judged. id, since: of the change "blind" with its time (s), 0 where they are judged; other: samples in a
    row that differ from that.
    """

    id: int = 0
    since: float = 0.0
    other: int = 0


@dataclass
class Changes:
    """The events that stand after a row, and the last KEPT samples.

    An event opens with the first sample that holds, and closes with the `gap`-th in a row that does not, so that its start
    and end are those of `events_of`. Its size is the median over its last KEPT samples.
    """

    detector: Detector
    gap: int
    count: int = 0  # ids given so far
    standing: dict[int, OpenEvent] = field(default_factory=dict)
    recent: deque[tuple[float, Decision]] = field(default_factory=lambda: deque(maxlen=KEPT))
    sight: Sight = field(default_factory=Sight)

    def seen(self, t: float, conclusion: Conclusion, *, at_once: bool) -> list[Change]:
        """Change "blind" after `gap` samples in a row without a verdict, or at_once, "sees again" after as many with one."""
        blind, (number, since, other) = conclusion.verdict is Verdict.BLIND, self.sight
        if blind == bool(number):
            self.sight = Sight(number, since, 0)
            return []
        self.sight = Sight(number, since, other + 1)
        if other + 1 < self.gap and not (blind and at_once):
            return []
        if blind:
            self.count += 1
            self.sight = Sight(self.count, t)
            return [Change(self.count, "blind", t, reason=conclusion.reason)]
        self.sight = Sight()
        return [Change(number, "sees again", t, reason=f"rows are judged again; the verdict is {conclusion.text}")]

    def after(self, t: float, decision: Decision) -> list[Change]:
        """What the decision of the row at t changes: first what closes, then what opens."""
        self.recent.append((t, decision if decision.covariance is None else replace(decision, covariance=None)))
        held, found = _held(decision), []
        for i, event in list(self.standing.items()):
            missed = 0 if i in held else event.missed + 1
            if missed < self.gap:
                self.standing[i] = event._replace(last=event.last if missed else t, missed=missed)
            else:
                found.append(self._closed(i, t))
        for i in sorted(held - self.standing.keys()):
            self.count += 1
            self.standing[i] = OpenEvent(self.count, t, t, 0)
            found.append(Change(self.count, "opened", t, self._with_rivals(self._event(i), i)))
        if decision.shown_by is not None:
            at = [t for t, _ in self.recent]
            for i, event in self.standing.items():
                sized = i < decision.fault_size.size and np.isfinite(decision.fault_size[i]) and not event.missed
                if sized and len(at) - bisect_left(at, event.start) == self.gap:
                    found.append(Change(event.id, "named", t, self._event(i)))
        return found

    def followed(self, found: list[Change]) -> list[Change]:
        """The changes, events that are over with their `follow_ups`, as far as they are known."""
        over = [c.event is not None and not c.event.open for c in found]
        if not any(over) or not self.recent:
            return found
        times, decisions = zip(*self.recent, strict=True)
        t = np.array(times)
        events = events_of(self.detector, t, stack(list(decisions)), self.gap)
        return [
            c._replace(after=follow_ups(c.event, events, t)) if closed and c.event else c
            for c, closed in zip(found, over, strict=True)
        ]

    def reset(self, t: float, reason: str) -> list[Change]:
        """Close all that stands, forget the samples, and state why."""
        found = [self._closed(i, t) for i in list(self.standing)]
        self.recent.clear()
        self.count += 1
        return [*found, Change(self.count, "reset", t, reason=reason)]

    def open_events(self) -> dict[int, Event]:
        """The events that stand, by their ids."""
        return {event.id: self._event(i) for i, event in self.standing.items()}

    def _closed(self, i: int, t: float) -> Change:
        event = replace(self._event(i), open=False)
        return Change(self.standing.pop(i).id, "closed", t, event)

    def _event(self, i: int) -> Event:
        """The event of `events_of` on what is kept of the i-th event."""
        _, start, last, _ = self.standing[i]
        times, decisions = zip(*((t, d) for t, d in self.recent if start <= t <= last), strict=True)
        sensors, tested = len(self.detector.hypotheses), self.detector.process_hypotheses
        kinds = ("sensor", "other") if i < sensors else ("process", "outside") if i < sensors + len(tested) else ("undecided",)
        names = [*self.detector.hypotheses, *(h.name for h in tested)]
        found = events_of(self.detector, np.array(times), stack(list(decisions)), KEPT + 1)
        event = next(e for e in found if e.kind in kinds and (i >= len(names) or e.hypothesis == names[i]))
        sigma = self.detector.plant.sensor_sigma
        return replace(event, start=start, sigmas=event.size / float(sigma[i]) if event.kind == "sensor" else np.nan)

    def _with_rivals(self, event: Event, i: int) -> Event:
        """An event of a sensor at its first sample, with its probability and the hypotheses that are not excluded."""
        if event.kind != "sensor":
            return event
        last = [decision for _, decision in self.recent][-2:]
        confidence, rivals = rivals_at(self.detector, stack(last), i, len(last) - 1)
        return replace(event, confidence=confidence, alternatives=rivals)

    def arrays(self) -> dict[str, Array]:
        """What `restored` takes up again, as arrays."""
        rows = [(i, *event) for i, event in self.standing.items()]
        found = {"count": np.array(self.count), "standing": np.array(rows, float).reshape(-1, 5), "sight": np.array(self.sight)}
        if self.recent:
            times, decisions = zip(*self.recent, strict=True)
            kept = {f"recent.{name}": value for name, value in vars(stack(list(decisions))).items() if value is not None}
            found |= {"recent": np.array(times), **kept}
        return found

    @classmethod
    def restored(cls, detector: Detector, gap: int, saved: SavedArrays) -> Changes:
        """The same with which `arrays` was called; ValueError for arrays that it did not give."""
        found = cls(detector, gap, whole_numbers("count", saved.take("count", "i")))
        sight = saved.take("sight", "f", 3)
        found.sight = Sight(whole_numbers("sight", sight[0]), float(sight[1]), whole_numbers("sight", sight[2]))
        standing = saved.take("standing", "f", None, 5)
        for (i, number, missed), (start, last) in zip(
            whole_numbers("standing", standing[:, [0, 1, 4]]), standing[:, 2:4].tolist(), strict=True
        ):
            found.standing[i] = OpenEvent(number, start, last, missed)
        if "recent" in saved.arrays:
            times = saved.take("recent", "f", None)
            tested = any(f"recent.{name}" in saved.arrays for name in OF_PROCESS)
            absent = () if tested else OF_PROCESS
            absent = absent if "recent.shown_by" in saved.arrays else (*absent, "shown_by")
            names = [name for name in OF_DECISION if name not in absent]
            named = {name: _saved(saved, detector, name, times.size) for name in names}
            for k, t in enumerate(times.tolist()):
                found.recent.append((t, Decision(**{name: values[k] for name, values in named.items()})))
        numbers = [found.sight.id, *(e.id for e in found.standing.values())]
        if max(numbers) > found.count or len(found.standing) < len(standing):
            raise ValueError(f"'standing' has ids {numbers}, of {found.count} that were given")
        if found.recent and _held(found.recent[-1][1]) - found.standing.keys():
            raise ValueError("'standing' lacks what the last Decision holds")
        for i in found.standing:
            found._event(i)  # of samples that the file must have
        return found


OF_DECISION = {  # kind and axes of what a Decision has: N sensors, H hypotheses, P of the process, m inputs, n states
    "estimate": ("f", "n"), "reconstruction": ("f", "N"), "residual": ("f", "N"), "threshold": ("f", "N"),
    "isolated": ("b", "H"), "fault_size": ("f", "H"), "diverged": ("b", ""), "guarded": ("b", ""), "nis": ("f", ""),
    "capped": ("b", ""), "absurd": ("b", "N"), "absurd_input": ("b", "m"), "process": ("b", "P"), "process_size": ("f", "P"),
    "process_sd": ("f", "P"), "suspect": ("b", "S"), "probability": ("f", "S"), "shown_by": ("i", "N"),
}  # fmt: skip
OF_PROCESS = ("process", "process_size", "process_sd", "suspect", "probability")  # last in a Decision, all or none


def _saved(saved: SavedArrays, detector: Detector, name: str, count: int) -> Array:
    """A field of the last `count` Decisions; ValueError where it does not fit the detector."""
    kind, axis = OF_DECISION[name]
    plant, hypotheses = detector.plant, len(detector.hypotheses)
    tested = len(detector.process_hypotheses)
    sizes = {
        "N": len(plant.sensors),
        "H": hypotheses,
        "P": tested,
        "S": hypotheses + tested,
        "m": len(plant.inputs),
        "n": len(plant.states),
    }
    flag = name in ("absurd", "absurd_input") and not isinstance(detector, BatchDetector)  # these may have a single False
    alone = flag and f"recent.{name}" in saved.arrays and saved.arrays[f"recent.{name}"].ndim == 1
    return saved.take(f"recent.{name}", kind, count, *([] if alone or not axis else [sizes[axis]]))


def _held(decision: Decision) -> set[int]:
    """Which hypotheses are isolated, which of the process accepted, and, as one more, whether any is suspected."""
    held = set(np.flatnonzero(decision.isolated).tolist()) if decision.isolated.any() else set()
    if decision.process is not None and decision.process.any():
        held |= set((np.flatnonzero(decision.process) + decision.isolated.size).tolist())
    if decision.suspect is not None and decision.suspect.any():
        held.add(decision.suspect.size)
    return held
