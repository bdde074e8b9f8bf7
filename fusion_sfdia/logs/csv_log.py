"""Logs of a plant: written as CSV, a header and then one row a sampling time, and read back to the bit."""

from __future__ import annotations

import csv
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import floats
from fusion_sfdia.core.files import atomic_write
from fusion_sfdia.core.log import TIME, Log
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.signals import Sensor, Signal
from fusion_sfdia.logs.reading import load_log

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
    """Read a log of a plant whose columns have the plant's names, in any order, each with or without its unit in brackets.

    The readings of `load_log` alone, which also states what it found and takes a map. A UserWarning names inputs without a
    column that are the usual ones, where nominal_inputs accepts that.
    """
    found = load_log(path, plant, absent_sensors=absent_sensors, other_columns=other_columns, nominal_inputs=nominal_inputs)
    for finding in found.findings:
        if finding.kind == "nominal inputs":
            warnings.warn(f"{path}: {finding.text}", stacklevel=2)
    return found.log
