"""The benchmark of speed: its parts are the other modules of this folder, each with a function `measure` of seconds.

All on one thread. Compared calls take turns with each other and with a reference, and the least time of each counts (see
`study.experiments.timing` and `support.calls.timed`).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from threadpoolctl import threadpool_limits

from fusion_sfdia.benchmarks.speed import (
    bank,
    campaigns,
    engine,
    growth,
    large,
    logs,
    lorenz,
    model,
    network,
    own,
    peers,
    roofline,
    scaling,
    start,
    stream,
    workers,
)  # fmt: skip
from fusion_sfdia.common.files import locked
from fusion_sfdia.derivatives.equation import AsPython
from fusion_sfdia.report.results import Row, write_rows

SECONDS = 2.0  # of each call
PARTS = {
    "bank": bank,
    "model": model,
    "scaling": scaling,
    "lorenz": lorenz,
    "engine": engine,
    "stream": stream,
    "own": own,
    "network": network,
    "campaigns": campaigns,
    "logs": logs,
    "start": start,
    "workers": workers,
    "peers": peers,
    "growth": growth,
    "large": large,
    "roofline": roofline,
}
ON_REQUEST = ("large", "roofline")  # take minutes
UNITS = {"step_time": (1e3, " ms"), "peak_memory": (1e-6, " MB")}


def run(parts: Sequence[str], out: Path | None = None, seconds: float = SECONDS, *, force: bool = False) -> list[Row]:
    """Return the rows of some parts, each call timed for about `seconds`; into out/metrics.csv where out is given.

    No parts: all but those ON_REQUEST. Raises ValueError for an unknown part and where the folder is not free (see
    files.locked).
    """
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        raise ValueError(f"unknown part {', '.join(unknown)} of the benchmark; known: {', '.join(PARTS)}")
    chosen = parts or [part for part in PARTS if part not in ON_REQUEST]
    AsPython.patient = False
    with nullcontext() if out is None else locked(out, force=force):
        with threadpool_limits(1):
            rows = [row for part in chosen for row in PARTS[part].measure(seconds)]
        if out is not None:
            write_rows(out / "metrics.csv", rows)
    return rows


def as_text(row: Row) -> str:
    """A row as text: times in ms, memory in MB, a ratio with its interval."""
    factor, unit = UNITS.get(row.metric, (1.0, ""))
    part, what = row.scenario.removeprefix("bench/"), ", ".join(filter(None, (row.quantity, row.condition)))
    wide = f" [{row.low:.4g}, {row.high:.4g}]" if row.low == row.low else ""
    return f"{part:<9} {row.plant:<14} {row.detector:<14} {what:<44} {row.metric:<12} {row.value * factor:10.4g}{unit}{wide}"
