"""The verdicts of rows as a `Diagnosis`: events of sensors, the process, operation that was not learnt, and the recorder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.detector import SHOWN_BY, Decision, ProcessHypothesis, joined
from fusion_sfdia.diagnosis.diagnose import Diagnosis
from fusion_sfdia.diagnosis.events import (
    NEVER_MOVED,
    Event,
    GroupEvent,
    OperationEvent,
    RecorderEvent,
    StillEvent,
    UndecidedEvent,
    continued,
    listed,
    median,
    spans,
)
from fusion_sfdia.diagnosis.sentences import Wording
from fusion_sfdia.learning.monitor.causes import MOVED, ONE_OF, OUTSIDE, PROCESS, RECORDER, Causes
from fusion_sfdia.learning.monitor.channels import Channels, deviations
from fusion_sfdia.learning.monitor.held_out import JOINED
from fusion_sfdia.learning.monitor.judging import Judged
from fusion_sfdia.plant.gaps import Gap
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]

SECONDS = Clock()
BRIEF, CLEAR = 3, 2.0  # rows of an event, and times its limit, up to which a sensor that is named may be one by chance
PERHAPS = 0.3  # the confidence of these, our choice: below even, and not measured
PROCESS_NAME, TOGETHER = "the process", "readings that move together"
TESTED = (
    ProcessHypothesis(TOGETHER, "1", "together", np.nan),
    ProcessHypothesis("operation outside the healthy logs", "1", "outside", np.nan),
    ProcessHypothesis("the recorder stopped", "1", "recorder", np.nan),
)


@dataclass(frozen=True)
class OutsideEvent(OperationEvent):
    """From start to end (s) operation was as in no healthy log: a new one, or a fault of the process.

    most: the channels that are furthest off.
    """

    most: tuple[str, ...] = ()

    def summary(self, clock: Clock) -> str:
        """The event in words, with the times of a clock."""
        by = f", most: {listed(self.most)}" if self.most else ""
        return f"outside what was learnt {self.when(clock)}{by}: an operation that no healthy log has, or a process fault"


FREEZE, DROPOUT, NOISY = 1, 2, 3


class Verdicts(NamedTuple):
    """The verdicts on a piece of a log: times t (K,), readings (K, n) of all columns on its grid, and what was found.

    ratio, sizes (K, N): of each sensor that is used the largest statistic over its limit, and by how much it is off in its
    unit where it is named. how (K, N): the place in `SHOWN_BY` of what shows it.
    """

    t: Array
    values: Array
    causes: Causes
    ratio: Array
    sizes: Array
    how: Array

    def most(self, a: int, b: int, names: Sequence[str]) -> tuple[str, ...]:
        """The sensors that are furthest off in rows a to b, at most three."""
        share = np.mean(self.ratio[a:b] > 1, axis=0)
        return tuple(names[i] for i in np.argsort(-share, kind="stable")[:3] if share[i] > 0)


def verdicts_of(channels: Channels, t: Array, v: Array, found: Judged, by: Causes) -> Verdicts:
    """The verdicts on rows at t (K,), v (K, n), with sizes in the units of the sensors."""
    sizes = np.full(by.size.shape, np.nan)
    own = v[:, channels.used]
    for k, i in np.argwhere(np.isfinite(by.size)).tolist():
        sizes[k, i] = channels.size(i, own[k, i], by.size[k, i])
    kinds = np.array([test.kind for test in found.tests])

    def over(*which: str) -> Array:
        return np.asarray(found.ratio[np.isin(kinds, which)].max(axis=0) > 1)

    noisy = over("noise", "spike") & ~over("level", "change", "same")
    how = np.where(over("repeats"), FREEZE, np.where(over("missing"), DROPOUT, np.where(noisy, NOISY, 0))).astype(np.int8)
    return Verdicts(t, v, by, np.maximum(found.ratio.max(axis=0), by.stepped), sizes, how)


def joined_verdicts(parts: Sequence[Verdicts]) -> Verdicts:
    """The verdicts on rows that follow each other, as one."""
    if len(parts) == 1:
        return parts[0]
    by = Causes(*(np.concatenate(each) for each in zip(*(p.causes for p in parts), strict=True)))
    t, values, _, *rest = (list(each) for each in zip(*parts, strict=True))
    return Verdicts(np.concatenate(t), np.concatenate(values), by, *(np.concatenate(each) for each in rest))


def diagnosed(
    channels: Channels, dt: float, found: Sequence[Verdicts], of_log: tuple[str, ...] = (), clock: Clock = SECONDS
) -> Diagnosis:
    """The Diagnosis of a log in pieces, on a grid of step dt (s); of_log: what is to be said of the monitor, a line each."""
    t = np.concatenate([v.t for v in found])
    y = np.concatenate([v.values for v in found])[:, : len(channels.sensors)]
    events = [*continued([e for v in found for e in _events(channels, v, t[-1])], t), *_still(channels, t, y)]
    order = {"process": 0, "outside": 1, "undecided": 2, "sensor": 3}
    events.sort(key=lambda e: (order[e.kind], e.start, e.hypothesis))
    gaps = tuple(Gap(float(a.t[-1]), float(b.t[0]), round(float(b.t[0] - a.t[-1]) / dt), True) for a, b in pairwise(found))
    decisions = joined([decisions_of(channels, v) for v in found])
    words = {s.name: Wording("sensor", s.name) for s in channels.sensors}
    return Diagnosis(tuple(events), decisions, t, tested(channels), clock, gaps, of_log=of_log, words=words)


def plant_of(channels: Channels, dt: float) -> Plant:
    """The signals as a plant that does nothing; sigma: the deviation of the readings when healthy."""
    sigma, zero = deviations(channels)[: len(channels.sensors)], np.zeros(len(channels.sensors))
    sensors = [Sensor(s.name, s.name, s.unit, sigma=float(v)) for s, v in zip(channels.sensors, sigma, strict=True)]
    made = linear_plant(
        "monitored plant", np.eye(1), zero[:, None], sensors,
        dt=dt, x0=np.zeros(1), initial_cov=np.ones(1), process_cov=np.ones(1), inputs=channels.inputs,
    )  # fmt: skip
    numerics = replace(made.numerics, fixed_dt=False)
    return replace(
        made, numerics=numerics, step=lambda t, x, u, dt: x, output=lambda t, x, u: np.zeros((*x.shape[:-1], zero.size))
    )


def tested(channels: Channels) -> tuple[ProcessHypothesis, ...]:
    """What the trouble may be besides a sensor: `TESTED`, each reading that never moved when healthy, and the inputs, which are
    suspected and never named.
    """
    still = (ProcessHypothesis(f"{s.name}{NEVER_MOVED}", s.unit, "still", np.nan) for s in _still_sensors(channels))
    return (*TESTED, *still, *(ProcessHypothesis(s.name, s.unit, "input", np.nan) for s in channels.inputs))


def _still_sensors(channels: Channels) -> list[Signal]:
    return [s for s in channels.sensors if s.name in channels.still]


def decisions_of(channels: Channels, v: Verdicts) -> Decision:
    """The verdicts on rows as Decisions (K, ...), of all sensors and of what is `tested` besides."""
    rows, count, n = len(v.t), len(channels.sensors), channels.count
    own, y, kind = channels.used[:n], v.values[:, :count], v.causes.kind
    isolated, residual, size = np.zeros((rows, count), bool), np.full((rows, count), np.nan), np.full((rows, count), np.nan)
    isolated[:, own] = v.causes.named[:, :n]
    residual[:, own] = np.where(np.isfinite(y[:, own]) | v.causes.named[:, :n], v.ratio, np.nan)
    size[:, own] = v.sizes
    still = _still_sensors(channels)
    others = len(TESTED) + len(still)  # than inputs
    suspect = np.zeros((rows, count + others + len(channels.inputs)), bool)
    suspect[:, own] = v.causes.suspect[:, :n]
    suspect[:, channels.used[n:] + others] = v.causes.suspect[:, n:]
    suspect[kind == MOVED, count] = True
    process = np.zeros((rows, others + len(channels.inputs)), bool)
    process[:, : len(TESTED)] = np.stack([kind == PROCESS, kind == OUTSIDE, kind == RECORDER], axis=1)
    no, size_of, sd = np.zeros(rows, bool), np.full(process.shape, np.nan), np.full(process.shape, np.nan)
    for k, signal in enumerate(still, start=len(TESTED)):
        i = channels.sensors.index(signal)
        process[:, k] = _off(channels, y, i)
        size_of[process[:, k], k], sd[process[:, k], k] = y[process[:, k], i] - channels.still[signal.name], 0.0
    shown_by = np.zeros((rows, count), np.int64)
    shown_by[:, own] = v.how
    return Decision(
        estimate=np.zeros((rows, 1)), reconstruction=np.where(isolated, y - size, y), residual=residual,
        threshold=np.ones((rows, count)), isolated=isolated, fault_size=np.where(isolated, size, np.nan), diverged=no,
        guarded=no, nis=np.full(rows, np.nan), capped=no, process=process, process_size=size_of, process_sd=sd, suspect=suspect,
        probability=np.full(suspect.shape, np.nan), shown_by=shown_by,
    )  # fmt: skip


def _off(channels: Channels, y: Array, i: int) -> Array:
    """Where a sensor that never moved in the healthy logs has moved (K,)."""
    usual = channels.still.get(channels.sensors[i].name, np.nan)
    return np.asarray(np.isfinite(y[:, i]) & np.isfinite(usual) & (y[:, i] != usual))


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
            how = SHOWN_BY[Counter(v.how[a : b + 1, i][held].tolist()).most_common(1)[0][0]]
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
            for a, b in spans(_off(channels, y, i), JOINED):
                size = median(off[a : b + 1])
                found.append(StillEvent(signal.name, float(t[a]), float(t[b]), size, signal.unit, b == len(t) - 1))
    return found
