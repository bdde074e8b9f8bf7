"""Values with times of their own, a tag a row or a column of times beside each tag, and the rows that they are put in.

Of each tag the value nearest to the time of a row counts, within half a step of the rows; a row without one misses its reading.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.logs.cell_tables import AGAIN, Table
from fusion_sfdia.logs.columns import TIME, split_title, usual_time
from fusion_sfdia.logs.loaded_log import Finding, counted
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.time_order import LogRows

Array = NDArray[Any]

VALUE = r"(?:values?[ _]?y?|val|wert|reading)"
SUFFIX, PREFIX = (re.compile(p, re.I) for p in (rf"(.+?)[ _.:/-]+{TIME}", rf"{TIME}[ _.:/-]+(?:of[ _])?\(?(.+?)\)?"))
OF_VALUE = re.compile(rf"(.+?)[ _.:/-]+{VALUE}", re.I)
FULL = 0.5  # share of the tags in a row, with less of which rows are of single tags


class TimedTags(NamedTuple):
    """A table whose tags have columns of times: times by the title of a tag, and the map with the first of them as the time."""

    table: Table
    log_map: LogMap
    times: dict[str, str]

    @property
    def header(self) -> tuple[list[str], list[str]]:
        """Titles and units without the times of tags, but for those of the map."""
        own = {*self.times.values()} - {*self.log_map.time}
        pairs = [(t, u) for t, u in zip(self.table.titles, self.table.units, strict=True) if t not in own]
        return [t for t, _ in pairs], [u for _, u in pairs]


def tagged(table: Table, log_map: LogMap) -> TimedTags:
    """The table with the columns of times that its tags have: as the map states, by titles that occur again, or by their names.

    Of titles such as "level_1 Time" and "level_1 ValueY" the second is "level_1", unless the map names it.
    """
    if log_map.tag:
        return TimedTags(table, log_map, {})
    titles = table.titles
    times = _by_position(titles, log_map) or _by_name(titles)
    if times and log_map.time[0] not in (*titles, *(split_title(t)[0] for t in titles)):
        log_map = replace(log_map, time=(next(iter(times.values())),))
    named = {n: c for n, c in log_map.columns.items() if c.time}
    times |= {t: c.time for t in titles for n, c in named.items() if n in (t, split_title(t)[0])}
    table, log_map = _with_usual_time(table, log_map)
    names = {}
    for title in times:
        match = OF_VALUE.fullmatch(split_title(title)[0])
        if match and title not in log_map.columns and match[1] not in titles:
            names[title] = match[1]
    table = table._replace(titles=[names.get(t, t) for t in titles])
    return TimedTags(table, log_map, {names.get(title, title): time for title, time in times.items()})


def _with_usual_time(table: Table, log_map: LogMap) -> tuple[Table, LogMap]:
    """The map with the column of times where it states none, none is called "time" and one has a usual title of times."""
    if (usual := usual_time(table.titles, log_map)) is None:
        return table, log_map
    found = Finding("time", "", len(table.rows), f"times are those of the column {usual!r}")
    return table._replace(findings=(*table.findings, found)), replace(log_map, time=(usual,))


def _by_position(titles: Sequence[str], log_map: LogMap) -> dict[str, str]:
    """The columns of times by titles that occur again; each is of the columns behind it, or before it if the first is none."""
    firsts = {m[1] for t in titles if (m := AGAIN.fullmatch(t)) and m[1] in titles}
    firsts = {t for t in firsts if split_title(t)[0] in log_map.time or re.fullmatch(TIME, split_title(t)[0], re.I)}
    if len(firsts) != 1:
        return {}
    (first,) = firsts
    places = [k for k, t in enumerate(titles) if t == first or ((m := AGAIN.fullmatch(t)) and m[1] == first)]
    found = {}
    for k, title in enumerate(titles):
        beside = [p for p in places if p < k][-1:] if places[0] == 0 else [p for p in places if p > k][:1]
        if k not in places and beside:
            found[title] = titles[beside[0]]
    return found


def _by_name(titles: Sequence[str]) -> dict[str, str]:
    """The columns of times by names such as "level_1 Time", where at least half of the others have one, and two."""
    by_base = {}
    for title in titles:
        name = split_title(title)[0]
        if match := SUFFIX.fullmatch(name) or PREFIX.fullmatch(name):
            by_base[match[1].casefold()] = title
    found = {}
    for title in titles:
        name = split_title(title)[0]
        match = OF_VALUE.fullmatch(name)
        for base in (name, match[1] if match else name):
            if (time := by_base.get(base.casefold())) and time != title:
                found[title] = time
    others = [t for t in titles if t not in found and t not in found.values()]
    return found if len({*found.values()}) > 1 and len(found) >= len(others) else {}


def filled(cells: Any) -> Array:
    """Whether a cell (K,) holds anything."""
    if isinstance(cells, np.ndarray):
        return ~np.isnan(cells)
    if hasattr(cells, "isna"):
        present: Array = np.asarray(~cells.isna())
        return present if cells.dtype.kind != "O" else present & np.array([str(c).strip() != "" for c in cells])
    return np.array([c is not None and str(c).strip() != "" for c in cells], dtype=bool)


def stacked(parts: Sequence[Any]) -> Any:
    """Columns below each other."""
    if all(isinstance(p, np.ndarray) for p in parts):
        return np.concatenate(parts)
    if all(hasattr(p, "isna") for p in parts):
        import pandas

        return pandas.concat([p.to_series() if isinstance(p, pandas.Index) else p for p in parts], ignore_index=True)
    return list(chain.from_iterable(parts))


def step_of(t: Array, codes: Array, tags: int, log_map: LogMap, dt: float | None) -> float:
    """The step (s) of the rows that values at t (K,) of tags are put in: the map's, or dt, or 0 where each time is a row.

    Rows of single tags that follow each other within half of dt are put together. dt: None takes the usual step of a tag.
    """
    if log_map.step or tags < 2:
        return log_map.step
    at = np.unique(t)
    if at.size < 2 or t.size > FULL * at.size * tags:
        return 0.0
    if dt is None:
        own = [np.median(steps[steps > 0]) for c in range(tags) if np.any((steps := np.diff(np.sort(t[codes == c]))) > 0)]
        dt = float(np.median(own)) if own else 0.0
    return dt if np.median(np.diff(at)) < dt / 2 else 0.0


def on_grid(frame: Any, names: Sequence[str], step: float, clock: Clock) -> tuple[LogRows, Finding]:
    """Values of tags, a frame of t, tag (number of the name), value and row, in rows a step apart, and a finding on that.

    The times of the rows are whole steps of the wall clock where all values are near them; where tags have others, rows are
    parted where the fewest values are. Rows without any value are left out.
    """
    t, codes, values, rows = (frame[name].to_numpy() for name in ("t", "tag", "value", "row"))
    start = clock.start
    midnight = 0.0 if start is None else start.hour * 3600.0 + start.minute * 60.0 + start.second + start.microsecond * 1e-6
    x = t + midnight
    off = x - np.round(x / step) * step
    phase = 0.0
    one_a_row = t.size <= 1.2 * len(names) * max(np.ptp(t) / step, 1.0)
    if np.max(np.abs(off)) > step / 4 and one_a_row:
        places = np.unique(np.round(np.mod(off, step), 6))
        gaps = np.diff(np.append(places, places[0] + step))
        if gaps.max() > step / 4:
            phase = float(np.mod(places[np.argmax(gaps)] + gaps.max() / 2 + step / 2, step))
    k = np.round((x - phase) / step)
    away = np.abs(x - phase - k * step)
    known = np.isfinite(values)
    order = np.lexsort((away, codes, k))
    order = order[known[order]]
    taken = order[np.flatnonzero((np.diff(k[order], prepend=-np.inf) != 0) | (np.diff(codes[order], prepend=-1) != 0))]
    grid, inverse = np.unique(k, return_inverse=True)
    wide = np.full((len(names), grid.size), np.nan)
    wide[codes[taken], inverse[taken]] = values[taken]
    first = np.full(grid.size, np.iinfo(np.int64).max)
    np.minimum.at(first, inverse, rows)
    left = int(known.sum()) - taken.size
    text = (
        f"{counted(len(names), 'tag')} with times of their own in rows {step:.6g} s apart: of each the value nearest in time, "
        f"at most {float(away[taken].max()) if taken.size else 0.0:.6g} s away"
    )
    text += f"; {counted(left, 'value')} between these left out" if left else ""
    at = grid * step + phase - midnight
    return LogRows(at, first, dict(zip(names, wide, strict=True))), Finding("grid", "", grid.size, text)
