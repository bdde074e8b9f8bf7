"""Kinds of faults and the health of the model while rows arrive: the second look of `diagnose`, some samples behind."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.detector import Decision, Detector, stack
from fusion_sfdia.diagnosis.absent import DUE, REPEATED, beyond_resolution, repeats
from fusion_sfdia.diagnosis.diagnose import Diagnosis, against_the_model, model_of
from fusion_sfdia.diagnosis.events import TOGETHER, Event, events_of, spans
from fusion_sfdia.diagnosis.hindsight import LEAD, Hindsight, begun, looked
from fusion_sfdia.diagnosis.lag import latest
from fusion_sfdia.diagnosis.model_health import Health, health_of
from fusion_sfdia.diagnosis.sensor_events import alarm_rate_of, explained
from fusion_sfdia.filters.estimators import GaussianState
from fusion_sfdia.logs.regular_sensors import regularities
from fusion_sfdia.plant.log import Log

Array = NDArray[Any]

WINDOW = 585  # samples from which kinds and health are taken
EACH = 20  # samples from a change to the first look
UNEXPLAINED = "its events may show that alone; correct its times, or add the delay to the model"
SETTLED = TOGETHER + 1  # samples after its end, that an event does not change any more


class Seen(NamedTuple):
    """A sample: time (s), readings y (N,) and inputs u (m,) without what is absurd, and its Decision. begins: the time at which
    the detector started anew, NaN where it did not. between: times and inputs of the steps before it. out (N,): what is left
    out as it is frozen or repeats the reading before. after: what the second look found, None until then.
    """

    t: float
    y: Array
    u: Array
    decision: Decision
    begins: float
    between: tuple[tuple[float, Array], ...]
    out: Array
    after: Hindsight | None = None


@dataclass
class NamedEvent:
    """An event with its id as it was last reported, None before; end: of its isolation, which may last longer than the fault;
    final: whether it has not changed for long after that.
    """

    id: int
    hypothesis: str
    start: float
    end: float
    reported: Event | None = None
    final: bool = False


@dataclass
class SecondLook:
    """A filter LEAD samples behind the detector, without the readings that this has isolated, and WINDOW samples of it.

    Kinds are named over these EACH samples after an event opens or closes, and again when that time has doubled, until it is
    SETTLED; a sensor that is silent or frozen is looked for every EACH samples. The window is taken as a log is by `prepared`:
    what repeats the reading before is missing, equal readings of a coarse sensor are not frozen; late sensors are looked for
    once in WINDOW samples, and at the end. unread: sensors whose silence is no event. say: is called once with a line for each
    sensor that is coarse, cyclic or late.
    """

    detector: Detector
    gap: int
    unread: Collection[str] = ()
    say: Callable[[str], None] = print
    core: GaussianState | None = None
    before: float = np.nan
    ahead: deque[Seen] = field(default_factory=deque)
    window: deque[Seen] = field(default_factory=lambda: deque(maxlen=WINDOW))
    named: list[NamedEvent] = field(default_factory=list)
    said: set[str] = field(default_factory=set)  # of which sensors something was said, and what
    count: int = 0
    due: int = 0  # the sample at which kinds are named next, 0: when something happens
    pause: int = EACH
    verdict: str = ""  # of the model, as last reported

    def take(self, seen: Seen) -> None:
        """A sample, of which all but `out` is known."""
        self.count += 1
        self.ahead.append(seen)
        self._freeze()
        if len(self.ahead) > LEAD:
            self._look()

    def happened(self, closed: Sequence[int] = ()) -> None:
        """An event has opened or closed; those with the ids `closed`, with the end of their isolation, are named again."""
        for e in self.named:
            if e.id in closed and e.reported is not None and not e.reported.open:
                e.reported = None
        self.due, self.pause = min(self.due or self.count + EACH, self.count + EACH), EACH

    def _freeze(self) -> None:
        """Leave out the samples ahead in which a sensor repeats its value."""
        if len(self.ahead) < REPEATED:
            return
        last = np.array([s.y for s in self.ahead])
        read = np.isfinite(last)
        value = np.nanmax(np.where(read, last, -np.inf), axis=0)
        if not (same := np.all(~read | (last == value), axis=0) & read.any(axis=0)).any():
            return
        rows = [*self.window, *self.ahead]
        for i in np.flatnonzero(same):
            for a, b in repeats(np.array([[s.y[i]] for s in rows]))[0][-1:]:
                if b >= len(rows) - REPEATED:
                    for k in range(max(a, len(self.window)), b + 1):
                        rows[k].out[i] = True

    def _look(self) -> None:
        """The filter's step to the oldest sample ahead."""
        seen = self.ahead.popleft()
        n = seen.y.size
        out = seen.out | seen.decision.isolated[:n]
        for later in islice(self.ahead, LEAD):
            out = out | later.decision.isolated[:n]
        model = model_of(self.detector)
        if np.isfinite(seen.begins):
            self.core, self.before = begun(model), seen.begins
        found: Hindsight | None = None
        nothing = np.full(n, np.nan)
        for t, y, u, use in (
            *((t, nothing, u, np.zeros(n, bool)) for t, u in seen.between),
            (seen.t, seen.y, seen.u, np.isfinite(seen.y) & ~out),
        ):
            if self.core is not None:
                self.core, found = looked(model, self.core, (self.before, t), (y, u), use)
                self.before = t
        if self.core is None or found is None:
            found = Hindsight(nothing, nothing, nothing, np.array(np.nan), np.array(0))
        self.window.append(seen._replace(after=found, between=()))

    def changes(self, opened: Sequence[tuple[int, Event]], clock: Clock, next_id: int) -> tuple[list[tuple[int, Event]], str]:
        """What is to be reported after a sample: events with their ids, and the line of the model's health, "" for none.

        opened: id and event of what has opened since the last sample; new ids begin with next_id.
        """
        for number, event in opened:
            if event.kind == "sensor":
                self.named.append(NamedEvent(number, event.hypothesis, event.start, event.start))
        if self.count % EACH == 0 and (self._is_back() or (not self.due and self._is_silent_or_frozen())):
            self.happened()
        found: list[tuple[int, Event]] = []
        health = ""
        whole = self.count % WINDOW == 0
        if whole or (self.due and self.count >= self.due):
            events, model = self._explained(clock, whole=whole)
            found = self._news(events, next_id)
            if whole:
                health = self._health(model)
            standing = any(not e.final for e in self.named)
            self.pause = min(2 * self.pause, WINDOW)
            self.due = self.count + self.pause if standing else 0
        return found, health

    def final(self, clock: Clock, next_id: int) -> tuple[list[tuple[int, Event]], str]:
        """What would be reported if no row came any more. The rows stay as they are; a late sensor is said once."""
        if not self.count:
            return [], ""
        end = replace(
            self,
            ahead=deque(self.ahead),
            window=deque(self.window, maxlen=WINDOW),
            named=[replace(e) for e in self.named],
        )
        while end.ahead:
            end._look()
        events, model = end._explained(clock, whole=True)
        return end._news(events, next_id), end._health(model)

    def anew(self) -> SecondLook:
        """The same after a reset, of which it knows nothing but the sensors and the verdict."""
        return SecondLook(self.detector, self.gap, self.unread, self.say, said=self.said, verdict=self.verdict)

    def open_events(self) -> list[tuple[int, Event]]:
        """Id and event of what was reported last as not over."""
        return [(e.id, e.reported) for e in self.named if e.reported is not None and e.reported.open]

    def _is_silent_or_frozen(self) -> bool:
        """Whether a sensor is, of which nothing was reported."""
        known = {e.hypothesis for e in self.named} | {*self.unread}
        return bool(self._silent_or_frozen() - known)

    def _is_back(self) -> bool:
        """Whether a sensor is not, of which that was reported last."""
        lost = {e.hypothesis for _, e in self.open_events() if e.fault in ("dropout", "freeze")}
        return bool(lost and lost - self._silent_or_frozen())

    def _silent_or_frozen(self) -> set[str]:
        """The sensors of which half of the last DUE readings are missing, or the last REPEATED are equal."""
        known = self.detector.plant.modelled
        last = np.array([s.y[:known] for s in islice(reversed(self.window), DUE)])
        if len(last) < DUE:
            return set()
        silent = np.sum(np.isnan(last), axis=0) >= DUE // 2
        equal = np.all(last[:REPEATED] == last[0], axis=0)
        return {self.detector.plant.sensor_names[i] for i in np.flatnonzero(silent | equal)}

    def _explained(self, clock: Clock, *, whole: bool) -> tuple[list[Event], Health]:
        """The events and the health of the model of `diagnose`, of the window; whole: late sensors are looked for."""
        rows, plant = list(self.window), self.detector.plant
        log = Log(*(np.array([s[k] for s in rows]) for k in range(3)))
        decisions = stack([s.decision for s in rows])
        after = Hindsight(*(np.array(v) for v in zip(*(s.after for s in rows if s.after is not None), strict=True)))
        regular = regularities(plant, log)
        log = regular.without_repeats(log)
        after.error[np.isnan(log.y)] = np.nan
        first = events_of(self.detector, log.t, decisions, self.gap)
        with np.errstate(invalid="ignore", divide="ignore"):
            frozen = beyond_resolution(repeats(log.y), after.error / after.sd, regular.of(plant).sensor_resolution)
        found = explained(self.detector, log.t, log.y, decisions, first, after.residuals, frozen)
        events = [e for e in found if e.kind != "sensor" or e.hypothesis not in self.unread]
        for finding in regular.findings(plant):
            self._say(finding.kind, finding.name, finding.text)
        if whole and events and not any(about.startswith("late") for about in self.said):
            if late := latest(self.detector, log, Diagnosis(tuple(events), decisions, log.t, after=after.residuals)):
                self._say("late", plant.sensor_names[late.sensor], f"{late.summary(plant, log)}: {UNEXPLAINED}")
        starts = np.flatnonzero(np.isfinite([s.begins for s in rows]))
        remarks = against_the_model(events, decisions, log.t, clock)
        return events, health_of(plant, after, starts, alarm_rate_of(self.detector), remarks)

    def _say(self, kind: str, sensor: str, text: str) -> None:
        if kind != "repeat" and f"{kind} {sensor}" not in self.said:  # repeats are missing already, see `SlowSensors`
            self.said.add(f"{kind} {sensor}")
            self.say(text)

    def _news(self, events: Sequence[Event], next_id: int) -> list[tuple[int, Event]]:
        """Of the events of sensors those that are not as reported before."""
        times = [s.t for s in self.window]
        settled = times[-SETTLED - 1] if len(times) > SETTLED else -np.inf
        found: list[tuple[int, Event]] = []
        for event in events:
            if event.kind != "sensor":
                continue
            own = [e for e in self.named if e.hypothesis == event.hypothesis and e.start <= event.end and e.end >= event.start]
            if any(e.final for e in own):
                continue
            if not own:
                own = [NamedEvent(next_id, event.hypothesis, event.start, event.end)]
                self.named += own
                next_id += 1
            known = own[0]
            for other in own[1:]:  # those that are one with the first
                self.named.remove(other)
                if other.reported is not None and other.reported.open:
                    found.append((other.id, replace(other.reported, open=False)))
            known.start = event.start if event.start > times[0] else min(known.start, event.start)
            known.end, event = self._trusted(event), replace(event, start=known.start)
            if known.reported is None or _differs(known.reported, event):
                known.reported = event
                found.append((known.id, event))
            known.final = known.end < settled
        gone = {e.id for e in self.named if e.end < times[0]}
        found += [(number, replace(e, open=False)) for number, e in self.open_events() if number in gone]
        self.named = [e for e in self.named if e.id not in gone]
        for e in self.named:
            e.final |= e.end < settled
        return found

    def _trusted(self, event: Event) -> float:
        """The last time at which the sensor of an event is isolated without a break since its end."""
        i = self.detector.plant.sensor_names.index(event.hypothesis)
        isolated = np.array([s.decision.isolated[i] for s in self.window])
        times = [s.t for s in self.window]
        return max([event.end, *(times[b] for a, b in spans(isolated, self.gap) if times[a] <= event.end)])

    def _health(self, health: Health) -> str:
        verdict = health.line.partition(":")[0]
        if not (health.tested or health.suspect) or verdict == self.verdict:
            return ""
        self.verdict = verdict
        return health.line


def _differs(before: Event, now: Event) -> bool:
    return (before.fault, before.open, before.start) != (now.fault, now.open, now.start) or (
        not now.open and (before.end, before.size) != (now.end, now.size)
    )
