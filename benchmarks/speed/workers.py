"""bench workers: the same pieces of a comparison on one and two processes, and on one and two workers of a dask cluster.

step_time of all pieces (`16 pieces`), with the setting as condition, and its speedup over one process. `an empty piece`: what
a piece costs the cluster beside its work. sent_bytes: a piece as it goes to a worker, and its arrays as they come back. Wall
times on one run each: the processes are started and warm. The cluster is one of this machine with TLS, which needs the packages
distributed and cryptography; without them it is left out.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import cloudpickle
import numpy as np

from fusion_sfdia.benchmarks.speed.support.calls import time_row
from fusion_sfdia.benchmarks.speed.support.local_cluster import secure_cluster
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.comparison.compare import SCENARIO
from fusion_sfdia.study.experiments.cluster import connected
from fusion_sfdia.study.experiments.scenario import Arrays, Task
from fusion_sfdia.study.experiments.workers import Done, Piece, work_off

PIECES, EMPTY = 16, 200
COUNTS = (1, 2)
CLUSTER = ("distributed", "cryptography")
PLANT, DETECTOR = "two-tanks", "limits"

WorkOff = Callable[[Sequence[Piece]], Iterable[Done]]


def task_of(block: int) -> Task:
    """A small cell of the comparison, with seeds of its own."""
    settings = {**SCENARIO.settings, "plants": (PLANT,), "detectors": (DETECTOR,), "calibration_error": 0.5}
    (task,) = SCENARIO.tasks({**settings, "magnitudes": (10.0,), "lengths": (), "mismatch_cases": False}, 2)
    return {**task, "seeds": [2 * block, 2 * block + 1]}


def nothing(task: Task) -> Arrays:
    """The work of an empty piece."""
    return {"none": np.zeros(1)}


def seconds_of(pieces: Sequence[Piece], do: WorkOff) -> float:
    """Seconds until all pieces are done; RuntimeError where one fails."""
    start = perf_counter()
    for done in do(pieces):
        if done.error is not None:
            raise RuntimeError(f"a piece failed: {done.error}")
    return perf_counter() - start


def measure(seconds: float) -> list[Row]:
    """Processes of this machine, and a cluster on it. Each is measured once: the seconds have no effect."""
    times: dict[str, float] = {}
    with TemporaryDirectory() as folder:
        pieces = [Piece(Path(folder, f"{k}.npz"), SCENARIO.work, task_of(k)) for k in range(PIECES)]
        empty = [Piece(Path(folder, f"empty {k}.npz"), nothing, {"k": k}) for k in range(EMPTY)]
        for count in COUNTS:
            do = partial(work_off, workers=count)
            seconds_of(pieces[:count], do)
            times[f"{count} processes"] = seconds_of(pieces, do)
        rows = [_bytes("sent", len(cloudpickle.dumps((pieces[0].work, pieces[0].task))))]
        rows.append(_bytes("answered", sum(a.nbytes for a in SCENARIO.work(pieces[0].task).values())))
        if all(map(find_spec, CLUSTER)):
            for count in COUNTS:
                with secure_cluster(count) as address, connected(address) as on_cluster:
                    seconds_of(pieces[: 2 * count], on_cluster)
                    times[f"{count} dask workers"] = seconds_of(pieces, on_cluster)
                    each = seconds_of(empty, on_cluster) / EMPTY
                    where = f"{count} dask workers"
                    rows.append(time_row("workers", "-", "none", "an empty piece", "step_time", each, EMPTY, condition=where))
        else:
            print("bench workers: dask is left out: pip install 'fusion-sfdia[dask]'", file=sys.stderr)
    one = times["1 processes"]
    for where, time in times.items():
        names = ("workers", PLANT, DETECTOR, f"{PIECES} pieces")
        rows.append(time_row(*names, "step_time", time, 1, condition=where))
        rows.append(time_row(*names, "speedup", one / time, 1, condition=where))
    return rows


def _bytes(which: str, count: int) -> Row:
    return time_row("workers", PLANT, DETECTOR, f"a piece, {which}", "sent_bytes", float(count), 1)
