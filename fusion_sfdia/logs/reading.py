"""From a log, as CSV, Parquet or a pandas frame, to readings and inputs of a plant."""

from __future__ import annotations

import operator
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import shown
from fusion_sfdia.core.clock import Clock
from fusion_sfdia.core.log import Log, require_within_limits, usual_inputs
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.logs.columns import Source, Sources, find_sources, require_columns_of
from fusion_sfdia.logs.findings import Finding, LoadedLog, counted
from fusion_sfdia.logs.log_map import AT_THE_SAMPLE, PLAIN_MAP, LogMap, load_map
from fusion_sfdia.logs.numbers import NotANumberError, Numbers, good_codes
from fusion_sfdia.logs.overview import overview
from fusion_sfdia.logs.suspects import suspected_units
from fusion_sfdia.logs.tables import Table, read_table, some
from fusion_sfdia.logs.times import Times, times_of

Array = NDArray[Any]

COMPARISONS = {"<=": operator.le, ">=": operator.ge, "==": operator.eq, "!=": operator.ne, "<": operator.lt, ">": operator.gt}
MASK = re.compile(r"(.+?)\s*(<=|>=|==|!=|<|>)\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)", re.ASCII)


class Rows(NamedTuple):
    """A log by time: t (K,), the row of each time in the file, and the numbers of each column (K,) as logged."""

    t: Array
    rows: Array
    values: dict[str, Array]

    def kept(self, chosen: Array) -> Rows:
        return Rows(self.t[chosen], self.rows[chosen], {title: v[chosen] for title, v in self.values.items()})


def load_log(
    source: Any,
    plant: Plant,
    log_map: LogMap | str | Path | None = None,
    *,
    absent_sensors: bool = False,
    other_columns: bool = False,
    nominal_inputs: bool = False,
) -> LoadedLog:
    """Read a log of a plant: its readings and inputs in the plant's units, its wall-clock start, and what was found and done.

    source: a CSV file, a Parquet file (.parquet, .pq) or a pandas frame. log_map: a LogMap or its file; without one the
    columns have the plant's names, with or without their unit in brackets, and inputs acted until their row, as `simulate`
    and `write_log` write them. Times are seconds, numbers since 1970 or ISO stamps; of the last two t begins at 0.
    absent_sensors: a sensor without a column is NaN throughout. other_columns: columns that are neither are ignored.
    nominal_inputs: inputs without a column are the plant's operation (plant.input_at) at the reading before, or dt before
    where that is later. ValueError naming file, row (of a file the header is row 1) and column for anything else than times
    in order, finite or missing readings, and inputs that are known and within their limits.
    """
    chosen = load_map(log_map) if isinstance(log_map, str | Path) else log_map or PLAIN_MAP
    require_columns_of(plant, chosen)
    table = read_table(source, chosen)
    allowed = {"absent": absent_sensors, "other": other_columns, "nominal": nominal_inputs}
    read = _long if chosen.tag else _wide
    sources, rows, times, findings = read(table, plant, chosen, allowed)
    rows = _in_order(table.where, rows, times.clock, chosen, findings)
    masked = _masked(table.where, rows, sources, chosen)
    log = _log(table.where, rows, sources, plant, chosen, masked, findings)
    if sources.ignored:
        count = len(sources.ignored)
        findings.append(Finding("ignored", "", count, f"{counted(count, 'column')} not used: {some(sources.ignored)}"))
    findings += suspected_units(plant, log)
    return LoadedLog(log, times.clock, (*overview(plant, log, times), *findings))


def _wide(table: Table, plant: Plant, log_map: LogMap, allowed: dict[str, bool]) -> tuple[Sources, Rows, Times, list[Finding]]:
    """A table with a column for each sensor and input."""
    sources = find_sources(table.where, table.titles, table.units, plant, log_map, **allowed)
    times = times_of(table, sources.times, sources.time_unit, log_map)
    findings: list[Finding] = []
    values = {}
    also = [title for title in _mask_titles(table.where, table.titles, sources, log_map)]
    for title in [*(c.title for c in sources.columns), *also]:
        values[title] = _numbers(table, title, log_map, findings)
    for c in sources.columns:
        if c.quality:
            _apply_quality(table, c.quality, c.title, values[c.title], log_map, findings)
    return sources, Rows(times.t, np.asarray(table.rows), values), times, findings


def _long(table: Table, plant: Plant, log_map: LogMap, allowed: dict[str, bool]) -> tuple[Sources, Rows, Times, list[Finding]]:
    """A table with a value a row: the tag says of what."""
    import pandas

    for title in (*log_map.time, log_map.tag, log_map.value, *([log_map.quality] if log_map.quality else [])):
        if title not in table.titles:
            raise ValueError(f"{table.where}: no column {shown(title)} among {some(table.titles)}; correct the map")
    tags = [str(tag).strip() for tag in table.column(log_map.tag)]
    names = list(dict.fromkeys(tags))
    sources = find_sources(table.where, names, [""] * len(names), plant, log_map, **allowed)
    used = {c.title for c in sources.columns} | {*_mask_titles(table.where, names, sources, log_map)}
    chosen = np.flatnonzero([tag in used for tag in tags])
    table = Table(
        table.where,
        table.titles,
        [[column[k] for k in chosen] for column in (list(c) for c in table.columns)],
        [table.rows[k] for k in chosen],
        table.units,
    )
    tags = [tags[k] for k in chosen]
    times = times_of(table, log_map.time, "", log_map, tags)
    findings: list[Finding] = []
    values = _numbers(table, log_map.value, log_map, findings)
    if log_map.quality:
        _apply_quality(table, log_map.quality, "", values, log_map, findings)
    frame = pandas.DataFrame({"t": times.t, "tag": tags, "value": values, "row": table.rows})
    twice = frame.duplicated(["t", "tag"])
    if twice.any():
        if log_map.duplicates == "refuse":
            k = int(twice.argmax())
            raise _twice(table.text(k), log_map.time[0], f"{times.clock.at(float(times.t[k]))} of {tags[k]}")
        findings.append(_dropped(int(twice.sum()), log_map))
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


def _in_order(where: str, rows: Rows, clock: Clock, log_map: LogMap, findings: list[Finding]) -> Rows:
    """The rows with increasing times: sorted, and one for each time, as the map has it; ValueError where it refuses."""
    import pandas

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
            raise _twice(f"{where}, row {rows.rows[k]}", " ".join(log_map.time), _at(clock, rows.t[k]), rows.rows[k - 1])
        findings.append(_dropped(again.size, log_map))
        by_time = pandas.DataFrame(rows.values).groupby(rows.t, sort=True)
        merged = by_time.agg(log_map.duplicates) if rows.values else None
        first = np.flatnonzero(np.diff(rows.t, prepend=-np.inf) > 0)
        rows = Rows(
            rows.t[first], rows.rows[first], {n: merged[n].to_numpy() for n in rows.values} if merged is not None else {}
        )
    return rows


def _twice(row: str, column: str, at: str, other: int | None = None) -> ValueError:
    before = "" if other is None else f", as in row {other}"
    return ValueError(
        f"{row}, column {column}: {at} again{before}; times must increase: keep one row of each time, or state "
        'duplicates = "first", "last" or "mean" in a map'
    )


def _dropped(count: int, log_map: LogMap) -> Finding:
    fate = "averaged" if log_map.duplicates == "mean" else f"dropped, the {log_map.duplicates} of each time kept"
    return Finding("duplicates", "", count, f"{counted(count, 'duplicate')} {fate}")


def _at(clock: Clock, t: float) -> str:
    return f"{float(t)!r} s" if clock.start is None else clock.at(float(t))


def _mask_titles(where: str, titles: Sequence[str], sources: Sources, log_map: LogMap) -> list[str]:
    """The columns that the mask compares and that feed nothing; ValueError for a comparison that cannot be read."""
    by_name = {c.name: c.title for c in sources.columns}
    also = []
    for text in log_map.mask:
        match = MASK.fullmatch(text.strip())
        if match is None:
            raise ValueError(f'mask is {shown(text)}; expected a comparison of a column with a number, as in "feed < 5"')
        if match[1] not in by_name and match[1] not in titles:
            raise ValueError(
                f"{where}: mask {shown(text)} compares {shown(match[1])}, which is no column, sensor or input of the log; "
                f"columns: {some(titles)}"
            )
        if match[1] not in by_name and match[1] not in by_name.values():
            also.append(match[1])
    return list(dict.fromkeys(also))


def _masked(where: str, rows: Rows, sources: Sources, log_map: LogMap) -> Array:
    """The rows (K,) in which a comparison of the mask holds, in the units of the log; a missing value compares as before it."""
    import pandas

    by_name = {c.name: c.title for c in sources.columns}
    masked = np.zeros(rows.t.shape, dtype=bool)
    for text in log_map.mask:
        match = MASK.fullmatch(text.strip())
        assert match is not None
        values = pandas.Series(rows.values[by_name.get(match[1], match[1])]).ffill().to_numpy()
        masked |= COMPARISONS[match[2]](values, float(match[3])) & np.isfinite(values)
    if masked.all() and masked.size:
        raise ValueError(f"{where}: mask {', '.join(log_map.mask)} holds in every row; it compares in the units of the log")
    return masked


def _log(
    where: str,
    rows: Rows,
    sources: Sources,
    plant: Plant,
    log_map: LogMap,
    masked: Array,
    findings: list[Finding],
) -> Log:
    """Readings and inputs in the units of the plant; masked rows keep no reading, and are left out without a valid input."""
    inputs = [c for c in sources.columns if c.is_input]
    u = usual_inputs(plant, rows.t)
    for c in inputs:
        u[:, c.position] = _held(rows.t, c.conversion(rows.values[c.title]), c.name, log_map, findings)
    at_the_sample = log_map.inputs == AT_THE_SAMPLE and bool(inputs)
    if at_the_sample:
        fed = [c.position for c in inputs]
        u[1:, fed] = u[:-1, fed]
    if inputs:
        findings.append(_timing(at_the_sample))
    if lacking := sources.without_column(plant):
        source = "the nominal values" if plant.truth.operation is None else "the usual inputs"
        text = f"no column for the inputs {some(lacking)}; {source} of plant {plant.name!r} are used instead"
        findings.append(Finding("nominal inputs", "", len(lacking), text))
    valid = np.ones(rows.t.shape, dtype=bool)
    for c in inputs:
        signal = plant.inputs[c.position]
        valid &= np.isfinite(u[:, c.position]) & (u[:, c.position] >= signal.low) & (u[:, c.position] <= signal.high)
    early = _before_the_first(rows, inputs, log_map)
    left_out = (masked | early) & ~valid
    for c in inputs:
        _require_known(where, rows, c, u, plant, ~left_out, log_map)
    y = np.full((rows.t.size, len(plant.sensors)), np.nan)
    for c in sources.columns:
        if not c.is_input:
            y[:, c.position] = c.conversion(rows.values[c.title])
    y[masked] = np.nan
    if count := int(np.sum(masked)):
        gone = int(np.sum(masked & left_out))
        also = f", {gone} of them left out, as an input is missing or beyond its limits" if gone else ""
        text = f"{counted(count, 'row')} masked by {', '.join(log_map.mask)}: readings taken as missing{also}"
        findings.append(Finding("masked", "", count, text))
    if count := int(np.sum(left_out & ~masked)):
        findings.append(
            Finding("left out", "", count, f"{counted(count, 'row')} before the first value of each input left out")
        )
    if left_out.all():
        raise ValueError(
            f"{where}: no row with all inputs; give each input a value, or --nominal-inputs for one without a column"
        )
    return Log(rows.t[~left_out], y[~left_out], u[~left_out])


def _held(t: Array, values: Array, name: str, log_map: LogMap, findings: list[Finding]) -> Array:
    """An input (K,) whose missing values are the last before, for as long as the map allows."""
    missing = np.isnan(values)
    if not missing.any() or log_map.hold == 0:
        return values
    last = np.maximum.accumulate(np.where(missing, -1, np.arange(t.size)))
    held = missing & (last >= 0)
    held[held] = t[held] - t[last[held]] <= log_map.hold
    if count := int(np.sum(held)):
        findings.append(Finding("held", name, count, f"{counted(count, f'{name} value')} held"))
    return np.where(held, values[np.maximum(last, 0)], values)


def _before_the_first(rows: Rows, inputs: Sequence[Source], log_map: LogMap) -> Array:
    """The rows (K,) at the beginning where an input has had no value yet, which holding cannot fill."""
    early = np.zeros(rows.t.shape, dtype=bool)
    if log_map.hold > 0:
        for c in inputs:
            known = np.isfinite(rows.values[c.title])
            early |= np.arange(rows.t.size) <= (int(np.argmax(known)) if known.any() else -1)
    return early


def _require_known(where: str, rows: Rows, c: Source, u: Array, plant: Plant, needed: Array, log_map: LogMap) -> None:
    """Raise ValueError, which names the row, for an input that is missing or beyond its limits in a row that is needed."""
    own = rows.rows if log_map.inputs != AT_THE_SAMPLE else np.concatenate([rows.rows[:1], rows.rows[:-1]])
    values = u[:, c.position]
    for k in np.flatnonzero(np.isnan(values) & needed)[:1]:
        text = "''; expected a finite number: an input must be known; " + (
            f"it is missing for longer than hold, {log_map.hold:g} s"
            if log_map.hold
            else "state hold in a map, for how long it keeps its last value (s)"
        )
        raise ValueError(f"{where}, row {own[k]}, column {c.title}: {text}")
    require_within_limits(where, plant, plant.inputs[c.position], values[needed], own[needed])


def _timing(at_the_sample: bool) -> Finding:
    if at_the_sample:
        text = 'inputs taken as acting from their row until the next (inputs = "at the sample", as historians log them)'
    else:
        text = 'inputs taken as having acted until their row (inputs = "until the sample", as simulate writes them)'
    return Finding("inputs", "", 0, text)
