"""Logs of a plant: written as CSV, a header and then one row a sampling time, and read back to the bit."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats
from fusion_sfdia.common.errors import warn
from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.common.plain_text import cell, plain
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.plain import plain_lines
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.plant.log import TIME, Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]

BLOCK = 10_000  # rows in memory as text
HARMLESS = re.compile("[0-9A-Za-z][0-9A-Za-z_.:+ -]*|")  # most cells: times, names


def write_log(path: str | Path, plant: Plant, t: Array, y: Array, u: Array | None = None) -> None:
    """Write a log so that read_log returns the same bits.

    Parameters
    ----------
    path : str or Path
        The file.
    plant : Plant
        Whose names and units are the titles.
    t : array (K,)
        Times in s.
    y : array (K, N)
        Readings, NaN where missing.
    u : array (K, m), optional
        Inputs that acted until then.

    Raises
    ------
    ValueError
        For other shapes.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.logs import read_log, write_log
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> recording = simulate(plant, 20, seeds=[1])
    >>> with TemporaryDirectory() as folder:
    ...     write_log(Path(folder, "log.csv"), plant, recording.t, recording.y[:, 0], recording.u)
    ...     log = read_log(Path(folder, "log.csv"), plant)
    >>> bool((log.y == recording.y[:, 0]).all())
    True
    """
    t, y = floats("t", t), floats("y", y)
    u = np.empty((t.size, 0)) if u is None else floats("u", u)
    inputs = plant.inputs if u.size else ()
    if t.ndim != 1 or y.shape != (t.size, len(plant.sensors)) or u.shape != (t.size, len(inputs)):
        raise ValueError(
            f"t {t.shape}, y {y.shape}, u {u.shape} do not fit; expected (K,), (K, {len(plant.sensors)}) and "
            f"(K, {len(plant.inputs)}) of plant {plant.name!r}: one run, without a batch"
        )
    named: tuple[Signal | Sensor, ...] = (TIME, *plant.sensors, *inputs)
    header = [f"{c.name} [{c.unit}]" for c in named]
    write_lines(Path(path), header, t.size, lambda rows: plain_lines(np.column_stack([t[rows], y[rows], u[rows]])))


def write_lines(path: Path, header: Sequence[str], count: int, lines: Callable[[slice], Iterable[str]]) -> None:
    """Write a table of `count` rows in blocks, each as `lines` gives them for a slice of the rows."""
    with atomic_write(path) as file:
        file.write(",".join(map(quoted, header)) + "\n")
        for k in range(0, count, BLOCK):
            file.write("\n".join(lines(slice(k, min(k + BLOCK, count)))) + "\n")


def quoted(text: str) -> str:
    """A text as a cell, in which a spreadsheet and a terminal see nothing but text."""
    if HARMLESS.fullmatch(text):
        return text
    text = cell(plain(text))
    return f'"{text.replace(chr(34), 2 * chr(34))}"' if any(c in text for c in ',"\r\n') else text


def read_log(
    path: str | Path,
    plant: Plant,
    *,
    log_map: LogMap | str | Path | None = None,
    absent_sensors: bool = False,
    other_columns: bool = False,
    nominal_inputs: bool = False,
) -> Log:
    """Read a log of a plant whose columns have the plant's names, in any order, each with or without its unit in brackets, or
    as a map states.

    Parameters
    ----------
    path : str or Path
        The file.
    plant : Plant
        Whose sensors and inputs are read.
    log_map : LogMap, str or Path, optional
        As of `load_log`.
    absent_sensors, other_columns, nominal_inputs : bool, default False
        As of `load_log`.

    Returns
    -------
    Log
        The readings of `load_log` alone, which also states what it found and the wall-clock start.

    Raises
    ------
    ValueError
        As `load_log` raises it.

    Warns
    -----
    UserWarning
        Names inputs without a column that are the usual ones, where nominal_inputs accepts that.

    Examples
    --------
    See `write_log`.
    """
    found = load_log(
        path, plant, log_map, absent_sensors=absent_sensors, other_columns=other_columns, nominal_inputs=nominal_inputs
    )
    for finding in found.findings:
        if finding.kind == "nominal inputs":
            warn(f"{path}: {finding.text}")
    return found.log
