"""The numbers of `robustness`: the rows of metrics.csv, and how they are found again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.comparison.protocol import HEALTHY, PROCESS, PUBLISHED
from fusion_sfdia.comparison.subjects import cases_of, compared_plant, plant_of
from fusion_sfdia.core.uncertainty import equation_of, error_of
from fusion_sfdia.evaluation.cases import ProcessFaultCase
from fusion_sfdia.evaluation.detection_metrics import auc
from fusion_sfdia.evaluation.metrics import Estimate, mean_over_runs, proportion, rate_over_runs
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.experiments.scenario import Arrays, Settings, Task
from fusion_sfdia.robustness.protocol import SMALL, Condition, conditions, graded
from fusion_sfdia.robustness.records import FIELDS
from fusion_sfdia.robustness.variants import AS_IT_IS, Variant

Array = NDArray[Any]
Results = list[tuple[Task, Arrays]]
Index = Mapping[tuple[str, str, str, str, str], Row]

SCENARIO = "robustness"
OF_THE_PROCESS = ("process_verdict_probability", "process_naming_probability", "process_delay")
REFERENCE = "loo-glr"  # steps are timed beside its


def rows_of(settings: Settings, results: Results) -> list[Row]:
    """All rows, of the variants that apply."""
    rows: list[Row] = []
    for task, arrays in results:
        if "variants" in task:
            rows += timing_rows(task["plant"], arrays)
        elif "reason" not in arrays:
            rows += rows_of_variant(settings, task, arrays)
    return rows


def index_of(rows: Iterable[Row]) -> Index:
    """Rows by plant, detector, fault, condition and metric."""
    return {(r.plant, r.detector, r.fault, r.condition, r.metric): r for r in rows}


def rows_of_variant(settings: Settings, task: Task, arrays: Arrays) -> list[Row]:
    """The rows of one variant on one plant."""
    of = compared_plant(task["plant"])
    name = Variant(task["detector"], task["knowledge"]).name
    known = {(c.mismatch, c.fault.name): c for c in conditions(settings, cases_of(of))}
    rows: list[Row] = []
    for j, key in enumerate(zip(arrays["mismatch"].tolist(), arrays["condition"].tolist(), strict=True)):
        runs = {what: arrays[what][arrays["row"] == j] for what in FIELDS}
        for metric, found in numbers(known[key], runs, plant_of(of).dt).items():
            if metric in OF_THE_PROCESS and not arrays["tests_process"]:
                continue
            rows.append(Row(SCENARIO, of.name, name, key[1], "all", metric, *found, condition=key[0]))
    area = area_of(arrays["healthy_scores"], arrays["biased_scores"])
    scale = Estimate(float(arrays["scale"]), np.nan, np.nan, 0)
    rows.append(Row(SCENARIO, of.name, name, graded("bias", SMALL, 1).name, "all", "auc", *area))
    return [*rows, Row(SCENARIO, of.name, name, HEALTHY, "all", "threshold_scale", *scale)]


def numbers(condition: Condition, runs: Arrays, dt: float) -> dict[str, Estimate]:
    """The numbers of the runs (S,) of a condition by metric."""
    fault, count = condition.fault, runs["samples"].size
    found = {"false_isolation_probability": rate_over_runs(runs["falsely_isolated"], runs["samples"])}
    found["process_verdict_probability"] = proportion(int((runs["process"] > 0).sum()), count)
    if fault.kind not in (HEALTHY, PROCESS):
        found["exact_isolation"] = rate_over_runs(runs["exact"], runs["samples"])
    if fault.kind == PUBLISHED:
        found["isolated_at_end"] = proportion(int(runs["at_end"].sum()), count)
    if fault.kind == PROCESS:
        assert isinstance(fault.case, ProcessFaultCase)
        right = np.isin(runs["process_name"], [*names_of(fault.case), *equations_of(fault.case)])
        found["process_naming_probability"] = proportion(int(right.sum()), count)
        for metric, since in (("detection_delay", "first"), ("process_delay", "first_process")):
            seen = np.isfinite(runs[since])  # the fault shows a sample after it begins
            found[metric] = mean_over_runs(np.where(seen, runs[since] + 1.0, 0.0) * dt, seen.astype(float))
    if runs["diverged"].any():
        found["diverged"] = proportion(int(runs["diverged"].sum()), count)
    return found


def names_of(case: ProcessFaultCase) -> list[str]:
    """What a right verdict may be called: what the case names, and the error of an input of that name."""
    return [*case.named, *map(error_of, case.named)]


def equations_of(case: ProcessFaultCase) -> list[str]:
    """What a right verdict on a state that the case names is called: that its equation errs."""
    return list(map(equation_of, case.named))


def area_of(healthy: Array, biased: Array) -> Estimate:
    """The area under the ROC of scores of healthy (W, S) and biased (W', S) samples."""
    scores = np.concatenate([healthy, biased]).astype(float)
    active = np.broadcast_to((np.arange(len(scores)) >= len(healthy))[:, None, None], (*scores.shape, 1))
    return auc(scores, active)


def timing_rows(plant: str, arrays: Arrays) -> list[Row]:
    """Seconds of a step of each variant, and their ratio to those of REFERENCE on the plant as it is."""
    seconds = dict(zip(arrays["variant"].tolist(), arrays["step_seconds"].tolist(), strict=True))
    unit = seconds.get(Variant(REFERENCE, AS_IT_IS).name)
    rows = []
    for name, value in seconds.items():
        times = {"step_time": value} | ({} if unit is None else {"step_time_ratio": value / unit})
        rows += [Row(SCENARIO, plant, name, HEALTHY, "all", metric, number) for metric, number in times.items()]
    return rows


def variants_of(rows: Sequence[Row], plant: str) -> list[str]:
    """The variants of a plant that were judged, in the order of the rows."""
    return list(dict.fromkeys(r.detector for r in rows if r.plant == plant and r.metric == "auc"))
