"""Alarms: what changes belong together, so that a flood of them raises one alarm in ten minutes for one cause."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import NamedTuple

from fusion_sfdia.diagnosis.changes import Alarm, Change
from fusion_sfdia.diagnosis.device_health import DeviceHealth

QUIET = 600.0  # s since a cause has ended, after which its return is a new alarm
BLIND = "blind"


class Raised(NamedTuple):
    """The last alarm of a cause. last: highest id of its events; open: ids of those that stand; t: time (s) at which it was
    raised or the last of them ended; state: of its sensor.
    """

    id: int
    last: int
    open: tuple[int, ...]
    t: float
    state: DeviceHealth | None


@dataclass
class Alarms:
    """The last alarm of each cause, see `cause_of`.

    A cause that stands, or has ended less than `QUIET` s before, updates its alarm; otherwise it raises a new one. A cause
    that comes and goes for hours is therefore one alarm, and no cause has two new alarms within `QUIET` s. Times are those of
    the rows. What the second look states of an event again is of the same alarm, however late. A reset ends all but "blind".
    """

    count: int = 0
    raised: dict[str, Raised] = field(default_factory=dict)

    def with_alarm(self, change: Change) -> Change:
        """The change with its alarm; itself where it belongs to none."""
        if change.what == "reset":
            for name, alarm in self.raised.items():
                if name != BLIND and alarm.open:
                    self.raised[name] = alarm._replace(open=(), t=change.t)
        if (cause := cause_of(change)) is None:
            return change
        before = self.raised.get(cause)
        stands = change.what == BLIND or (change.event is not None and change.event.open)
        new = before is None or (change.id > before.last and not before.open and change.t - before.t >= QUIET)
        self.count += new
        if new or before is None:
            before = Raised(self.count, change.id, (), change.t, None)
        ids = {*before.open, change.id} if stands else {*before.open} - {change.id}
        ended = bool(before.open) and not ids
        state = change.device_health if stands else before.state
        t = change.t if ended else before.t
        self.raised[cause] = Raised(before.id, max(before.last, change.id), tuple(sorted(ids)), t, state)
        return change._replace(alarm=Alarm(before.id, new, bool(ids)))

    @property
    def standing(self) -> dict[str, DeviceHealth]:
        """The states of the sensors whose alarms are active, by their names."""
        return {
            cause.removeprefix("sensor "): alarm.state
            for cause, alarm in self.raised.items()
            if cause.startswith("sensor ") and alarm.open and alarm.state is not None
        }

    def __str__(self) -> str:
        return json.dumps([self.count, self.raised])

    @classmethod
    def of(cls, text: str) -> Alarms:
        """The same that `str` gave as text; ValueError or TypeError for any other."""
        count, raised = json.loads(text)
        found = cls(count)
        for cause, (number, last, ids, t, state) in raised.items():
            found.raised[cause] = Raised(number, last, tuple(ids), t, None if state is None else DeviceHealth(state))
        return found


def cause_of(change: Change) -> str | None:
    """The cause of a change, by which alarms are told apart; None of one that is no matter of an alarm.

    One cause is one sensor, whatever its fault ("sensor l1"); one hypothesis of the process or of operation ("process leak");
    all that is undecided, whoever the suspects ("undecided"); and that nothing can be judged ("blind").
    """
    if change.event is None:
        return BLIND if change.what in (BLIND, "sees again") else None
    kind = change.event.kind
    return kind if kind == "undecided" else f"{kind} {change.event.hypothesis}"
