"""Logs of readings as CSV: a header, then one row a sampling time; an empty cell is a missing reading."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import floats, shown
from fusion_sfdia.core.files import atomic_write
from fusion_sfdia.core.log import TIME, Log, find_columns, require_within_limits, usual_inputs
from fusion_sfdia.core.numerals import decimal
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.signals import Sensor, Signal

Array = NDArray[Any]


def write_log(path: str | Path, plant: Plant, t: Array, y: Array, u: Array | None = None) -> None:
    """Write t (K,), y (K, N) and, if given, u (K, m) so that read_log returns the same bits. ValueError for other shapes."""
    t, y = floats("t", t), floats("y", y)
    u = np.empty((t.size, 0)) if u is None else floats("u", u)
    inputs = plant.inputs if u.size else ()
    if t.ndim != 1 or y.shape != (t.size, len(plant.sensors)) or u.shape != (t.size, len(inputs)):
        raise ValueError(
            f"t {t.shape}, y {y.shape}, u {u.shape} do not fit; expected (K,), (K, {len(plant.sensors)}) and "
            f"(K, {len(plant.inputs)}) of plant {plant.name!r}: one run, without a batch"
        )
    with atomic_write(Path(path)) as file:
        table = csv.writer(file, lineterminator="\n")
        named: tuple[Signal | Sensor, ...] = (TIME, *plant.sensors, *inputs)
        table.writerow([f"{c.name} [{c.unit}]" for c in named])
        for row in np.column_stack([t, y, u]):
            table.writerow(["" if np.isnan(v) else repr(float(v)) for v in row])


def read_log(
    path: str | Path,
    plant: Plant,
    *,
    absent_sensors: bool = False,
    other_columns: bool = False,
    nominal_inputs: bool = False,
) -> Log:
    """Read a log of a plant.

    The header names `time`, every sensor and every input, in any order, each with or without its unit in brackets.
    absent_sensors: a sensor without a column is NaN throughout. other_columns: columns that are neither are ignored.
    nominal_inputs: inputs without a column are the plant's operation (plant.input_at) at the reading before, or dt before
    where that is later, and a UserWarning names them. Raises ValueError naming file, row (the header is row 1) and column
    for anything else than increasing times, finite or missing readings and inputs within their limits.
    """
    with Path(path).open(encoding="utf-8-sig", newline="") as file:
        try:
            rows = [(n, row) for n, row in enumerate(csv.reader(file, strict=True), start=1) if any(c.strip() for c in row)]
        except (UnicodeDecodeError, csv.Error) as error:
            raise ValueError(f"{path} is not a CSV text file ({error}); expected UTF-8 text as `simulate` writes it") from error
    if not rows:
        raise ValueError(f"{path} is empty; expected a header: time and the sensors of plant {plant.name!r}")
    columns = find_columns(str(path), rows[0][1], plant, absent_sensors, other_columns, nominal_inputs)
    if len(rows) == 1:
        raise ValueError(f"{path} has a header and no rows; expected at least one reading")
    width = len(rows[0][1])
    for n, row in rows[1:]:
        if len(row) != width:
            raise ValueError(
                f"{path}, row {n}: {len(row)} cells under a header of {width}; leave a missing reading's cell empty"
            )
    numbers = [n for n, _ in rows[1:]]
    cells = [row for _, row in rows[1:]]
    t = _values(path, numbers, cells, columns, TIME, required=True)
    for k in range(1, t.size):
        if not t[k] > t[k - 1]:
            raise ValueError(
                f"{path}, row {numbers[k]}, column time: {float(t[k])!r} s after {float(t[k - 1])!r} s; times must increase, "
                "sort the rows"
            )
    y = np.full((t.size, len(plant.sensors)), np.nan)
    for i, sensor in enumerate(plant.sensors):
        if sensor.name in columns:
            y[:, i] = _values(path, numbers, cells, columns, sensor, required=False)
    u = usual_inputs(str(path), plant, t, columns, stacklevel=3)
    for i, signal in enumerate(plant.inputs):
        if signal.name in columns:
            u[:, i] = _values(path, numbers, cells, columns, signal, required=True)
            require_within_limits(str(path), plant, signal, u[:, i], numbers)
    return Log(t, y, u)


def _values(
    path: str | Path,
    numbers: Sequence[int],
    cells: Sequence[Sequence[str]],
    columns: dict[str, int],
    what: Signal | Sensor,
    *,
    required: bool,
) -> Array:
    """Return a column as numbers; ValueError for text, infinity and, where required, missing values."""
    at = columns[what.name]
    values = np.empty(len(cells))
    for k, row in enumerate(cells):
        text = row[at].strip()
        try:
            values[k] = decimal(text) if text else np.nan
        except ValueError:
            values[k] = np.inf
        if np.isinf(values[k]) or (required and np.isnan(values[k])):
            expected = "a finite number" if required else "a finite number, or nothing where the reading is missing"
            if what is TIME and text:
                expected += " of seconds: subtract the first time stamp, or read the file with pandas and pass the frame"
            raise ValueError(f"{path}, row {numbers[k]}, column {what.name}: {shown(text)}; expected {expected}")
    return values
