"""The verdicts of rows as a `Diagnosis`: events of sensors, the process, operation that was not learnt, and the recorder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.clock import Clock
from fusion_sfdia.core.detector import Decision, ProcessHypothesis
from fusion_sfdia.core.gaps import Gap
from fusion_sfdia.core.linear import linear_plant
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.signals import Sensor
from fusion_sfdia.evaluation.diagnose import Diagnosis
from fusion_sfdia.evaluation.events import Event, UndecidedEvent, listed, median, spans, with_unit
from fusion_sfdia.learning.causes import MOVED, ONE_OF, OUTSIDE, PROCESS, RECORDER, Causes
from fusion_sfdia.learning.channels import Channels, Piece
from fusion_sfdia.learning.judging import Judged
from fusion_sfdia.learning.residuals import Test

Array = NDArray[Any]

SECONDS = Clock()
BRIEF, CLEAR = 3, 2.0  # rows of an event, and times its limit, up to which a sensor that is named may be one by chance
PERHAPS = 0.3  # the confidence of these, our choice: below even, and not measured
JOINED = 16  # rows: events of one verdict that are fewer apart are one
PROCESS_NAME, TOGETHER = "the process", "readings that move together"


@dataclass(frozen=True)
class GroupEvent(Event):
    """From start to end (s) several readings moved together as never in the healthy logs: the process.

    most: the channels that are furthest off.
    """

    kind: ClassVar[str] = "process"
    most: tuple[str, ...] = ()

    def told(self, clock: Clock) -> str:
        """The event in words, with the times of a clock."""
        by = f", most: {listed(self.most)}" if self.most else ""
        return f"process {self.when(clock)}: readings that move together as never in the healthy logs{by}; no sensor alone"


@dataclass(frozen=True)
class OutsideEvent(GroupEvent):
    """From start to end (s) operation was as in no healthy log: a new one, or a fault of the process."""

    kind: ClassVar[str] = "outside"

    def told(self, clock: Clock) -> str:
        """The event in words, with the times of a clock."""
        by = f", most: {listed(self.most)}" if self.most else ""
        return f"outside what was learnt {self.when(clock)}{by}: an operation that no healthy log has, or a process fault"


@dataclass(frozen=True)
class RecorderEvent(Event):
    """From start to end (s) several sensors stopped in the same row: the recorder, or its link."""

    kind: ClassVar[str] = "outside"

    def told(self, clock: Clock) -> str:
        """The event in words, with the times of a clock."""
        return f"recorder stopped {self.when(clock)}: several sensors repeat or miss their readings since the same row"


@dataclass(frozen=True)
class StillEvent(Event):
    """A sensor that never moved in the healthy logs moved from start to end (s), by size."""

    kind: ClassVar[str] = "outside"

    def told(self, clock: Clock) -> str:
        """The event in words, with the times of a clock."""
        return f"{self.hypothesis} moved {self.when(clock)}, by {with_unit(f'{self.size:.4g}', self.unit)}; never when healthy"


class Verdicts(NamedTuple):
    """The verdicts on a piece of a log: times t (K,), readings (K, n) of all columns on its grid, and what was found.

    ratio, sizes (K, N): of each sensor that is used the largest statistic over its limit, and by how much it is off in its
    unit where it is named.
    """

    t: Array
    values: Array
    causes: Causes
    ratio: Array
    sizes: Array
    tests: tuple[Test, ...]
    ratios: Array

    def how(self, i: int, a: int, b: int) -> Array:
        """Rows a to b of sensor i: "freeze", "dropout", "noise" where only that shows it, else "" (K,)."""
        kinds = np.array([t.kind for t in self.tests])
        part = self.ratios[:, a:b, i]
        repeats, missing = (part[kinds == k].max(axis=0) > 1 for k in ("repeats", "missing"))
        noisy = part[np.isin(kinds, ("noise", "spike"))].max(axis=0)
        rest = part[np.isin(kinds, ("level", "change"))].max(axis=0)
        return np.where(repeats, "freeze", np.where(missing, "dropout", np.where((noisy > 1) & (rest <= 1), "noise", "")))

    def most(self, a: int, b: int, names: Sequence[str]) -> tuple[str, ...]:
        """The sensors that are furthest off in rows a to b, at most three."""
        share = np.mean(self.ratio[a:b] > 1, axis=0)
        return tuple(names[i] for i in np.argsort(-share, kind="stable")[:3] if share[i] > 0)


def verdicts_of(channels: Channels, piece: Piece, found: Judged, by: Causes) -> Verdicts:
    """The verdicts on a piece, with sizes in the units of the sensors."""
    sizes = np.full(by.size.shape, np.nan)
    own = piece.v[:, channels.used]
    for k, i in np.argwhere(np.isfinite(by.size)).tolist():
        sizes[k, i] = channels.size(i, own[k, i], by.size[k, i])
    tests = found.tests
    return Verdicts(piece.t, piece.v, by, found.ratio.max(axis=0), sizes, tests, found.ratio)


def diagnosed(
    channels: Channels, dt: float, found: Sequence[Verdicts], of_log: tuple[str, ...] = (), clock: Clock = SECONDS
) -> Diagnosis:
    """The Diagnosis of a log in pieces, on a grid of step dt (s); of_log: what is to be said of the monitor, a line each."""
    t = np.concatenate([v.t for v in found])
    y = np.concatenate([v.values for v in found])[:, : len(channels.sensors)]
    events = [e for v in found for e in _events(channels, v, t[-1])] + _still(channels, t, y)
    order = {"process": 0, "outside": 1, "undecided": 2, "sensor": 3}
    events.sort(key=lambda e: (order[e.kind], e.start, e.hypothesis))
    gaps = tuple(Gap(float(a.t[-1]), float(b.t[0]), round(float(b.t[0] - a.t[-1]) / dt), True) for a, b in pairwise(found))
    tested = (ProcessHypothesis(TOGETHER, "", "process", np.nan),)
    return Diagnosis(tuple(events), _decisions(channels, found, t, y), t, tested, clock, gaps, of_log=of_log)


def plant_of(channels: Channels, dt: float) -> Plant:
    """The signals as a plant that does nothing, for reports; sigma: the deviation of the readings when healthy."""
    sigma = np.ones(len(channels.sensors))
    plain = channels.used[: channels.count][~np.isfinite(channels.floor[: channels.count])]
    sigma[plain] = channels.sd[: channels.count][~np.isfinite(channels.floor[: channels.count])]
    sensors = [Sensor(s.name, s.name, s.unit, sigma=float(v)) for s, v in zip(channels.sensors, sigma, strict=True)]
    return linear_plant(
        "monitored plant", np.zeros((1, 1)), np.zeros((len(sensors), 1)), sensors,
        dt=dt, x0=np.zeros(1), initial_cov=np.ones(1), process_cov=np.ones(1), inputs=channels.inputs,
    )  # fmt: skip


def _decisions(channels: Channels, found: Sequence[Verdicts], t: Array, y: Array) -> Decision:
    rows, starts = len(t), np.cumsum([0, *(len(v.t) for v in found)])
    count, n = len(channels.sensors), channels.count
    own = channels.used[:n]
    isolated, residual = np.zeros((rows, count), bool), np.full((rows, count), np.nan)
    size = np.full((rows, count), np.nan)
    for v, a in zip(found, starts, strict=False):
        part = slice(a, a + len(v.t))
        isolated[part, own] = v.causes.named[:, :n]
        residual[part, own] = np.where(np.isfinite(v.values[:, own]) | v.causes.named[:, :n], v.ratio, np.nan)
        size[part, own] = v.sizes
    made = np.where(isolated, y - size, y)
    no = np.zeros(rows, bool)
    return Decision(
        estimate=np.zeros((rows, 1)), reconstruction=made, residual=residual, threshold=np.ones((rows, count)),
        isolated=isolated, fault_size=np.where(isolated, size, np.nan), diverged=no, guarded=no, nis=np.full(rows, np.nan),
    )  # fmt: skip


def _events(channels: Channels, v: Verdicts, t_end: float) -> list[Event]:
    names, n = channels.names, channels.count
    units = {s.name: s.unit for s in channels.sensors}
    kind = v.causes.kind
    found: list[Event] = []

    def when(a: int, b: int) -> tuple[float, float]:
        return float(v.t[a]), float(v.t[b])

    for i in range(n):
        for a, b in spans(v.causes.named[:, i], JOINED):
            held = v.causes.named[a : b + 1, i]
            how = str(Counter(v.how(i, a, b + 1)[held].tolist()).most_common(1)[0][0])
            value = median(v.sizes[a : b + 1, i]) if how == "" else np.nan
            brief = np.sum(held) <= BRIEF and np.max(v.ratio[a : b + 1, i]) < CLEAR
            first = _stopped_at(v.values[:, channels.used[i]], a) if how in ("freeze", "dropout") else a
            event = Event(
                names[i], *when(first, b), value, units[names[i]], bool(v.t[b] == t_end), fault=how or "bias",
                fault_alternatives=() if how else ("drift",),
            )  # fmt: skip
            found.append(replace(event, confidence=PERHAPS) if brief else event)
    longer = [(i, *span) for i in range(n) for span in spans(v.causes.named[:, i], JOINED)]

    def part_of(a: int, b: int, which: Sequence[int]) -> bool:
        """Whether a few rows are the beginning or end of a longer fault of one of these sensors."""
        near = [q - p for i, p, q in longer if i in which and p - JOINED <= a and b <= q + JOINED]
        return b - a < JOINED and max(near, default=0) > b - a

    for which in (MOVED, ONE_OF):
        for a, b in spans(kind == which, JOINED):
            sets = [tuple(np.flatnonzero(row).tolist()) for row in v.causes.suspect[a : b + 1] if row.any()]
            chosen = Counter(sets).most_common(1)[0][0]
            if part_of(a, b, chosen):
                continue
            suspects = tuple(names[i] for i in chosen) + ((PROCESS_NAME,) if which == MOVED else ())
            found.append(UndecidedEvent(" or ".join(suspects), *when(a, b), np.nan, "", bool(v.t[b] == t_end), suspects))
    for a, b in spans(np.isin(kind, (PROCESS, OUTSIDE)), JOINED):
        if part_of(a, b, range(n)):
            continue
        outside = 2 * np.sum(kind[a : b + 1] == OUTSIDE) > np.sum(np.isin(kind[a : b + 1], (PROCESS, OUTSIDE)))
        make, name = (OutsideEvent, "operation") if outside else (GroupEvent, TOGETHER)
        found.append(make(name, *when(a, b), np.nan, "", bool(v.t[b] == t_end), most=v.most(a, b + 1, names)))
    for a, b in spans(kind == RECORDER, JOINED):
        found.append(RecorderEvent("recorder", *when(a, b), np.nan, "", bool(v.t[b] == t_end)))
    return found


def _stopped_at(v: Array, row: int) -> int:
    """The first of the rows up to this one that repeat one reading or have none, v (K,)."""
    first = row
    while first > 0 and (v[first - 1] == v[row] or not (np.isfinite(v[first - 1]) or np.isfinite(v[row]))):
        first -= 1
    return first


def _still(channels: Channels, t: Array, y: Array) -> list[Event]:
    found: list[Event] = []
    for i, signal in enumerate(channels.sensors):
        if signal.name in channels.still:
            off = y[:, i] - channels.still[signal.name]
            for a, b in spans(np.isfinite(off) & (off != 0), JOINED):
                size = median(off[a : b + 1])
                found.append(StillEvent(signal.name, float(t[a]), float(t[b]), size, signal.unit, b == len(t) - 1))
    return found
