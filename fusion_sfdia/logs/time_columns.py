"""Which columns of a table hold its times, where no map states them, and in which formats they can be read."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fusion_sfdia.logs.cell_tables import Table
from fusion_sfdia.logs.columns import split_title
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.times import ANY, Expected, Times, times_of

TIME_TITLE = re.compile(r"time|stamp|date|datum|zeit|tijd|uhr|heure|hora|fecha|\bts\b|^t$", re.I)
STAMP = re.compile(r"\d{1,4}[-/.]\w{1,3}[-/.]\d{1,4}")
DAY = re.compile(rf"{STAMP.pattern}|\d{{8}}")
CLOCK = re.compile(r"\d{1,2}:\d\d(?::\d\d(?:[.,]\d+)?)?(?:\s*[ap]m)?", re.I)
HEAD = 20  # rows that show a format where another cell of the column is no time
MOST_BACK = 0.2  # share of rows that may go back


class TimeColumns(NamedTuple):
    """The titles of the columns of times, one or two that are joined, and the formats, "" for none, with the times: likeliest
    first.
    """

    titles: tuple[str, ...]
    ways: list[tuple[str, Times]]

    @property
    def names(self) -> tuple[str, ...]:
        """What a map states as `time`."""
        return self.titles if len(self.titles) > 1 else (split_title(self.titles[0])[0],)

    @property
    def statement(self) -> str:
        """The keys of a map that state it."""
        names = [json.dumps(name, ensure_ascii=False) for name in self.names]
        time = f"time = {names[0]}" if len(names) == 1 else f"time = [{', '.join(names)}]"
        formats = [f'"{form}"' for form, _ in self.ways if form]
        return f"{time}, format = {' or '.join(formats)}" if formats else time


def time_columns(table: Table, log_map: LogMap, expected: Expected = ANY) -> TimeColumns | None:
    """Return the columns of a table that hold its times: a date and a time of day, or one with such a title or with stamps."""
    firsts = {title: _first_text(table, title) for title in table.titles if title}
    days = [title for title, text in firsts.items() if DAY.fullmatch(text)]
    clocks = [title for title, text in firsts.items() if CLOCK.fullmatch(text)]
    named = [title for title in firsts if TIME_TITLE.search(split_title(title)[0])]
    stamped = [title for title, text in firsts.items() if STAMP.match(text)]
    pairs: list[tuple[str, ...]] = [(days[0], clocks[0])] if days and clocks else []
    singles: list[tuple[str, ...]] = [(title,) for title in (*named, *stamped, *list(firsts)[:1])]
    for titles in dict.fromkeys([*pairs, *singles]):
        unit = split_title(titles[0])[1] if len(titles) == 1 else ""
        if ways := [way for way in ways_of_reading(table, titles, unit, log_map, expected) if _runs_on(way[1])]:
            return TimeColumns(titles, ways)
    return None


def ways_of_reading(
    table: Table, titles: Sequence[str], unit: str, log_map: LogMap, expected: Expected = ANY
) -> list[tuple[str, Times]]:
    """The formats in which columns are times, and the times, likeliest first: those that a refusal of `times_of` names.

    Where a single cell is no time, those of the first rows, HEAD of them.
    """
    for part in (table, _head(table)):
        try:
            return [("", times_of(part, titles, unit, log_map, expected=expected))]
        except ValueError as error:
            named = dict.fromkeys(re.findall(r'format = "([^"]+)"', str(error)))
        found = []
        for form in named:
            try:
                found.append((form, times_of(part, titles, unit, replace(log_map, format=form), expected=expected)))
            except ValueError:
                continue
        if found:
            return sorted(found, key=_unlikely)
    return []


def _unlikely(way: tuple[str, Times]) -> tuple[float, int, bool]:
    """Of a way of reading times: the share of rows that go back, the days from first to last, whether the month comes first
    with the hours of a day of 24, or last with those of 12.
    """
    form, times = way
    return round(_backwards(times), 2), round(float(np.ptp(times.t)) / 86400.0), form.startswith("%m") != ("%p" in form)


def _head(table: Table) -> Table:
    rows = slice(0, min(HEAD, len(table.rows)))
    return table._replace(columns=[list(c)[rows] for c in table.columns], rows=list(table.rows)[rows])


def _backwards(times: Times) -> float:
    """The share of the steps that go back; of a log whose newest row comes first, of those that go forward."""
    steps = np.diff(times.t)
    return min(float(np.mean(steps < 0)), float(np.mean(steps > 0))) if steps.size else 0.0


def _runs_on(times: Times) -> bool:
    """Whether times are those of rows that follow each other."""
    return times.t.size < 3 or (_backwards(times) < MOST_BACK and float(np.ptp(times.t)) > 0)


def _first_text(table: Table, title: str) -> str:
    return next((text for cell in table.column(title) if (text := str(cell).strip())), "")
