"""The rows of a log in the order of their times, one for each time."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.clock import Clock
from fusion_sfdia.logs.findings import Finding, counted
from fusion_sfdia.logs.log_map import LogMap

Array = NDArray[Any]


class Rows(NamedTuple):
    """A log by time: t (K,), the row of each time in the file, and the numbers of each column (K,) as logged."""

    t: Array
    rows: Array
    values: dict[str, Array]

    def kept(self, chosen: Array) -> Rows:
        return Rows(self.t[chosen], self.rows[chosen], {title: v[chosen] for title, v in self.values.items()})


def in_order(where: str, rows: Rows, clock: Clock, log_map: LogMap, findings: list[Finding]) -> Rows:
    """The rows with increasing times: sorted, and one for each time, as the map has it; ValueError where it refuses."""
    back = np.flatnonzero(np.diff(rows.t) < 0)
    if back.size:
        if log_map.order == "refuse":
            k = int(back[0]) + 1
            raise ValueError(
                f"{where}, row {rows.rows[k]}, column {' '.join(log_map.time)}: {_at(clock, rows.t[k])} after "
                f'{_at(clock, rows.t[k - 1])}; times must increase: sort the rows, or state order = "sort" in a map'
            )
        rows = rows.kept(np.argsort(rows.t, kind="stable"))
        newest = back.size == np.count_nonzero(np.diff(rows.t)) and back.size > 1
        text = "rows sorted by time" + (": the newest came first" if newest else f", {back.size} came after a later one")
        findings.append(Finding("order", "", back.size, text))
    again = np.flatnonzero(np.diff(rows.t) == 0) + 1
    if again.size:
        if log_map.duplicates == "refuse":
            k = int(again[0])
            raise twice(f"{where}, row {rows.rows[k]}", " ".join(log_map.time), _at(clock, rows.t[k]), rows.rows[k - 1])
        findings.append(dropped(again.size, log_map))
        import pandas

        by_time = pandas.DataFrame(rows.values).groupby(rows.t, sort=True)
        merged = by_time.agg(log_map.duplicates) if rows.values else None
        first = np.flatnonzero(np.diff(rows.t, prepend=-np.inf) > 0)
        rows = Rows(
            rows.t[first], rows.rows[first], {n: merged[n].to_numpy() for n in rows.values} if merged is not None else {}
        )
    return rows


def twice(row: str, column: str, at: str, other: int | None = None) -> ValueError:
    """The error on a second value at one time."""
    before = "" if other is None else f", as in row {other}"
    return ValueError(
        f"{row}, column {column}: {at} again{before}; times must increase: keep one row of each time, or state "
        'duplicates = "first", "last" or "mean" in a map'
    )


def dropped(count: int, log_map: LogMap) -> Finding:
    """The finding on values at one time, of which one is kept."""
    fate = "averaged" if log_map.duplicates == "mean" else f"dropped, the {log_map.duplicates} of each time kept"
    return Finding("duplicates", "", count, f"{counted(count, 'duplicate')} {fate}")


def _at(clock: Clock, t: float) -> str:
    return f"{float(t)!r} s" if clock.start is None else clock.at(float(t))
