"""The rows that a comparison writes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.comparison.numbers import Cell, Measure, confusion, widened, within
from fusion_sfdia.comparison.protocol import HEALTHY, PUBLISHED, sizes
from fusion_sfdia.comparison.published import published_accuracy, published_delay
from fusion_sfdia.evaluation.metrics import Estimate, proportion, rate_over_runs
from fusion_sfdia.evaluation.results import Published, Row

Array = NDArray[Any]

SCENARIO = "comparison"
POOLED = "graded"  # bias, drift, noise and scale of one size

# metrics of the runs of some conditions: where sensors are faulty, of several kinds of one size also more, and where none is
SINGLE: dict[str, Measure] = {
    "missed_detection_rate": lambda cell, rows: less(cell.detected(rows)),
    "detection_delay": Cell.delay,
    "exact_isolation": Cell.exact,
    "isolation_recall": Cell.recall,
    "rmse_ratio": Cell.gain,
}
SEVERAL: dict[str, Measure] = SINGLE | {
    "detection_probability": Cell.alarms,
    "isolation_precision": lambda cell, rows: cell.rate("right", rows, cell["named"][rows]),
    "false_flag_rate": Cell.false_flags,
    "fault_mape_percent": Cell.size_error,
    "rmse_sigma": lambda cell, rows: cell.rms("measured", rows),
    "rmse_unaccommodated_sigma": lambda cell, rows: cell.rms("raw", rows),
    "rmse_healthy_sigma": lambda cell, rows: cell.rms("noise", rows),
    "rmse_all_sigma": lambda cell, rows: cell.rms("all_measured", rows),
    "diverged": lambda cell, rows: proportion(int(cell["diverged"][rows].sum()), cell["diverged"][rows].size),
}
INNOCENT: dict[str, Measure] = {
    "alarm_probability": Cell.alarms,
    "blame_probability": Cell.blame,
}
SHARES = (
    *("missed_detection_rate", "detection_probability", "exact_isolation", "isolation_recall", "isolation_precision"),
    *("false_flag_rate", "alarm_probability", "blame_probability"),
)
DROPOUT: dict[str, Measure] = INNOCENT | {"rmse_sigma": lambda cell, rows: cell.rms("measured", rows)}


def less(e: Estimate) -> Estimate:
    """One less a share."""
    return Estimate(1 - e.value, 1 - e.high, 1 - e.low, e.n)


def rows_of_cell(cell: Cell) -> list[Row]:
    """All rows of a cell."""
    rows: list[Row] = []

    def add(fault: str, quantity: str, metric: str, e: Estimate) -> None:
        rows.append(Row(SCENARIO, cell.plant, cell.detector, fault, quantity, metric, *e))

    def add_all(fault: str, quantity: str, measures: Mapping[str, Measure], *names: str, truth: str = "") -> None:
        for metric, measure in measures.items():
            found = cell.of(measure, *names, truth=truth)
            add(fault, quantity, metric, within(found, 0.0, 1.0) if metric in SHARES else found)

    def exactly(value: float) -> Estimate:
        return Estimate(value, np.nan, np.nan, 0)

    add(HEALTHY, "all", "threshold_scale", widened(Estimate(cell.scale, cell.scale, cell.scale, 0), cell.scale_error))
    add(HEALTHY, "all", "calibration_error", exactly(cell.calibration_error))
    add(HEALTHY, "all", "nominal_false_alarm_probability", cell.nominal)
    if np.isfinite(cell["claim"]):
        add(HEALTHY, "all", "claimed_false_alarm_probability", exactly(float(cell["claim"])))
    add(HEALTHY, "all", "target_false_alarm_probability", exactly(cell.settings["false_alarm"]))
    add(HEALTHY, "all", "matched_false_alarm_probability", cell.matched)
    add(HEALTHY, "all", "deployed_false_alarm_probability", cell.deployed)
    add(HEALTHY, "all", "state_size", exactly(float(cell["state_bytes"])))
    for name, kind in cell.kinds.items():
        innocent = kind in (HEALTHY, "plant")
        add_all(name, "all", INNOCENT if innocent else DROPOUT if kind == "dropout" else SINGLE, name)
        if kind in (PUBLISHED, "plant"):
            rows += paper_rows(cell, name, kind)
    for size in cell.settings["magnitudes"]:
        if members := cell.graded(size):
            add_all(f"{POOLED}-{size:g}-sigma", "all", SEVERAL, *members)
    for name, area in cell.areas.items():
        add(name, "all", "auc", area)
    for size in dict.fromkeys(sizes(cell.settings)):
        add(f"{POOLED}-{size:g}-sigma", "all", "auc", cell.mean_area(size))
    for truth in cell.truths:
        for name in dict.fromkeys(cell["condition"][cell["truth"] == truth].tolist()):
            add_all(name, truth, INNOCENT if name == HEALTHY else SINGLE, name, truth=truth)
    quantities = list(cell.model.quantities)
    for quantity, samples in zip(quantities, confusion(cell), strict=True):
        for named, hits in zip(("none", *(f"another {n}" for n in quantities), "the right one"), samples.T, strict=True):
            if hits.any():
                add("large", f"{quantity}: {named}", "named_share", rate_over_runs(hits, samples.sum(axis=-1)))
    return rows


def paper_rows(cell: Cell, name: str, kind: str) -> list[Row]:
    """Runs judged right by quantity, and delays, beside what is published of them."""
    found = []

    def add(quantity: str, metric: str, e: Estimate, published: Published | None) -> None:
        value, source = (published.value, published.source) if published else (None, "")
        found.append(Row(SCENARIO, cell.plant, cell.detector, name, quantity, metric, *e, value, source))

    rows = cell.rows_of(name)
    for quantity, members in cell.model.quantities.items() if kind == PUBLISHED else ():
        if (of := np.isin(cell["sensor"][rows], members)).any():
            right = cell["judged"][rows][of]
            accuracy = published_accuracy(cell.plant, cell.detector, name, quantity)
            add(quantity, "trial_accuracy", proportion(int(right.sum()), right.size), accuracy)
    if (stated := published_delay(cell.plant, cell.detector, name)) is not None:
        until, what, delay = stated
        add(what, "detection_delay", cell.delay(rows, until), delay)
    return found
