"""Rows in the order of their times: what is late, what waits for its neighbours, and what a clock that is wrong makes of it."""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.logs.loaded_log import counted

Array = NDArray[Any]

MOST_HELD = 10_000  # rows
JUMP = 5.0  # usual distances between rows; a row that is further ahead waits
CONFIRMING = 3  # rows from a jump on, with which its time counts


class WatchRow(NamedTuple):
    """Readings y (N,) at t (s), NaN where missing, and the inputs u (m,) as they came."""

    t: float
    y: Array
    u: Array


@dataclass
class InOrder:
    """Takes rows as they arrive and returns them in order, each with the seconds to the next one where that is known.

    A row is held until one has arrived that is `reorder` s later, or more than MOST_HELD are held, and is returned in its
    place. A row is late, and lost, where one after it was returned and diagnosed. Of rows with equal times, duplicates, the
    first counts, since what is diagnosed cannot be taken back; or, if keep_last, the last of those that are held.

    A row that is ahead of all others by more than JUMP times the usual distance of the rows, which is at least `step` s, or by
    more than `longest_gap` s, waits until CONFIRMING rows, itself among them, have times from its own on. The first row waits
    for the next one. Where meanwhile a row comes that is earlier by more than `reorder`, the clock of the waiting rows was
    wrong: they are lost, and the others go on.
    """

    reorder: float
    longest_gap: float
    refused: Callable[[str], None]
    keep_last: bool = False
    step: float = np.inf
    held: list[WatchRow] = field(default_factory=list)  # by time
    waiting: list[WatchRow] = field(default_factory=list)  # by time, after those that are held
    distances: deque[float] = field(default_factory=lambda: deque(maxlen=5))  # s, between the last rows returned
    late: int = 0  # rows since the last one that was not
    again: Counter[str] = field(default_factory=Counter)  # duplicates since the last row that was none, by what was kept
    loaded: float | None = None  # s, the last row of a loaded state: until another is diagnosed, no line about rows it has

    def push(self, row: WatchRow, last: float | None, clock: Clock) -> list[tuple[WatchRow, float]]:
        """Rows that are due when `row` has arrived; last: the time of the last row diagnosed."""
        if self.keep_last and self._replaced(row):
            self.again["last"] += 1
            return []
        if self._is_late(row.t, last, clock):
            return []
        newest = self.held[-1].t if self.held else last
        if self.waiting and row.t < self.waiting[0].t - self.reorder:
            self._refuse(f"it is later than the row after it, at {clock.at(row.t)}", clock)
        if self.waiting:
            insort(self.waiting, row, key=_time)
            if len(self.waiting) >= (2 if newest is None else CONFIRMING):
                self.held += self.waiting
                self.held.sort(key=_time)
                self.waiting = []
                if newest is None and self._jumps(row.t, self.held[0].t):
                    self.waiting = [self.held.pop()]
        elif newest is None or self._jumps(row.t, newest):
            self.waiting = [row]
        else:
            insort(self.held, row, key=_time)
        if not self.held:
            return []
        due = bisect_right(self.held, self.held[-1].t - self.reorder, key=_time)
        return self._returned(max(due, len(self.held) - MOST_HELD), last)

    def remaining(self, last: float | None, clock: Clock) -> list[tuple[WatchRow, float]]:
        """The rows that are held, at the end of the input; of those that wait, a single one ahead of others is lost."""
        self._count_duplicates()
        if len(self.waiting) == 1 and (self.held or last is not None):
            self._refuse("it is far later than the row before it, and no row after it confirms its time", clock)
        self.held += self.waiting
        self.waiting = []
        return self._returned(len(self.held), last)

    def _jumps(self, t: float, newest: float) -> bool:
        """Whether a row at t is further from the newest one than rows usually are."""
        usual = max(self.step, median(self.distances) if self.distances else 0.0)
        return t - newest > min(JUMP * usual, self.longest_gap)

    def _refuse(self, why: str, clock: Clock) -> None:
        """Lose the rows that wait, with one line."""
        first, *others = self.waiting
        more = f" and {counted(len(others), 'row')} after it" if others else ""
        self.refused(f"row at {clock.at(first.t)}{more}: {why}; {'they are' if others else 'it is'} not taken")
        self.waiting = []

    def _returned(self, count: int, last: float | None) -> list[tuple[WatchRow, float]]:
        rows, next_ones = self.held[:count], self.held[1 : count + 1]
        del self.held[:count]
        ahead = [b.t - a.t for a, b in zip(rows, next_ones, strict=False)]
        before = [last, *(row.t for row in rows)] if last is not None else [row.t for row in rows]
        self.distances.extend(b - a for a, b in pairwise(before))
        return list(zip(rows, [*ahead, np.inf][:count], strict=True))

    def _is_late(self, t: float, last: float | None, clock: Clock) -> bool:
        """Whether a row at t is late or a duplicate, and a line for a run of such rows."""
        k = bisect_left(self.held, t, key=_time)
        same = any(row.t == t for row in (*self.held[k : k + 1], *self.waiting))
        said = last is None or last != self.loaded
        if (same or t == last) and not self.late:
            self.again["first"] += said
            return True
        self._count_duplicates()
        last = t if same else last
        if last is None or t > last:
            if self.late:
                self.refused(f"{counted(self.late, 'row')} until {clock.at(t)} not taken")
            self.late = 0
            return False
        if not self.late and said:
            self.refused(
                f"row at {clock.at(t)}: it is earlier than the last one, at {clock.at(last)}; it is not taken, nor "
                "is another until then; start with a new state if the clock was set back"
            )
        self.late += said
        return True

    def _replaced(self, row: WatchRow) -> bool:
        """Whether a row with its time is held or waits; it has taken its place."""
        for rows in (self.held, self.waiting):
            k = bisect_left(rows, row.t, key=_time)
            if rows[k : k + 1] and rows[k].t == row.t:
                rows[k] = row
                return True
        return False

    def _count_duplicates(self) -> None:
        for kept, count in self.again.items():
            if count:
                self.refused(f"{counted(count, 'duplicate')} dropped, the {kept} row of each time kept")
        self.again.clear()


def _time(row: WatchRow) -> float:
    return row.t
