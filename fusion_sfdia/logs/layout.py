"""The two layouts of a log, a column for each sensor or a value a row with its tag, as numbers by time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown, some
from fusion_sfdia.logs.cell_tables import Table
from fusion_sfdia.logs.cells import Quality, cell_units, compared_values, values_of
from fusion_sfdia.logs.columns import Sources, find_sources, split_title
from fusion_sfdia.logs.grid import filled, on_grid, stacked, step_of, tagged
from fusion_sfdia.logs.loaded_log import Finding
from fusion_sfdia.logs.log_map import SPREAD, LogMap
from fusion_sfdia.logs.mask import mask_titles
from fusion_sfdia.logs.problems import Problems
from fusion_sfdia.logs.time_columns import time_columns, ways_of_reading
from fusion_sfdia.logs.time_order import LogRows, dropped, require_one_clock, spread, spread_finding, twice
from fusion_sfdia.logs.times import UNKNOWN, Expected, Times, times_of, unknown_times
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
Laid = tuple[Sources, LogRows, Times, list[Finding]]


def wide_rows(
    table: Table, plant: Plant, log_map: LogMap, allowed: dict[str, bool], problems: Problems, expected: Expected
) -> Laid:
    """A table with a column for each sensor and input; columns that cannot be read are added to problems, and left out."""
    table, log_map, own = found = tagged(table, log_map)
    titles, units = found.header
    sources = find_sources(problems, titles, units, plant, log_map, **allowed)
    likely = None
    if not sources.times and not own and len(table.rows):
        if likely := time_columns(table, log_map, expected):
            problems.amend("time", f": {likely.statement}")
    if not own:
        needed = [*sources.times, *(c.title for c in sources.columns if c.is_input and not log_map.hold)]
        table = table.with_cells_of(needed)
    if sources.columns or sources.refused:
        with problems.collecting("rows"):
            table.require_rows()
    if not len(table.rows) or not (sources.columns or sources.refused):
        problems.require_none()
    findings = [*table.findings]
    values = {}
    also: list[str] = []
    with problems.collecting("mask"):
        also = mask_titles(table.where, table.titles, sources, log_map)
    times = unknown_times(len(table.rows))
    if sources.times and not (own or log_map.step):
        with problems.collecting("time"):
            times = times_of(table, sources.times, sources.time_unit, log_map, expected=expected)
    if times.kind == UNKNOWN and not (own or log_map.step):  # with their order, which is looked at, too
        ways = likely.ways if likely else []
        if sources.times:
            ways = ways_of_reading(table, sources.times, sources.time_unit, log_map, expected)
        times = next((way for _, way in ways if way.t.size == times.t.size), times)
    read, quality = [], Quality(log_map, Counter(), [])
    for c in sources.columns:
        with problems.collecting("cells", c.title):
            values[c.title], in_its_unit = values_of(table, c, plant, findings)
            read.append(in_its_unit)
    for title in dict.fromkeys([*sources.refused, *also]):
        if title not in values:
            with problems.collecting("cells", title):
                values[title] = compared_values(table, title, log_map, findings)
    for c in read:
        if c.quality:
            with problems.collecting("quality", c.quality):
                quality.apply(table, c.quality, c.title, values[c.title], findings)
    with problems.collecting("quality"):
        quality.require_good(table.where)
    findings += cell_units(sources.columns, read)
    sources = sources._replace(columns=tuple(read))
    rows = LogRows(times.t, np.asarray(table.rows), values)
    if sources.times and (own or log_map.step):
        with problems.collecting("time"):
            rows, times = _by_own_times(table, own, sources, values, log_map, expected, findings, problems)
    return sources, rows, times, findings


def _by_own_times(
    table: Table,
    own: dict[str, str],
    sources: Sources,
    values: dict[str, Array],
    log_map: LogMap,
    expected: Expected,
    findings: list[Finding],
    problems: Problems,
) -> tuple[LogRows, Times]:
    """The rows of columns of which each may have times of its own; a column without takes those of the map."""
    names, cells, rows, codes = list(values), [], [], []
    for code, name in enumerate(names):
        of = (own[name],) if name in own else sources.times
        if of[0] not in table.titles:
            raise ValueError(f"{table.where}: no column {shown(of[0])} with the times of {shown(name)}; correct the map")
        timed = filled(table.column(of[0]))
        if (untimed := np.isfinite(values[name]) & ~timed).any():
            k = int(np.argmax(untimed))
            raise ValueError(f"{table.text(k)}, column {of[0]}: ''; expected the time of the value of {name}")
        chosen = np.flatnonzero(timed)
        columns = [
            [column[k] for k in chosen] if isinstance(column, list) else column[chosen] for column in map(table.column, of)
        ]
        cells.append(columns[0] if len(of) == 1 else [" ".join(map(str, pair)) for pair in zip(*columns, strict=True)])
        rows.append(chosen)
        codes.append(np.full(chosen.size, code))
    at, code_of = np.concatenate(rows), np.concatenate(codes)
    below = Table(table.where, [" ".join(log_map.time)], [stacked(cells)], [table.rows[k] for k in at], [""])
    unit = sources.time_unit or next((split_title(t)[1] for t in own.values()), "")
    times = times_of(below, below.titles, "" if log_map.format else unit, log_map, code_of, expected)
    numbers = np.concatenate([values[name][k] for name, k in zip(names, rows, strict=True)])
    return _of_tags(TaggedValues(below, names, code_of, numbers, times), log_map, expected, findings, problems), times


class TaggedValues(NamedTuple):
    """Values (K,) a row of a table, each with its time: of the tags at these positions, `codes` (K,), among the names."""

    table: Table
    names: Sequence[str]
    codes: Array
    values: Array
    times: Times


def _of_tags(tagged: TaggedValues, log_map: LogMap, expected: Expected, findings: list[Finding], problems: Problems) -> LogRows:
    """The rows of values of several tags: at each time a row, or in rows a step apart."""
    import pandas

    table, names, codes, values, times = tagged
    t, numbers = times.t, np.asarray(table.rows)
    for code, name in enumerate(names):
        of = np.flatnonzero(codes == code)
        with problems.collecting("order"):
            require_one_clock(table.where, LogRows(t[of], numbers[of], {name: values[of]}), times.clock, log_map)
        if problems.of("order"):
            break
        if log_map.duplicates == SPREAD:
            of = of[np.argsort(t[of], kind="stable")]
            t = t.copy()
            t[of] = spread(t[of])
    if spread_count := int(np.sum(t != times.t)):
        findings.append(spread_finding(spread_count))
    frame = pandas.DataFrame({"t": t, "tag": codes, "value": values, "row": numbers})
    duplicated = frame.duplicated(["t", "tag"])
    if duplicated.any() and not problems.of("order"):
        if log_map.duplicates in ("refuse", SPREAD):
            k = int(duplicated.argmax())
            with problems.collecting("order"):
                count, of_tag = int(duplicated.sum()), f" of {names[codes[k]]}"
                raise twice(table.text(k), " ".join(log_map.time), times.clock, float(t[k]), count, of=of_tag)
        else:
            findings.append(dropped(int(duplicated.sum()), log_map))
    if duplicated.any():
        which = log_map.duplicates if log_map.duplicates in ("first", "last", "mean") else "first"
        frame = frame.groupby(["t", "tag"], sort=True, as_index=False).agg({"value": which, "row": "min"})
    if step := step_of(frame["t"].to_numpy(), frame["tag"].to_numpy(), len(names), log_map, expected.dt):
        rows, finding = on_grid(frame, names, step, times.clock)
        findings.append(finding)
        return rows
    at, inverse = np.unique(frame["t"].to_numpy(), return_inverse=True)
    wide = np.full((len(names), at.size), np.nan)
    wide[frame["tag"].to_numpy(), inverse] = frame["value"].to_numpy()
    first = frame.groupby("t", sort=True)["row"].min().to_numpy()
    return LogRows(at, first, dict(zip(names, wide, strict=True)))


def long_rows(
    table: Table, plant: Plant, log_map: LogMap, allowed: dict[str, bool], problems: Problems, expected: Expected
) -> Laid:
    """A table with a value a row, whose tag states of what; what cannot be read is added to problems, and left out."""
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
    table = _part(table, chosen)
    tags = [tags[k] for k in chosen]
    times = unknown_times(len(tags))
    if {*log_map.time} <= {*table.titles}:
        with problems.collecting("time"):
            times = times_of(table, log_map.time, "", log_map, tags, expected)
    findings = [*table.findings]
    names = list(dict.fromkeys(tags))
    number = {name: code for code, name in enumerate(names)}
    codes = np.array([number[tag] for tag in tags])
    values, read, quality = np.full(len(tags), np.nan), [], Quality(log_map, Counter(), [])
    for c in sources.columns:
        of_tag = np.flatnonzero(codes == number[c.title])
        with problems.collecting("cells", log_map.value):
            one = _part(table, of_tag)
            values[of_tag], in_its_unit = values_of(one, c._replace(title=log_map.value), plant, findings)
            read.append(in_its_unit._replace(title=c.title))
    for tag in {*names} - {c.title for c in sources.columns}:
        of_tag = np.flatnonzero(codes == number[tag])
        with problems.collecting("cells", log_map.value):
            values[of_tag] = compared_values(_part(table, of_tag), log_map.value, log_map, findings)
    if log_map.quality in table.titles:
        with problems.collecting("quality", log_map.quality):
            quality.apply(table, log_map.quality, "", values, findings)
            quality.require_good(table.where)
    findings += cell_units(sources.columns, read)
    sources = sources._replace(columns=tuple(read))
    if problems.of("cells") or times.kind == UNKNOWN:
        problems.require_none()
    tagged = TaggedValues(table, names, codes, values, times)
    return sources, _of_tags(tagged, log_map, expected, findings, problems), times, findings


def _part(table: Table, positions: Array) -> Table:
    """The rows of a table at these positions."""
    columns = [[c[k] for k in positions] if isinstance(c, list) else c.take(positions) for c in table.columns]
    return table._replace(columns=columns, rows=[table.rows[int(k)] for k in positions])
