"""The two layouts of a log, a column for each sensor or a value a row with its tag, as numbers by time."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import shown, some
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.logs.columns import Sources, find_sources
from fusion_sfdia.logs.findings import Finding, counted
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.mask import mask_titles
from fusion_sfdia.logs.numbers import NotANumberError, Numbers, good_codes
from fusion_sfdia.logs.order import Rows, dropped, twice
from fusion_sfdia.logs.problems import Problems
from fusion_sfdia.logs.tables import Table
from fusion_sfdia.logs.times import UNKNOWN, Expected, Times, times_of, unknown_times

Array = NDArray[Any]
Laid = tuple[Sources, Rows, Times, list[Finding]]


def wide_rows(
    table: Table, plant: Plant, log_map: LogMap, allowed: dict[str, bool], problems: Problems, expected: Expected
) -> Laid:
    """A table with a column for each sensor and input; columns that cannot be read are added to problems, and left out."""
    sources = find_sources(problems, table.titles, table.units, plant, log_map, **allowed)
    needed = [*sources.times, *(c.title for c in sources.columns if c.is_input and not log_map.hold)]
    table = table.with_cells_of(needed)
    if sources.columns or sources.refused:
        with problems.collecting("rows"):
            table.require_rows()
    if not len(table.rows) or not (sources.columns or sources.refused):
        problems.require_none()
    times = unknown_times(len(table.rows))
    if sources.times:
        with problems.collecting("time"):
            times = times_of(table, sources.times, sources.time_unit, log_map, expected=expected)
    findings = [*table.findings]
    values = {}
    also: list[str] = []
    with problems.collecting("mask"):
        also = mask_titles(table.where, table.titles, sources, log_map)
    for title in dict.fromkeys([*(c.title for c in sources.columns), *sources.refused, *also]):
        with problems.collecting("cells", title):
            values[title] = _numbers(table, title, log_map, findings)
    for c in sources.columns:
        if c.quality and c.title in values:
            with problems.collecting("quality", c.quality):
                _apply_quality(table, c.quality, c.title, values[c.title], log_map, findings)
    sources = sources._replace(columns=tuple(c for c in sources.columns if c.title in values))
    return sources, Rows(times.t, np.asarray(table.rows), values), times, findings


def long_rows(
    table: Table, plant: Plant, log_map: LogMap, allowed: dict[str, bool], problems: Problems, expected: Expected
) -> Laid:
    """A table with a value a row, whose tag states of what; what cannot be read is added to problems, and left out."""
    import pandas

    needed = (*log_map.time, log_map.tag, log_map.value, *([log_map.quality] if log_map.quality else []))
    for title in needed:
        if title not in table.titles:
            problems.add("columns", f"no column {shown(title)} among {some(table.titles)}; correct the map")
    with problems.collecting("rows"):
        table.require_rows()
    if log_map.tag not in table.titles or log_map.value not in table.titles or not len(table.rows):
        problems.require_none()
    table = table.with_cells_of([title for title in needed if title in table.titles])
    tags = [str(tag).strip() for tag in table.column(log_map.tag)]
    names = list(dict.fromkeys(tags))
    sources = find_sources(problems, names, [""] * len(names), plant, log_map, **allowed)
    used = {c.title for c in sources.columns}
    with problems.collecting("mask"):
        used |= {*mask_titles(table.where, names, sources, log_map)}
    if not used:
        problems.require_none()
    chosen = np.flatnonzero([tag in used for tag in tags])
    table = table._replace(
        columns=[[column[k] for k in chosen] for column in (list(c) for c in table.columns)],
        rows=[table.rows[int(k)] for k in chosen],
    )
    tags = [tags[k] for k in chosen]
    times = unknown_times(len(tags))
    if {*log_map.time} <= {*table.titles}:
        with problems.collecting("time"):
            times = times_of(table, log_map.time, "", log_map, tags, expected)
    findings = [*table.findings]
    values: Array | None = None
    with problems.collecting("cells", log_map.value):
        values = _numbers(table, log_map.value, log_map, findings)
    if values is not None and log_map.quality in table.titles:
        with problems.collecting("quality", log_map.quality):
            _apply_quality(table, log_map.quality, "", values, log_map, findings)
    if values is None or times.kind == UNKNOWN:
        problems.require_none()
    frame = pandas.DataFrame({"t": times.t, "tag": tags, "value": values, "row": table.rows})
    again = frame.duplicated(["t", "tag"])
    if again.any():
        if log_map.duplicates == "refuse":
            k = int(again.argmax())
            with problems.collecting("order"):
                raise twice(table.text(k), log_map.time[0], times.clock, float(times.t[k]), of=f" of {tags[k]}")
        findings.append(dropped(int(again.sum()), log_map))
    grouped = frame.groupby(["t", "tag"], sort=True)["value"].agg(
        "first" if log_map.duplicates == "refuse" else log_map.duplicates
    )
    wide = grouped.unstack("tag")
    first_rows = frame.groupby("t", sort=True)["row"].min()
    return (
        sources,
        Rows(wide.index.to_numpy(), first_rows.to_numpy(), {title: wide[title].to_numpy() for title in used}),
        times,
        findings,
    )


def _numbers(table: Table, title: str, log_map: LogMap, findings: list[Finding]) -> Array:
    """A column as numbers; what stands for a missing reading is counted among the findings."""
    try:
        values, bad = Numbers.of(log_map).column(table.column(title))
    except NotANumberError as error:
        expected = "a finite number, or nothing where the reading is missing"
        if isinstance(error.cell, str) and not re.search(r"\d", error.cell):
            expected += "; state such a text as `bad` in a map"
        elif isinstance(error.cell, str) and re.search(r"\d[.,' ]\d", error.cell):
            expected += f" (decimal is {log_map.decimal!r}: a map states another)"
        raise ValueError(f"{table.text(error.position)}, column {title}: {shown(error.cell)}; expected {expected}") from error
    if bad.any():
        findings.append(Finding("bad", title, int(bad.sum()), f"{title}: {counted(int(bad.sum()), 'value')} marked as bad"))
    return values


def _apply_quality(table: Table, title: str, of: str, values: Array, log_map: LogMap, findings: list[Finding]) -> None:
    """Make the values missing whose quality is not good."""
    try:
        poor = ~good_codes(table.column(title), log_map.good)
    except NotANumberError as error:
        raise ValueError(
            f"{table.text(error.position)}, column {title}: {shown(error.cell)} as quality; state which codes are good: "
            'good = "opc-da", "opc-ua" or a list, in the map'
        ) from error
    if count := int(np.sum(poor & np.isfinite(values))):
        about = f"{of}: " if of else ""
        findings.append(
            Finding("quality", of, count, f"{about}{counted(count, 'value')} not of good quality, taken as missing")
        )
    values[poor] = np.nan
