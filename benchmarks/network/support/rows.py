"""Rows and text of numbers that the scenarios of the power network share."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.run_statistics import Estimate, bootstrap_over_runs, mean_over_runs
from fusion_sfdia.report.results import Published, Row, row_of

Array = NDArray[Any]

PLANT = "power-network"
LEAST, MOST = 0.05, 0.95  # between them nine of ten runs
MakeRow = Callable[[str, Estimate, Published | None], Row]  # of metric, estimate, what is published

row = partial(row_of, PLANT)  # of scenario, detector, fault, quantity, metric, estimate, published; condition


def detector_name(mode: str) -> str:
    """The name of the diagnosers in metrics.csv."""
    return f"chebyshev:{mode}"


def time_rows(
    make: MakeRow, event: str, times: Array, onset: float, delay: Published | None = None, at: Published | None = None
) -> list[Row]:
    """Mean delay since the onset, and median, 5 % and 95 % points of the time, of the runs (B,) in which the event occurred."""
    came = times[np.isfinite(times)]
    rows = [make(f"{event}_delay", mean_over_runs(came - onset, np.ones(came.size)), delay)]
    metric = {"detection": "first_alarm_time"}.get(event, f"{event}_time")
    for name, share in (("", 0.5), ("_p5", LEAST), ("_p95", MOST)):
        statistic = _quantile(came, share)
        rows.append(make(f"{metric}{name}", bootstrap_over_runs(statistic, came.size), at if name == "" else None))
    return rows


def _quantile(values: Array, share: float) -> Callable[[Array], Array]:
    return lambda runs: np.quantile(values[runs], share, axis=-1, method="inverted_cdf")


def spread(times: Array) -> str:
    """Median [5 %, 95 %] of times (s), where runs without the event count as the latest: "48 [48-50]"."""
    if not times.size:
        return "unknown"
    low, middle, high = (float(np.quantile(times, q, method="inverted_cdf")) for q in (LEAST, 0.5, MOST))
    shown = ["never" if np.isinf(v) else f"{v:g}" for v in (middle, low, high)]
    return f"{shown[0]} [{shown[1]}-{shown[2]}]"
