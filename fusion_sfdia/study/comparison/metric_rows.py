"""The numbers of a comparison by name: the rows that it writes, and the measures by which its report describes a detector."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.run_statistics import NOTHING, Estimate, proportion, rate_over_runs
from fusion_sfdia.report.results import Published, Row
from fusion_sfdia.study.comparison.cell import CellNumber, ComparisonCell, widened, within
from fusion_sfdia.study.comparison.protocol import GRADED, HEALTHY, PROCESS, PUBLISHED, sizes
from fusion_sfdia.study.experiments.scenario import Settings

Array = NDArray[Any]

SCENARIO = "comparison"
POOLED = "graded"  # bias, drift, noise and scale of one size
GLANCE = 8  # the first of the measures are in the overview

# metrics of the runs of some conditions: where sensors are faulty, of several kinds of one size also more, and where none is
SINGLE: dict[str, CellNumber] = {
    "missed_detection_rate": lambda cell, rows: less(cell.detected(rows)),
    "detection_delay": ComparisonCell.delay,
    "exact_isolation": ComparisonCell.exact,
    "isolation_recall": ComparisonCell.recall,
    "rmse_ratio": ComparisonCell.gain,
}
SEVERAL: dict[str, CellNumber] = SINGLE | {
    "detection_probability": ComparisonCell.alarms,
    "isolation_precision": lambda cell, rows: cell.rate("right", rows, cell["isolated"][rows]),
    "false_flag_rate": ComparisonCell.false_flags,
    "fault_mape_percent": ComparisonCell.size_error,
    "rmse_sigma": lambda cell, rows: cell.rms("measured", rows),
    "rmse_unaccommodated_sigma": lambda cell, rows: cell.rms("raw", rows),
    "rmse_healthy_sigma": lambda cell, rows: cell.rms("noise", rows),
    "rmse_all_sigma": lambda cell, rows: cell.rms("all_measured", rows),
    "diverged": lambda cell, rows: proportion(int(cell["diverged"][rows].sum()), cell["diverged"][rows].size),
}
NO_SENSOR_FAULT: dict[str, CellNumber] = {
    "alarm_probability": ComparisonCell.alarms,
    "false_isolation_probability": ComparisonCell.false_isolation,
}
SHARES = (
    *("missed_detection_rate", "detection_probability", "exact_isolation", "isolation_recall", "isolation_precision"),
    *("false_flag_rate", "alarm_probability", "false_isolation_probability"),
)
DROPOUT: dict[str, CellNumber] = NO_SENSOR_FAULT | {"rmse_sigma": lambda cell, rows: cell.rms("measured", rows)}


def less(e: Estimate) -> Estimate:
    """One less a share."""
    return Estimate(1 - e.value, 1 - e.high, 1 - e.low, e.n)


def rows_of_cell(cell: ComparisonCell) -> list[Row]:
    """All rows of a cell."""
    rows: list[Row] = []

    def add(fault: str, metric: str, e: Estimate, *, quantity: str = "all", condition: str = "") -> None:
        rows.append(Row(SCENARIO, cell.plant, cell.detector, fault, quantity, metric, *e, condition=condition))

    def add_all(
        fault: str, condition: str, numbers: Mapping[str, CellNumber], names: Iterable[str], *, mismatch: str = ""
    ) -> None:
        for metric, number in numbers.items():
            found = cell.of(number, *names, mismatch=mismatch)
            add(fault, metric, within(found, 0.0, 1.0) if metric in SHARES else found, condition=condition)

    def exactly(value: float) -> Estimate:
        return Estimate(value, np.nan, np.nan, 0)

    add(HEALTHY, "threshold_scale", widened(Estimate(cell.scale, cell.scale, cell.scale, 0), cell.scale_error))
    add(HEALTHY, "calibration_error", exactly(cell.calibration_error))
    add(HEALTHY, "nominal_false_alarm_probability", cell.nominal)
    if np.isfinite(cell["claim"]):
        add(HEALTHY, "claimed_false_alarm_probability", exactly(float(cell["claim"])))
    add(HEALTHY, "target_false_alarm_probability", exactly(cell.settings["false_alarm"]))
    add(HEALTHY, "matched_false_alarm_probability", cell.matched)
    add(HEALTHY, "deployed_false_alarm_probability", cell.deployed)
    add(HEALTHY, "state_size", exactly(float(cell["state_bytes"])))
    for name, c in cell.conditions.items():
        without = c.kind in (HEALTHY, PROCESS)
        add_all(*c.columns, NO_SENSOR_FAULT if without else DROPOUT if c.kind == "dropout" else SINGLE, [name])
        if c.kind in (PUBLISHED, PROCESS):
            rows += paper_rows(cell, name, c.kind)
    for size in cell.settings["magnitudes"]:
        if members := cell.graded(size):
            add_all(f"{POOLED}-{size:g}-sigma", "", SEVERAL, members)
    for name, area in cell.areas.items():
        fault, condition = cell.conditions[name].columns
        add(fault, "auc", area, condition=condition)
    for size in dict.fromkeys(sizes(cell.settings)):
        add(f"{POOLED}-{size:g}-sigma", "auc", cell.mean_area(size))
    for mismatch in cell.mismatches:
        for name in dict.fromkeys(cell["condition"][cell["mismatch"] == mismatch].tolist()):
            add_all(name, mismatch, NO_SENSOR_FAULT if name == HEALTHY else SINGLE, [name], mismatch=mismatch)
    quantities = list(cell.model.quantities)
    isolated = ("none", *(f"another {n}" for n in quantities), "the faulty sensor")
    for quantity, samples in zip(quantities, confusion(cell), strict=True):
        for what, hits in zip(isolated, samples.T, strict=True):
            if hits.any():
                share = rate_over_runs(hits, samples.sum(axis=-1))
                add("large", "isolated_share", share, quantity=quantity, condition=f"isolated: {what}")
    return rows


def paper_rows(cell: ComparisonCell, name: str, kind: str) -> list[Row]:
    """Runs judged right by quantity, and delays, beside what is published of them."""
    found = []

    def add(quantity: str, condition: str, metric: str, e: Estimate, published: Published | None) -> None:
        value, source = (published.value, published.source) if published else (None, "")
        names = (SCENARIO, cell.plant, cell.detector, name, quantity, metric)
        found.append(Row(*names, *e, value, source, condition=condition))

    rows = cell.rows_of(name)
    for quantity, members in cell.model.quantities.items() if kind == PUBLISHED else ():
        if (of := np.isin(cell["sensor"][rows], members)).any():
            right = cell["judged"][rows][of]
            accuracy = cell.cases.published_accuracy(cell.detector, name, quantity)
            add(quantity, "", "trial_accuracy", proportion(int(right.sum()), right.size), accuracy)
    if (stated := cell.cases.published_delay(cell.detector, name)) is not None:
        add(stated.quantity, stated.condition, "detection_delay", cell.delay(rows, stated.until), stated.value)
    return found


def confusion(cell: ComparisonCell) -> Array:
    """What is isolated where a sensor of each quantity is faulty (Q, runs, Q + 2): none, another of each quantity, that one.

    Samples of bias, drift, noise and scale at their two largest sizes, of replays and negated readings; sizes share noise and
    sensor and count as one run; where several are isolated, each has its share of the sample. Runs in which a sensor of another
    quantity is faulty have none.
    """
    large = sorted(cell.settings["magnitudes"])[-2:]
    single = [c for c in cell.conditions.values() if (c.kind in GRADED and c.sigmas in large) or c.kind in ("sign", "replay")]
    kinds = [cell.rows_of(*(c.name for c in single if c.kind == kind)) for kind in dict.fromkeys(c.kind for c in single)]
    width, count = cell["isolated_as"].shape[-1], len(cell.seeds)
    sensor = np.array([cell["sensor"][rows[0]] for rows in kinds]).reshape(len(kinds) * count)
    samples = np.array([cell["isolated_as"][rows].sum(axis=0) for rows in kinds]).reshape(len(kinds) * count, width)
    return np.stack([np.where(np.isin(sensor, q)[:, None], samples, 0.0) for q in cell.model.quantities.values()])


def share_right(cell: ComparisonCell) -> float:
    """Share of the samples of `confusion` in which the faulty sensor is isolated."""
    samples = confusion(cell)
    return float(samples[..., -1].sum() / samples.sum()) if samples.any() else np.nan


class Measure(NamedTuple):
    """A number of the report, whether less of it is better, and whether its decades are what differs."""

    of: Callable[[ComparisonCell], Estimate]
    less: bool = False
    decades: bool = False


class FalseIsolation(NamedTuple):
    """Share of samples at which a healthy sensor is isolated, and under which case."""

    share: Estimate
    case: str


def under_mismatch(cell: ComparisonCell) -> FalseIsolation:
    """The worst of the mismatch cases."""
    return _worst(FalseIsolation(cell.false_isolation(cell.rows_of(HEALTHY, mismatch=m)), m) for m in cell.mismatches)


def under_process_faults(cell: ComparisonCell) -> FalseIsolation:
    """The worst of the process faults."""
    return _worst(FalseIsolation(cell.false_isolation(cell.rows_of(name)), name) for name in cell.names_of(PROCESS))


def _worst(found: Iterable[FalseIsolation]) -> FalseIsolation:
    return max(found, key=lambda one: one.share.value, default=FalseIsolation(NOTHING, "none"))


def exact_isolation(settings: Settings, cell: ComparisonCell) -> Estimate:
    """Share of the samples under a large fault at which exactly the faulty sensor is isolated."""
    return cell.of(ComparisonCell.exact, *cell.graded(sizes(settings)[1]))


def best_isolation(settings: Settings, cells: Mapping[str, ComparisonCell]) -> str | None:
    """The detector of a plant with the largest share of exact isolation; None without large faults."""
    shares = {d: v for d, c in cells.items() if np.isfinite(v := exact_isolation(settings, c).value)}
    return max(shares, key=lambda d: shares[d]) if shares else None


def detected_share(settings: Settings, cell: ComparisonCell) -> float:
    """Share of the runs with a large fault that raise an alarm; NaN where there is none."""
    rows = cell.rows_of(*cell.graded(sizes(settings)[1]))
    return cell.detected(rows).value if rows.size else np.nan


def measures(settings: Settings) -> dict[str, Measure]:
    """All measures, in the order of the report."""
    small, large = sizes(settings)
    bias = f"bias-{small:g}-sigma"

    def pooled(number: CellNumber, size: float) -> Callable[[ComparisonCell], Estimate]:
        return lambda cell: cell.of(number, *cell.graded(size))

    return {
        f"runs with an alarm, {large:g} sigma": Measure(pooled(ComparisonCell.detected, large)),
        f"exact isolation, {large:g} sigma": Measure(pooled(ComparisonCell.exact, large)),
        f"mean area under ROCs, {small:g} sigma": Measure(lambda cell: cell.mean_area(small)),
        f"error after over before, {large:g} sigma": Measure(pooled(ComparisonCell.gain, large), less=True, decades=True),
        "false isolation, worst mismatch case": Measure(lambda cell: under_mismatch(cell).share, less=True),
        "false isolation, worst process fault": Measure(lambda cell: under_process_faults(cell).share, less=True),
        "healthy samples with an alarm as deployed": Measure(lambda cell: cell.deployed, less=True, decades=True),
        "false alarms at its own threshold": Measure(lambda cell: cell.nominal, less=True, decades=True),
        f"faulty sensor among the isolated, {large:g} sigma": Measure(pooled(ComparisonCell.recall, large)),
        f"runs with an alarm, {small:g} sigma": Measure(pooled(ComparisonCell.detected, small)),
        f"area under the ROC, {bias.replace('-', ' ')}": Measure(lambda cell: cell.areas.get(bias, NOTHING)),
        f"delay (s), {large:g} sigma": Measure(pooled(ComparisonCell.delay, large), less=True),
        f"healthy sensors isolated, {large:g} sigma": Measure(pooled(ComparisonCell.false_flags, large), less=True),
        f"error of the fault's size (%), {large:g} sigma": Measure(pooled(ComparisonCell.size_error, large), less=True),
    }


def glance(settings: Settings) -> dict[str, Measure]:
    """The measures of the overview."""
    return dict(list(measures(settings).items())[:GLANCE])
