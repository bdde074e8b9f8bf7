"""From a log, as CSV, Parquet or a pandas frame, to readings and inputs of a plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import some
from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.logs.cell_tables import Table, read_table
from fusion_sfdia.logs.columns import Source, Sources, require_columns_of, split_title
from fusion_sfdia.logs.frames import is_frame
from fusion_sfdia.logs.layout import long_rows, wide_rows
from fusion_sfdia.logs.loaded_log import Finding, LoadedLog, counted, others
from fusion_sfdia.logs.log_map import AT_THE_SAMPLE, PLAIN_MAP, LogMap, load_map
from fusion_sfdia.logs.mask import masked_rows
from fusion_sfdia.logs.mix_ups import input_mix_up
from fusion_sfdia.logs.overview import overview
from fusion_sfdia.logs.problems import Problems
from fusion_sfdia.logs.time_order import LogRows, in_order
from fusion_sfdia.logs.times import UNKNOWN, Expected
from fusion_sfdia.plant.log import Log, usual_inputs
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


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

    Parameters
    ----------
    source : str, Path or frame
        A frame of pandas, Polars or Arrow, or a file: CSV, Parquet, Arrow, Excel, TDMS, MDF. Times are seconds, numbers since
        1970 or ISO stamps; of the last two t begins at 0.
    plant : Plant
        Whose sensors and inputs are read.
    log_map : LogMap, str or Path, optional
        A LogMap or its file; without one the columns have the plant's names, with or without their unit in brackets, and inputs
        acted until their row, as `simulate` and `write_log` write them.
    absent_sensors : bool, default False
        A sensor without a column is NaN throughout.
    other_columns : bool, default False
        Columns that are neither are ignored.
    nominal_inputs : bool, default False
        Inputs without a column are the plant's operation (plant.input_at) at the reading before, or dt before where that is
        later.

    Returns
    -------
    LoadedLog
        The Log, its clock and columns, and what was found.

    Raises
    ------
    ValueError
        Naming file, row (of a file the header is row 1) and column for anything else than times in order, finite or missing
        readings, and inputs that are known and within their limits.

    Examples
    --------
    >>> import pandas as pd
    >>> from fusion_sfdia import load_log
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> frame = pd.DataFrame({"time": [0.0, 5.0], **{name: [1.0, 1.0] for name in plant.sensor_names}})
    >>> load_log(frame, plant, nominal_inputs=True).log.y.shape
    (2, 4)
    """
    chosen = load_map(log_map) if isinstance(log_map, str | Path) else log_map or PLAIN_MAP
    allowed = {"absent": absent_sensors, "other": other_columns, "nominal": nominal_inputs}
    return read_log(source, plant, chosen, allowed, Expected(plant.dt))


def read_log(source: Any, plant: Plant, chosen: LogMap, allowed: dict[str, bool], expected: Expected) -> LoadedLog:
    """The log that `load_log` returns; allowed: as `find_sources` takes it."""
    problems = Problems("the frame" if is_frame(source) else str(source))
    with problems.collecting("map"):
        require_columns_of(plant, chosen)
    table = _table(source, chosen, problems)
    read = long_rows if chosen.tag else wide_rows
    sources, rows, times, findings = read(table, plant, chosen, allowed, problems, expected)
    if times.kind == UNKNOWN:  # an input without any value is missing however long it is held
        chosen = replace(chosen, hold=inf if chosen.hold else 0.0)
    rows = in_order(table.where, rows, times.clock, chosen, findings, problems)
    masked = np.zeros(rows.t.shape, dtype=bool)
    if not problems.of("cells", "mask", "quality"):
        with problems.collecting("mask"):
            masked = masked_rows(table.where, rows, sources, chosen)
    if chosen.mask and problems.of("cells", "mask", "quality"):
        problems.require_none()  # which rows are masked is not known, nor which need an input
    log = _log(rows, sources, plant, chosen, masked, findings, problems)
    problems.require_none()
    if sources.ignored:
        count = len(sources.ignored)
        findings.append(Finding("ignored", "", count, f"{counted(count, 'column')} not used: {some(sources.ignored)}"))
    absent = tuple(n for n in plant.sensor_names if n not in {c.name for c in sources.columns})
    return LoadedLog(log, times.clock, (*overview(plant, log, times, expected), *findings), absent, sources.columns)


def _table(source: Any, log_map: LogMap, problems: Problems) -> Table:
    """The table of a log; LogError where there is none. Of text in another encoding, a problem, what is readable."""
    for encoding in (log_map.encoding, "latin-1"):
        try:
            return read_table(source, replace(log_map, encoding=encoding))
        except MissingPackageError:
            raise
        except ValueError as error:
            problems.take("file", error)
            if "encoding in a map" not in str(error):
                break
    problems.require_none()
    raise AssertionError("a file without a table is a problem")


def _log(
    rows: LogRows,
    sources: Sources,
    plant: Plant,
    log_map: LogMap,
    masked: Array,
    findings: list[Finding],
    problems: Problems,
) -> Log:
    """Readings and inputs in the units of the plant; masked rows keep no reading, and are left out without a valid input."""
    inputs = [c for c in sources.columns if c.is_input]
    lacking = sources.without_column(plant)
    u = usual_inputs(plant, rows.t) if lacking else np.full((rows.t.size, len(plant.inputs)), np.nan)
    for c in inputs:
        u[:, c.position] = held(rows.t, c.conversion(rows.values[c.title]), c.name, log_map, findings)
    at_the_sample = log_map.inputs == AT_THE_SAMPLE and bool(inputs)
    if at_the_sample:
        fed = [c.position for c in inputs]
        u[1:, fed] = u[:-1, fed]
    if inputs:
        findings.append(timing(at_the_sample))
    if lacking:
        source = "the nominal values" if plant.truth.operation is None else "the usual inputs"
        text = f"no column for the inputs {some(lacking)}; {source} of plant {plant.name!r} are used instead"
        findings.append(Finding("nominal inputs", "", len(lacking), text))
    valid = np.ones(rows.t.shape, dtype=bool)
    for c in inputs:
        signal = plant.inputs[c.position]
        valid &= np.isfinite(u[:, c.position]) & (u[:, c.position] >= signal.low) & (u[:, c.position] <= signal.high)
    early = before_the_first(rows, inputs, log_map)
    stopped = masked.copy()  # also the row after, whose input is of a masked one
    stopped[1:] |= masked[:-1] & at_the_sample
    left_out = (stopped | early) & ~valid
    for c in inputs:
        require_known(problems, rows, c, u, plant, ~left_out, log_map)
    y = np.full((rows.t.size, len(plant.sensors)), np.nan)
    for c in sources.columns:
        if not c.is_input:
            y[:, c.position] = c.conversion(rows.values[c.title])
    y[masked] = np.nan
    if count := int(np.sum(masked)):
        gone = int(np.sum(stopped & left_out))
        also = f", {counted(gone, 'row')} left out, whose input is missing or beyond its limits" if gone else ""
        text = f"{counted(count, 'row')} masked by {', '.join(log_map.mask)}: readings taken as missing{also}"
        findings.append(Finding("masked", "", count, text))
    if count := int(np.sum(left_out & ~stopped)):
        findings.append(
            Finding("left out", "", count, f"{counted(count, 'row')} before the first value of each input left out")
        )
    if left_out.all():
        problems.add("inputs", "no row with all inputs; give each input a value, or --nominal-inputs for one without a column")
    kept = np.flatnonzero(~left_out) if left_out.any() else slice(None)
    return Log(rows.t[kept].copy(), y[kept], u[kept])  # of the table that was read nothing is kept


def held(t: Array, values: Array, name: str, log_map: LogMap, findings: list[Finding]) -> Array:
    """An input (K,) whose missing values are the last before, for as long as the map allows."""
    missing = np.isnan(values)
    if not missing.any() or log_map.hold == 0:
        return values
    last = np.maximum.accumulate(np.where(missing, -1, np.arange(t.size)))
    filled = missing & (last >= 0)
    filled[filled] = t[filled] - t[last[filled]] <= log_map.hold
    if count := int(np.sum(filled)):
        findings.append(Finding("held", name, count, f"{counted(count, f'{name} value')} held"))
    return np.where(filled, values[np.maximum(last, 0)], values)


def before_the_first(rows: LogRows, inputs: Sequence[Source], log_map: LogMap) -> Array:
    """The rows (K,) at the beginning where an input has had no value yet, which holding cannot fill."""
    early = np.zeros(rows.t.shape, dtype=bool)
    if log_map.hold > 0:
        for c in inputs:
            known = np.isfinite(rows.values[c.title])
            early |= np.arange(rows.t.size) <= (int(np.argmax(known)) if known.any() else -1)
    return early


def require_known(problems: Problems, rows: LogRows, c: Source, u: Array, plant: Plant, needed: Array, log_map: LogMap) -> None:
    """Add to problems an input that is missing or beyond its limits in rows that are needed."""
    own = rows.rows if log_map.inputs != AT_THE_SAMPLE else np.concatenate([rows.rows[:1], rows.rows[:-1]])
    values, signal = u[:, c.position], plant.inputs[c.position]
    missing = np.flatnonzero(np.isnan(values) & needed)
    if missing.size:
        cure = (
            f"it is missing for longer than hold, {log_map.hold:g} s"
            if log_map.hold
            else "state hold in a map, for how long it keeps its last value (s)"
        )
        text = f"''{others(missing.size)}; expected a finite number: an input must be known; {cure}"
        problems.add("inputs", text, row=int(own[missing[0]]), column=c.title, count=missing.size)
    beyond = needed & ((values < signal.low) | (values > signal.high))
    if beyond.any():
        usual = float(np.nanmedian(values[needed]))
        mixed = None if signal.low <= usual <= signal.high else input_mix_up(values[needed & np.isfinite(values)], signal)
        hint = f": {c.name} {mixed.text}, as its nominal value is {signal.nominal:g}" if mixed else ""
        k, count = int(np.argmax(beyond)), int(beyond.sum())
        limits = f"plant {plant.name!r} holds from {signal.low:g} to {signal.high:g} {signal.unit}"
        text = f"{values[k]:g} {signal.unit}{others(count)}; {limits}; correct the input or convert its unit{hint}"
        problems.add("inputs", text, row=int(own[k]), column=split_title(c.title)[0], count=count)


def timing(at_the_sample: bool) -> Finding:
    """The finding on when the inputs of a row act."""
    if at_the_sample:
        kind = "inputs shifted"
        text = 'inputs taken as acting from their row until the next (inputs = "at the sample", as historians log them)'
    else:
        kind = "inputs"
        text = 'inputs taken as having acted until their row (inputs = "until the sample", as simulate writes them)'
    return Finding(kind, "", 0, text)
