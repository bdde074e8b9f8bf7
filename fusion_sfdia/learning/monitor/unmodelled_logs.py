"""Logs whose columns are not those of a plant: each column but the time is a sensor, unless it is named as an input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fusion_sfdia.common.arguments import some
from fusion_sfdia.logs.cell_tables import Table, read_table
from fusion_sfdia.logs.columns import split_title
from fusion_sfdia.logs.grid import tagged
from fusion_sfdia.logs.loaded_log import Finding, LoadedLog
from fusion_sfdia.logs.log_map import PLAIN_MAP, LogMap, load_map
from fusion_sfdia.logs.numbers import Numbers
from fusion_sfdia.logs.physics import StatedPhysics
from fusion_sfdia.logs.reading import read_log
from fusion_sfdia.logs.regular_sensors import regularities
from fusion_sfdia.logs.times import Expected
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

# units by which names of tags end, the first of these in any case; "in", "min" and single letters mean other things
IN_NAMES = {u.lower(): u for u in "degC degF kPa hPa Pa bar mbar psi kW kWh Hz rpm pct percent ppm lps gpm cfm m3h".split()}
IN_NAMES |= {u: u for u in ("MPa", "MW", "mA", "mV")}
ALL = "all"  # in place of the names of further columns


def signals_of(
    source: Any, inputs: Sequence[str] = (), ignore: Sequence[str] = (), log_map: LogMap = PLAIN_MAP
) -> tuple[list[Signal], list[Signal]]:
    """Return the sensors and inputs of a log, a file or a pandas frame, by its titles, such as `time,flow [m3/h],load`.

    inputs, ignore: names of columns that are inputs, and that are neither. log_map: where it names columns these alone are
    sensors and inputs, by their names there. ValueError for names that are not in the log, and where no sensor is left.
    """
    table, log_map, _ = found_times = tagged(read_table(source, log_map), log_map)
    units = {title: split_title(title)[1] or unit for title, unit in zip(*found_times.header, strict=True)}
    units |= {title: _unit_of_cells(table, title, log_map) for title, unit in units.items() if not unit}
    by_name = {split_title(title)[0]: unit for title, unit in units.items()}
    if log_map.columns:
        found = {c.name: c.unit or units.get(t, "") or by_name.get(t, "") for t, c in log_map.columns.items()}
        inputs = [*inputs, *(c.input for c in log_map.columns.values() if c.input and c.input not in inputs)]
    else:
        if log_map.tag:
            raise ValueError(f"{table.where}: the map states no columns; name those tags that are sensors and inputs")
        qualities = {log_map.quality.replace("{column}", name) for name in by_name} if log_map.quality else set()
        found = {n: u for n, u in by_name.items() if n and n not in (*log_map.time, *qualities)}
    if missing := [n for n in (*inputs, *ignore) if n not in found]:
        raise ValueError(f"{table.where}: no column {', '.join(map(repr, missing))}; known: {', '.join(map(repr, found))}")
    found = {n: u or _unit_of_name(n) for n, u in found.items()}
    sensors = [Signal(n, unit or "1") for n, unit in found.items() if n not in (*inputs, *ignore)]
    if not sensors:
        raise ValueError(f"{table.where}: no column is left as a sensor; its columns are {', '.join(map(repr, found))}")
    return sensors, [Signal(n, found[n] or "1") for n in inputs]


def further_signals(
    source: Any, plant: Plant, names: Sequence[str], log_map: LogMap | str | Path | None = None
) -> tuple[Signal, ...]:
    """The columns of a log of a plant by these names that are neither its sensors nor its inputs, or, of ["all"], every such
    column with a number. ValueError for names that the log does not have, and for those of sensors and inputs.
    """
    read = PLAIN_MAP if log_map is None else log_map if isinstance(log_map, LogMap) else load_map(log_map)
    own = {*plant.sensor_names, *(s.name for s in plant.inputs)}
    if of_plant := [n for n in names if n in own]:
        raise ValueError(f"further {some(of_plant)}: plant {plant.name!r} has them already; name other columns of the log")
    meant = {*read.columns, *(split_title(title)[0] for title in read.columns), *(c.quality for c in read.columns.values())}
    signals, _ = signals_of(source, log_map=replace(read, columns={}, physics=StatedPhysics()))
    others = {s.name: s for s in signals if s.name not in own | meant}
    if list(names) == [ALL]:
        table = tagged(read_table(source, read), read).table
        numbers = {split_title(title)[0] for title in table.titles if _has_number(table.column(title), read)}
        return tuple(s for name, s in others.items() if name in numbers)
    if unknown := [n for n in names if n not in others]:
        raise ValueError(
            f"further {some(unknown)}: no columns of the log; beside those of the plant it has {some(list(others))}"
        )
    return tuple(others[n] for n in dict.fromkeys(names))


def _has_number(cells: Sequence[Any], log_map: LogMap) -> bool:
    """Whether the first cell that is not missing is a number."""
    numbers = Numbers.of(log_map)
    for cell in cells:
        try:
            value, _ = numbers.quantity(cell)
        except ValueError:
            return False
        if np.isfinite(value):
            return True
    return False


def _unit_of_name(name: str) -> str:
    """The unit by which a tag ends, "SAT_degC"; "" where it ends by none."""
    before, _, end = name.rpartition("_")
    return IN_NAMES.get(end, IN_NAMES.get(end.lower(), "")) if before else ""


def _unit_of_cells(table: Table, title: str, log_map: LogMap) -> str:
    """The unit that the first cell of a column states behind its number, "" where there is none."""
    first = next((cell for cell in table.column(title) if isinstance(cell, str) and cell.strip()), "")
    try:
        return Numbers.of(log_map).quantity(first)[1]
    except ValueError:
        return ""


def load(
    source: Any,
    sensors: Sequence[Signal],
    inputs: Sequence[Signal] = (),
    log_map: LogMap = PLAIN_MAP,
    *,
    absent_sensors: bool = False,
) -> LoadedLog:
    """Read a log of these columns, as `load_log` does; other columns are ignored. No step is expected."""
    count = len(sensors)
    plant = linear_plant(
        "monitored plant", np.zeros((1, 1)), np.zeros((count, 1)),
        [Sensor(s.name, s.name, s.unit, sigma=1.0) for s in sensors],
        dt=1.0, x0=np.zeros(1), initial_cov=np.ones(1), process_cov=np.ones(1), inputs=inputs,
    )  # fmt: skip
    found = read_log(source, plant, log_map, {"absent": absent_sensors, "other": True, "nominal": False}, Expected(dt=None))
    regular = regularities(plant, found.log)
    repeats = [
        Finding("repeat", sensors[i].name, regular.taken[i],
                f"{sensors[i].name} repeats its value, new every {one.usual} rows ({one.usual * regular.step:.6g} s); "
                "so it is learnt, and slow to show a fault")
        for i, one in regular.repeats.items()
    ]  # fmt: skip
    cyclic = [
        Finding("period", sensors[i].name, 0,
                f"{sensors[i].name} jumps by {p:.6g} {sensors[i].unit} as an angle does after a full turn, which no linear "
                "model follows: leave it out with --ignore, or write its sine and cosine into the log")
        for i, p in regular.periods.items()
    ]  # fmt: skip
    return found._replace(findings=(*found.findings, *repeats, *cyclic))
