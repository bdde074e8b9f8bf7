"""Logs whose columns are not those of a plant: each column but the time is a sensor, unless it is named as an input."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fusion_sfdia.core.linear import linear_plant
from fusion_sfdia.core.log import TIME, Log
from fusion_sfdia.core.signals import Sensor, Signal
from fusion_sfdia.logs.csv_log import read_log


def signals_of(path: str | Path, inputs: Sequence[str], ignore: Sequence[str]) -> tuple[list[Signal], list[Signal]]:
    """Return the sensors and inputs of a log by its header, such as `time,flow [m3/h],load`.

    inputs, ignore: names of columns that are inputs, and that are neither; ValueError for one that is not there.
    """
    with Path(path).open(encoding="utf-8-sig", newline="") as file:
        try:
            header = next((row for row in csv.reader(file) if any(cell.strip() for cell in row)), [])
        except (UnicodeDecodeError, csv.Error) as error:
            raise ValueError(f"{path} is not a CSV text file ({error}); expected UTF-8 text") from error
    found = {}
    for title in header:
        match = re.fullmatch(r"\s*(.*?)\s*(?:\[([^\[\]]*)\])?\s*", title, flags=re.DOTALL)
        name, unit = match.groups() if match else (title, None)
        found[name] = Signal(name, (unit or "1").strip())
    if missing := [n for n in (*inputs, *ignore) if n not in found]:
        raise ValueError(f"{path}: no column {', '.join(map(repr, missing))}; its columns are {', '.join(map(repr, found))}")
    sensors = [s for n, s in found.items() if n not in (TIME.name, *inputs, *ignore)]
    if not sensors:
        raise ValueError(f"{path}: no column is left as a sensor; its columns are {', '.join(map(repr, found))}")
    return sensors, [found[n] for n in inputs]


def read(path: str | Path, sensors: Sequence[Signal], inputs: Sequence[Signal]) -> Log:
    """Read a log of these columns, as `read_log` does; other columns are ignored."""
    count = len(sensors)
    plant = linear_plant(
        "monitored plant", np.zeros((1, 1)), np.zeros((count, 1)),
        [Sensor(s.name, s.name, s.unit, sigma=1.0) for s in sensors],
        dt=1.0, x0=np.zeros(1), initial_cov=np.ones(1), process_cov=np.ones(1), inputs=inputs,
    )  # fmt: skip
    return read_log(path, plant, other_columns=True)
