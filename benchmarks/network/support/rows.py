"""Numbers and figures that the scenarios of the power network share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.evaluation.metrics import Estimate, bootstrap_over_runs, mean_over_runs, proportion
from fusion_sfdia.evaluation.results import Published, Row

Array = NDArray[Any]

PLANT = "power-network"
LEAST, MOST = 0.05, 0.95  # between them nine of ten runs
Tell = Callable[[str, Estimate, Published | None], Row]


def detector_name(mode: str) -> str:
    """The diagnosers' name in metrics.csv."""
    return f"chebyshev:{mode}"


def teller(scenario: str, mode: str, fault: str, quantity: str) -> Tell:
    """A function of metric, estimate and what is published that gives the row."""

    def tell(metric: str, estimate: Estimate, published: Published | None) -> Row:
        value, source = (None, "") if published is None else (published.value, published.source)
        return Row(scenario, PLANT, detector_name(mode), fault, quantity, metric, *estimate, published=value, source=source)

    return tell


def time_rows(tell: Tell, event: str, times: Array, onset: float, delay: Published | None, at: Published | None) -> list[Row]:
    """Mean delay since the onset, and median, 5 % and 95 % points of the time, of the runs (B,) in which the event came."""
    came = times[np.isfinite(times)]
    rows = [tell(f"{event}_delay", mean_over_runs(came - onset, np.ones(came.size)), delay)]
    metric = {"detection": "first_alarm_time"}.get(event, f"{event}_time")
    for name, share in (("", 0.5), ("_p5", LEAST), ("_p95", MOST)):
        statistic = _quantile(came, share)
        rows.append(tell(f"{metric}{name}", bootstrap_over_runs(statistic, came.size), at if name == "" else None))
    return rows


def _quantile(values: Array, share: float) -> Callable[[Array], Array]:
    return lambda runs: np.quantile(values[runs], share, axis=-1, method="inverted_cdf")


def share(what: Array) -> Estimate:
    """The share of runs (B,) of which it is true."""
    return proportion(int(np.sum(what)), int(np.size(what)))


def spread(times: Array) -> str:
    """Median [5 %, 95 %] of times (s), runs in which the event did not come last: "48 [48-50]"."""
    if not times.size:
        return "unknown"
    low, middle, high = (float(np.quantile(times, q, method="inverted_cdf")) for q in (LEAST, 0.5, MOST))
    told = ["never" if np.isinf(v) else f"{v:g}" for v in (middle, low, high)]
    return f"{told[0]} [{told[1]}-{told[2]}]"
