"""What rows change: events that open and close at once, and what the second look says of them some samples later."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.detector import Decision, Detector
from fusion_sfdia.detectors.storage import SavedArrays, whole_numbers
from fusion_sfdia.detectors.verdicts import Conclusion
from fusion_sfdia.diagnosis.changes import Change, Changes
from fusion_sfdia.diagnosis.events import Event
from fusion_sfdia.diagnosis.hindsight import LEAD, Hindsight
from fusion_sfdia.diagnosis.second_look import WINDOW, NamedEvent, SecondLook, Seen
from fusion_sfdia.filters.estimators import GaussianState
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


def look_arrays(look: SecondLook) -> dict[str, Array]:
    """What `restored_look` takes up again, but for the decisions, as arrays."""
    rows = [*look.window, *look.ahead]
    found = {
        "said": np.array(sorted(look.said), str),
        "numbers": np.array([look.before, look.count, look.due, look.pause, len(look.window)]),
    }
    found |= {"verdict": np.array(look.verdict)}
    if look.core is not None:
        found |= {"x": look.core.x, "P": look.core.P}
    for name in ("t", "y", "u", "begins", "out") if rows else ():
        found[name] = np.array([getattr(s, name) for s in rows])
    for name in Hindsight._fields if look.window else ():
        found[f"after.{name}"] = np.array([getattr(s.after, name) for s in look.window])
    steps = [(k, t, *u) for k, s in enumerate(look.ahead) for t, u in s.between]
    found["between"] = np.array(steps or np.empty((0, 2)), float)
    found["named"] = np.array([(e.id, e.start, e.end, e.final) for e in look.named], float).reshape(-1, 4)
    found["hypotheses"] = np.array([e.hypothesis for e in look.named], str)
    reported = [e.reported for e in look.named]
    found["reported"] = np.array(
        [(np.nan,) * 4 if e is None else (e.start, e.end, e.size, e.open) for e in reported], float
    ).reshape(-1, 4)
    found["faults"] = np.array(["" if e is None else e.fault for e in reported], str)
    return found


def restored_look(fresh: SecondLook, saved: SavedArrays, decisions: Sequence[Decision]) -> SecondLook:
    """The look whose `look_arrays` were saved. fresh: one of the same detector, for what is not saved; decisions: of the last
    samples. ValueError for arrays that `look_arrays` did not give.
    """
    detector = fresh.detector
    n, m = len(detector.plant.sensors), len(detector.plant.inputs)
    numbers = saved.take("numbers", "f", 5)
    before = float(numbers[0])
    count, due, pause, size = whole_numbers("numbers", numbers[1:])
    core = None
    if "x" in saved.arrays:
        x = saved.take("x", "f", None)
        core = GaussianState(x, saved.take("P", "f", x.size, x.size))
    said, verdict = set(saved.take("said", "U", None).tolist()), str(saved.take("verdict", "U"))
    found = replace(fresh.anew(), core=core, before=before, count=count, due=due, pause=pause, said=said, verdict=verdict)
    times = saved.take("t", "f", None) if "t" in saved.arrays else np.empty(0)
    rows = times.size
    if not size <= rows <= min(len(decisions), size + LEAD) or size > WINDOW:
        raise ValueError(f"'numbers' states {size} of {rows} rows")
    y, u, begins, out = (
        saved.take(name, kind, rows, *axes) if rows else np.empty((0, *axes))
        for name, kind, axes in (("y", "f", (n,)), ("u", "f", (m,)), ("begins", "f", ()), ("out", "b", (n,)))
    )
    after = [
        saved.take(f"after.{name}", kind, size, *axes) if size else np.empty((0, *axes))
        for name, kind, axes in zip(Hindsight._fields, "ffffi", ((n,), (n,), (n,), (), ()), strict=True)
    ]
    between = saved.take("between", "f", None, None)
    if between.shape[1] != (2 + m if len(between) else 2):
        raise ValueError(f"'between' has shape {between.shape}; expected {2 + m} columns, 2 without rows")
    ahead = whole_numbers("between", between[:, 0])
    for k in range(rows):
        steps = tuple((float(s[1]), s[2:]) for at, s in zip(ahead, between, strict=True) if at == k - size)
        seen = Seen(float(times[k]), y[k], u[k], decisions[len(decisions) - rows + k], float(begins[k]), steps, out[k])
        if k < size:
            found.window.append(seen._replace(after=Hindsight(*(values[k] for values in after))))
        else:
            found.ahead.append(seen)
    found.named += _restored_events(detector, saved)
    return found


def _restored_events(detector: Detector, saved: SavedArrays) -> list[NamedEvent]:
    named = saved.take("named", "f", None, 4)
    names = saved.take("hypotheses", "U", len(named)).tolist()
    reported = saved.take("reported", "f", len(named), 4).tolist()
    faults = saved.take("faults", "U", len(named)).tolist()
    if unknown := set(names) - set(detector.plant.sensor_names):
        raise ValueError(f"'hypotheses' has {unknown}, which are no sensors")
    found = []
    for k, (number, final) in enumerate(whole_numbers("named", named[:, [0, 3]])):
        start, end, size, is_open = reported[k]
        event = None if np.isnan(start) else Event(names[k], start, end, size, "", bool(is_open), fault=faults[k])
        found.append(NamedEvent(number, names[k], float(named[k, 1]), float(named[k, 2]), event, bool(final)))
    return found
