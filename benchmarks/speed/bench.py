"""The benchmark of speed: its parts are the other modules of this folder, each with a function `measure` of seconds.

All on one thread. Compared calls take turns, and the least time of each counts (see `experiments.timing`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from fusion_sfdia.benchmarks.speed import bank, engine, growth, lorenz, model, scaling, stream
from fusion_sfdia.core.files import require_free
from fusion_sfdia.evaluation.results import Row, write_rows

SECONDS = 2.0  # of each call
PARTS = {
    "bank": bank,
    "model": model,
    "scaling": scaling,
    "lorenz": lorenz,
    "engine": engine,
    "stream": stream,
    "growth": growth,
}


def run(parts: Sequence[str], out: Path | None = None, seconds: float = SECONDS, *, force: bool = False) -> list[Row]:
    """Return the rows of some parts (none: all), each call timed for about `seconds`; into out/metrics.csv where out is given.

    Raises ValueError for an unknown part and where the folder is not free (see output.require_free).
    """
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        raise ValueError(f"unknown part {', '.join(unknown)} of the benchmark; known: {', '.join(PARTS)}")
    if out is not None:
        require_free(out, force=force)
    with threadpool_limits(1):
        rows = [row for part in parts or PARTS for row in PARTS[part].measure(seconds)]
    if out is not None:
        write_rows(out / "metrics.csv", rows)
    return rows


def as_text(row: Row) -> str:
    """A row as text: times in ms, memory in MB."""
    factor, unit = {"step_time": (1e3, " ms"), "peak_memory": (1e-6, " MB")}.get(row.metric, (1.0, ""))
    part, what = row.scenario.removeprefix("bench/"), ", ".join(filter(None, (row.quantity, row.condition)))
    return f"{part:<8} {row.plant:<14} {row.detector:<12} {what:<32} {row.metric:<12} {row.value * factor:10.4g}{unit}"
