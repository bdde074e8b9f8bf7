"""Rows of the scenario `robustness` that are made up: a detector that tests the process, and one that does not."""

from __future__ import annotations

from fusion_sfdia.comparison.protocol import HEALTHY
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.robustness.aims import AT_END, BIAS, DRIFT, EXACT, FALSE, NAMING, RATIO, VERDICT, mismatches, process_faults
from fusion_sfdia.robustness.protocol import slow_name
from fusion_sfdia.robustness.rows import SCENARIO
from fusion_sfdia.robustness.tables import RIGHT

PLANT = "two-tanks"
BLIND, KNOWING = "loo-glr", "robust-glr"


def row(detector: str, fault: str, metric: str, value: float, condition: str = "") -> Row:
    """A row of 24 runs whose interval is 0.01 to each side."""
    return Row(SCENARIO, PLANT, detector, fault, "all", metric, value, value - 0.01, value + 0.01, 24, condition=condition)


def made_up(detector: str, *, false: float, exact: float, verdict: float | None) -> list[Row]:
    """All rows of a detector; without a verdict it has no hypotheses about the process."""
    rows = [row(detector, RIGHT[0], "auc", 0.99), row(detector, HEALTHY, FALSE, 0.0), row(detector, HEALTHY, RATIO, 1.5)]
    rows += [row(detector, fault, EXACT, 0.95) for fault in RIGHT]
    for case in mismatches(PLANT):
        rows.append(row(detector, HEALTHY, FALSE, false, case))
        rows += [row(detector, fault, EXACT, exact, case) for fault in (BIAS, DRIFT)]
    for fault in process_faults(PLANT):
        rows.append(row(detector, fault, FALSE, false))
        if verdict is not None:
            rows += [row(detector, fault, metric, verdict) for metric in (VERDICT, NAMING)]
    if verdict is not None:
        rows += [row(detector, fault, VERDICT, 0.0) for fault in RIGHT]
    return rows + [row(detector, slow_name(n), AT_END, 0.96) for n in (180, 480, 1500)]


def both() -> list[Row]:
    """A detector that reaches every aim, and one that isolates a healthy sensor always."""
    return [*made_up(BLIND, false=1.0, exact=0.0, verdict=None), *made_up(KNOWING, false=0.0, exact=0.95, verdict=1.0)]
