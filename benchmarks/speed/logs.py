"""bench logs: `diagnose` of a log by the command line, in processes of its own, each from start to report.

- `first, 120 rows`: of the pipeline with robust-glr, with an empty cache of compiled code, as after installing;
  `later, 120 rows`: with the cache that the first has filled.
- `20000 rows`, `200000 rows`: of two-tanks with fixed limits; peak_memory is the largest resident memory of the process, with
  the condition `beyond the import` less that of a process which imports NumPy, pandas and Matplotlib.

The reference of the ratios is a Python that imports NumPy. A process takes seconds: each is run twice, the first call once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import log
from pathlib import Path
from statistics import stdev
from tempfile import TemporaryDirectory

import numpy as np

from fusion_sfdia.benchmarks.speed.start import NUMPY
from fusion_sfdia.benchmarks.speed.support.calls import Timed, time_row, timed_rows
from fusion_sfdia.benchmarks.speed.support.processes import command, timed_process
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.logs.csv_log import write_log
from fusion_sfdia.report.results import Row

SHORT, LONG = 120, (20_000, 200_000)
BLOCK = 2_000  # rows that are simulated and repeated
IMPORTS = "import numpy, pandas, matplotlib.pyplot"


def measure(seconds: float) -> list[Row]:
    """A short log with and without compiled code, and two long ones."""
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:  # what a first diagnosis began may still be compiled
        return [*_short(Path(folder)), *_long(Path(folder))]


def twice(arguments: Sequence[str], variables: Mapping[str, str] | None = None) -> tuple[Timed, float]:
    """The least time of a process that is run twice, each time after the reference, and its largest memory."""
    runs, base = [], []
    for _ in range(2):
        base.append(min(timed_process(["-c", NUMPY]).seconds for _ in range(2)))
        runs.append(timed_process(arguments, variables))
    spread = stdev(log(run.seconds / b) for run, b in zip(runs, base, strict=True))
    return Timed(min(r.seconds for r in runs), 2, min(base), spread, NUMPY), max(r.memory for r in runs)


def _short(folder: Path) -> list[Row]:
    data, name, detector = folder / "short.csv", "gas-pipeline", "robust-glr"
    write(data, name, SHORT)
    cache = {"NUMBA_CACHE_DIR": str(folder / "cache")}
    arguments = command("diagnose", "--plant", name, "--detector", detector, "--data", str(data), "--force", "--out")
    first = timed_process([*arguments, str(folder / "first")], cache)
    later, _ = twice([*arguments, str(folder / "later")], cache)
    once = later._replace(best=first.seconds, calls=1)
    rows = timed_rows("logs", name, detector, f"first, {SHORT} rows", once)
    return [*rows, *timed_rows("logs", name, detector, f"later, {SHORT} rows", later)]


def _long(folder: Path) -> list[Row]:
    name, detector = "two-tanks", "limits"
    least = timed_process(["-c", IMPORTS]).memory
    rows: list[Row] = []
    for count in LONG:
        data, out = folder / f"{count}.csv", str(folder / f"of {count}")
        write(data, name, count)
        options = ("--plant", name, "--detector", detector, "--data", str(data), "--force", "--out", out)
        time, memory = twice(command("diagnose", *options))
        rows += timed_rows("logs", name, detector, f"{count} rows", time)
        for condition, value in (("", memory), ("beyond the import", memory - least)):
            rows.append(time_row("logs", name, detector, f"{count} rows", "peak_memory", value, 2, condition=condition))
    return rows


def write(path: Path, name: str, rows: int) -> None:
    """A healthy log of a plant: a simulated block, repeated."""
    plant = registry.plant(name)
    block = simulate(plant, min(rows, BLOCK), seeds=[1], truth="model")
    times = -(-rows // len(block.t))
    y, u = (np.tile(a, (times, 1))[:rows] for a in (block.y[:, 0], block.u))
    write_log(path, plant, float(block.t[0]) + plant.dt * np.arange(rows), y, u)
