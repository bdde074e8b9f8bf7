"""bench logs: `diagnose` of a log by the command line, in processes of its own, each from start to report.

- `first, 120 rows`: of the pipeline with robust-glr, with an empty cache of compiled code, as after installing;
  `later, 120 rows`: with the cache that the first has filled.
- `20000 rows`, `200000 rows`: of two-tanks with fixed limits; peak_memory is the largest resident memory of the process, with
  the condition `beyond the import` less that of a process which imports NumPy, pandas and Matplotlib.

The reference of the ratios is a Python that imports NumPy. Each is called about `seconds`, but the first call once only.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fusion_sfdia import registry
from fusion_sfdia.benchmarks.speed.start import NUMPY
from fusion_sfdia.benchmarks.speed.support.calls import Call, time_row, timed, timed_rows
from fusion_sfdia.benchmarks.speed.support.processes import command, timed_process
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.evaluation.simulate import simulate
from fusion_sfdia.logs.csv_log import write_log

SHORT, LONG = 120, (20_000, 200_000)
BLOCK = 2_000  # rows that are simulated and repeated
IMPORTS = "import numpy, pandas, matplotlib.pyplot"


def measure(seconds: float) -> list[Row]:
    """A short log with and without compiled code, and two long ones."""
    with TemporaryDirectory() as folder:
        return [*_short(Path(folder), seconds), *_long(Path(folder), seconds)]


def _short(folder: Path, seconds: float) -> list[Row]:
    log, name, detector = folder / "short.csv", "gas-pipeline", "robust-glr"
    write(log, name, SHORT)
    cache = {"NUMBA_CACHE_DIR": str(folder / "cache")}
    arguments = command("diagnose", "--plant", name, "--detector", detector, "--data", str(log), "--force", "--out")
    first = timed_process([*arguments, str(folder / "first")], cache)
    calls: dict[str, Call] = {"later": partial(timed_process, [*arguments, str(folder / "later")], cache)}
    time = timed(calls, seconds, NUMPY, partial(timed_process, ["-c", NUMPY]))["later"]
    once = time._replace(best=first.seconds, calls=1)
    rows = timed_rows("logs", name, detector, f"first, {SHORT} rows", once)
    return [*rows, *timed_rows("logs", name, detector, f"later, {SHORT} rows", time)]


def _long(folder: Path, seconds: float) -> list[Row]:
    name, detector = "two-tanks", "limits"
    least = timed_process(["-c", IMPORTS]).memory
    rows: list[Row] = []
    for count in LONG:
        log = folder / f"{count}.csv"
        write(log, name, count)
        out = str(folder / f"of {count}")
        arguments = command("diagnose", "--plant", name, "--detector", detector, "--data", str(log), "--force", "--out", out)
        memory = timed_process(arguments).memory
        calls: dict[str, Call] = {"": partial(timed_process, arguments)}
        time = timed(calls, seconds, NUMPY, partial(timed_process, ["-c", NUMPY]))[""]
        rows += timed_rows("logs", name, detector, f"{count} rows", time)
        for condition, value in (("", memory), ("beyond the import", memory - least)):
            rows.append(time_row("logs", name, detector, f"{count} rows", "peak_memory", value, 1, condition=condition))
    return rows


def write(path: Path, name: str, rows: int) -> None:
    """A healthy log of a plant: a simulated block, repeated."""
    plant = registry.plant(name)
    block = simulate(plant, min(rows, BLOCK), seeds=[1], truth="model")
    times = -(-rows // len(block.t))
    y, u = (np.tile(a, (times, 1))[:rows] for a in (block.y[:, 0], block.u))
    write_log(path, plant, float(block.t[0]) + plant.dt * np.arange(rows), y, u)
