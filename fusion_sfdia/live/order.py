"""Rows in the order of their times: what is late, what waits for its neighbours, and what a clock that is wrong makes of it."""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.clock import Clock
from fusion_sfdia.logs.findings import counted

Array = NDArray[Any]

MOST_HELD = 10_000  # rows


class Row(NamedTuple):
    """Readings y (N,) at t (s), NaN where missing, and the inputs u (m,) as they came."""

    t: float
    y: Array
    u: Array


@dataclass
class InOrder:
    """Takes rows as they arrive and returns them in order, each with the seconds to the next one where that is known.

    A row is held until one has arrived that is `reorder` s later, or more than MOST_HELD are held, and is returned in its
    place. A row is late, and lost, where one after it was returned and diagnosed. Of rows with equal times, duplicates, the
    first counts, since what is diagnosed cannot be taken back; or, if keep_last, the last of those that are held. The first
    row, and one later than all others by more than `longest_gap` s, wait for the next row: if that is earlier by more than
    `reorder`, the clock of the waiting row was wrong, and it is lost.
    """

    reorder: float
    longest_gap: float
    refused: Callable[[str], None]
    keep_last: bool = False
    held: list[Row] = field(default_factory=list)  # by time
    waiting: Row | None = None
    late: int = 0  # rows since the last one that was not
    again: Counter[str] = field(default_factory=Counter)  # duplicates since the last row that was none, by what was kept
    loaded: float | None = None  # s, the last row of a loaded state: until another is diagnosed, no line about rows it has

    def push(self, row: Row, last: float | None, clock: Clock) -> list[tuple[Row, float]]:
        """Rows that are due when `row` has arrived; last: the time of the last row diagnosed."""
        if self.keep_last and self._replaced(row):
            self.again["last"] += 1
            return []
        if self._is_late(row.t, last, clock):
            return []
        if (waited := self.waiting) is not None:
            self.waiting = None
            if row.t > waited.t - self.reorder:
                insort(self.held, waited, key=_time)
            else:
                where = clock.at(waited.t)
                self.refused(f"row at {where}: it is later than the row after it, at {clock.at(row.t)}; it is not taken")
        newest = self.held[-1].t if self.held else last
        if newest is None or row.t - newest > self.longest_gap:
            self.waiting = row
        else:
            insort(self.held, row, key=_time)
        if not self.held:
            return []
        due = bisect_right(self.held, self.held[-1].t - self.reorder, key=_time)
        return self._returned(max(due, len(self.held) - MOST_HELD))

    def rest(self) -> list[tuple[Row, float]]:
        """The rows that are held, at the end of the input."""
        self._count_duplicates()
        return self._returned(len(self.held))

    def _returned(self, count: int) -> list[tuple[Row, float]]:
        rows, next_ones = self.held[:count], self.held[1 : count + 1]
        del self.held[:count]
        ahead = [b.t - a.t for a, b in zip(rows, next_ones, strict=False)]
        return list(zip(rows, [*ahead, np.inf][:count], strict=True))

    def _is_late(self, t: float, last: float | None, clock: Clock) -> bool:
        """Whether a row at t is late or a duplicate, and a line for a run of such rows."""
        k = bisect_left(self.held, t, key=_time)
        same = any(row.t == t for row in (*self.held[k : k + 1], *([self.waiting] if self.waiting else [])))
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

    def _replaced(self, row: Row) -> bool:
        """Whether a row with its time is held or waits; it has taken its place."""
        k = bisect_left(self.held, row.t, key=_time)
        if self.held[k : k + 1] and self.held[k].t == row.t:
            self.held[k] = row
        elif self.waiting is not None and self.waiting.t == row.t:
            self.waiting = row
        else:
            return False
        return True

    def _count_duplicates(self) -> None:
        for kept, count in self.again.items():
            if count:
                self.refused(f"{counted(count, 'duplicate')} dropped, the {kept} row of each time kept")
        self.again.clear()


def _time(row: Row) -> float:
    return row.t
