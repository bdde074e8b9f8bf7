"""The history of speed: a file of JSON lines, one a run, with the machine, the code, and all ratios with their spreads."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info

from fusion_sfdia import __version__
from fusion_sfdia.benchmarks.speed.slower import Key, Ratio
from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.experiments.provenance import cores, git_commit, versions

NAMES = ("scenario", "plant", "detector", "quantity", "condition")
CPUINFO = Path("/proc/cpuinfo")  # of Linux


def machine() -> dict[str, Any]:
    """What decides how ratios of times compare: processor, cores, the kernel of the linear algebra. No name of a host."""
    blas = sorted({f"{b['internal_api']} {b['version']} {b.get('architecture', '')}".strip() for b in threadpool_info()})
    return {"processor": _processor(), "cores": cores(), "linear algebra": [b for b in blas if "openmp" not in b]}


def _processor() -> str:
    if CPUINFO.exists():
        for line in CPUINFO.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def entry(rows: Sequence[Row], seconds: float) -> dict[str, Any]:
    """The line of a run, as JSON holds it."""
    times = [
        {**{name: getattr(r, name) for name in NAMES}, "ratio": r.value, "spread": _spread(r), "calls": r.n}
        for r in rows
        if r.metric == "ratio"
    ]
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "version": __version__,
        "commit": git_commit(),
        "machine": machine(),
        "versions": versions(),
        "seconds": seconds,
        "rows": times,
    }


def _spread(row: Row) -> float:
    """The spread of the logarithm of a ratio with the interval of `timed_rows`."""
    return math.log(row.high / row.value) / 1.96


def ratios(run: dict[str, Any]) -> dict[Key, Ratio]:
    """The ratios of a line, by what was measured."""
    return {tuple(r[name] for name in NAMES): Ratio(r["ratio"], r["spread"]) for r in run["rows"]}


def read(path: Path) -> list[dict[str, Any]]:
    """The runs of a history, oldest first; ValueError with the line for what is none."""
    runs = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            run = json.loads(line)
            known = ratios(run)
            sound = all(np.isfinite(r).all() and r.value > 0 <= r.spread for r in known.values()) and {*run["machine"]}
        except (ValueError, KeyError, TypeError) as error:
            sound, problem = False, f" ({type(error).__name__}: {error})"
        else:
            problem = ""
        if not sound:
            raise ValueError(f"{path}, line {number} is no run of bench{problem}; remove it, or name a file of bench --history")
        runs.append(run)
    return runs


def append(path: Path, run: dict[str, Any]) -> None:
    """Add a line to a history, whole or not at all; ValueError where the file is no history."""
    if path.exists():
        read(path)
    kept = path.read_text(encoding="utf-8") if path.exists() else ""
    with atomic_write(path) as file:
        file.write(kept + ("\n" if kept and not kept.endswith("\n") else "") + json.dumps(run, allow_nan=False) + "\n")


def alike(runs: Sequence[dict[str, Any]], path: Path) -> list[dict[str, Any]]:
    """The runs on this machine; ValueError where there is none: ratios carry over from one kind to another only roughly."""
    here = machine()
    if same := [run for run in runs if run["machine"] == here]:
        return same
    known = "; ".join(dict.fromkeys(json.dumps(run["machine"]) for run in runs)) or "none"
    raise ValueError(f"{path} has no run on a machine like this one ({json.dumps(here)}), but: {known}; add one by --history")
