"""What rows change: events that open and close at once, and what the second look says of them some samples later."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.detector import Decision, Detector
from fusion_sfdia.detectors.storage import SavedArrays
from fusion_sfdia.detectors.verdicts import Conclusion
from fusion_sfdia.diagnosis.changes import Change, Changes
from fusion_sfdia.diagnosis.events import Event
from fusion_sfdia.diagnosis.look_state import look_arrays, restored_look
from fusion_sfdia.diagnosis.second_look import SecondLook, Seen
from fusion_sfdia.plant.model_errors import RAISED, described

Array = NDArray[Any]


class Findings:
    """The first look, `Changes`, and where kinds are named the second, `SecondLook`, with ids in common."""

    def __init__(
        self, detector: Detector, gap: int, kinds: bool, refused: Callable[[str], None], unread: Collection[str] = ()
    ) -> None:
        self.detector, self.refused = detector, refused
        self.changes = Changes(detector, gap)
        self.look = SecondLook(detector, gap, unread, refused) if kinds else None

    def after(self, seen: Seen, decision: Decision, clock: Clock) -> list[Change]:
        """What a row changes. seen: the row with its inputs; readings that the detector calls absurd are removed from it."""
        now = self.changes.after(seen.t, decision)
        if self.look is None:
            return self.changes.followed(now)
        u = seen.u
        if decision.absurd_input.shape == u.shape and decision.absurd_input.any():
            u = np.where(decision.absurd_input, self.detector.plant.input_at(seen.t), u)
        y = np.where(decision.absurd, np.nan, seen.y)
        opened = [(c.id, c.event) for c in now if c.what == "opened" and c.event]
        try:
            self.look.take(seen._replace(y=y, u=u, decision=self.changes.recent[-1][1]))
            if any(c.what in ("opened", "closed") for c in now):
                self.look.happened([c.id for c in now if c.what == "closed"])
            named = self._told(seen.t, *self.look.changes(opened, clock, self.changes.count + 1))
            return self.changes.followed([*now, *named])
        except RAISED as error:
            ended = self._ended(seen.t, self.look)
            self.look = self.look.anew()
            self.refused(f"row at {clock.at(seen.t)}: kinds of faults are named from the next row on: {described(error)}")
            return self.changes.followed([*now, *ended])

    def sight(self, t: float, conclusion: Conclusion, *, at_once: bool) -> list[Change]:
        """Whether rows are no longer judged, or again, see `Changes.seen`."""
        return self.changes.seen(t, conclusion, at_once=at_once)

    def reset(self, t: float, reason: str, clock: Clock) -> list[Change]:
        """Close all that stands, with what the second look says of it, and forget the samples."""
        found: list[Change] = []
        if self.look is not None:
            events, health = self._final(self.look, clock)
            found = self._told(t, [(number, replace(e, open=False)) for number, e in events], health)
            found = [*self._ended(t, self.look, {number for number, _ in events}), *found]
            self.look = self.look.anew()
        changes = [*found, *self.changes.reset(t, reason)]
        return [c if c.event is None else c._replace(reason=reason) for c in changes]

    def last(self, t: float, clock: Clock) -> list[Change]:
        """What the second look would say if no row came any more; all stays as it is."""
        if self.look is None:
            return []
        count = self.changes.count
        found = self._told(t, *self._final(self.look, clock))
        self.changes.count = count
        return self.changes.followed(found)

    def _final(self, look: SecondLook, clock: Clock) -> tuple[list[tuple[int, Event]], str]:
        """What the second look knows by now; nothing where the model, which may raise anything, fails again."""
        try:
            return look.final(clock, self.changes.count + 1)
        except RAISED:
            return [], ""

    def _ended(self, t: float, look: SecondLook, known: Collection[int] = ()) -> list[Change]:
        """That those events have ended which were reported by the second look alone, and are not `known` otherwise."""
        known = {*known, *(e.id for e in self.changes.standing.values())}
        return [Change(n, "named", t, replace(e, open=False)) for n, e in look.open_events() if n not in known]

    def _told(self, t: float, events: Sequence[tuple[int, Event]], health: str) -> list[Change]:
        self.changes.count = max([self.changes.count, *(number for number, _ in events)])
        found = [Change(number, "named", t, event) for number, event in events]
        return [*found, Change(0, "health", t, reason=health)] if health else found

    def arrays(self) -> dict[str, Array]:
        """What `restore` takes up again."""
        look = {} if self.look is None else look_arrays(self.look)
        return self.changes.arrays() | {f"look.{name}": value for name, value in look.items()}

    def restore(self, arrays: dict[str, Array]) -> None:
        """Go on as the one with which `arrays` was called; ValueError for arrays that it did not give."""
        look = SavedArrays({name.removeprefix("look."): a for name, a in arrays.items() if name.startswith("look.")})
        saved = SavedArrays({name: a for name, a in arrays.items() if not name.startswith("look.")})
        self.changes = Changes.restored(self.detector, self.changes.gap, saved)
        saved.end()
        if self.look is not None and look.arrays:
            decisions = [decision for _, decision in self.changes.recent]
            self.look = restored_look(self.look, look, decisions)
            look.end()
