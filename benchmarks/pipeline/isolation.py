"""pipeline/isolation: which sensor is faulty (Shaheen 2024, Fig. 6)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.pipeline.support.rows import judged_runs, row
from fusion_sfdia.benchmarks.pipeline.support.trials import COMMON, OURS, PAPER, SENSORS, STRENGTHS, Results, grid, tasks, trial
from fusion_sfdia.common.run_statistics import mean_over_runs
from fusion_sfdia.models.gas_pipeline.published import QUANTITIES
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.plots import isolation_matrix, panels
from fusion_sfdia.report.scenario_sentences import left_out
from fusion_sfdia.study import detection_metrics as metrics
from fusion_sfdia.study.experiments.scenario import Scenario, Settings, Task
from fusion_sfdia.study.isolation_metrics import (
    confusion,
    exact_isolation,
    false_flag_rate,
    isolation_precision,
    isolation_recall,
)

PLANT_DT = 10.0  # s between readings (Shaheen 2024, sec. IV-A)


def draw_matrices(counts: Mapping[str, Any]) -> Drawing:
    """One matrix per detector."""
    figure, axes = panels(list(counts), columns=3, width=10.5, height=3.3)
    starts = {"none": 0, **{q: 1 + i * (SENSORS // 3) for i, q in enumerate(QUANTITIES)}}
    for axis, matrix in zip(axes, counts.values(), strict=True):
        isolation_matrix(axis, matrix, boundaries=starts)
    return figure


def isolation_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Every detector on the paper's faults of every quantity; Fig. 6 has the weak bias."""
    faults = settings["faults"]
    assert isinstance(faults, tuple)
    together = [[f for f in strength if f in faults] for strength in STRENGTHS]
    fault = [of_one for of_one in together if of_one]
    return tasks(settings, grid(detector=(*PAPER, *OURS), fault=fault, quantity=[list(QUANTITIES)], accommodate=(True,)), seeds)


def isolation_summary(settings: Settings, results: Results) -> Summary:
    """Recall, precision, exactness, false flags, and the paper's matrices."""
    rows = []
    for (detector, fault, quantity), cell in judged_runs(results, "detector", "fault", "quantity").items():
        at = partial(row, "pipeline/isolation", detector, fault, quantity)
        t = PLANT_DT * np.arange(cell.active.shape[0])
        rows += [
            at("isolation_recall", isolation_recall(cell.isolated, cell.active)),
            at("isolation_precision", isolation_precision(cell.isolated, cell.active)),
            at("exact_isolation", exact_isolation(cell.isolated, cell.active)),
            at("false_flag_rate", false_flag_rate(cell.isolated, cell.active)),
            at("missed_detection_rate", metrics.missed_detection_rate(cell["alarm"], cell.active)),
            at("detection_delay", metrics.detection_delay(t, cell["alarm"], cell.active)),
            at("isolation_delay", metrics.isolation_delay(t, cell.isolated, cell.active)),
            at("diverged", cell.divergence),
            at("fault_mape_percent", _size_error(cell["size_error"])),
        ]
    of_faults = judged_runs(results, "detector", "fault")
    weak = {detector: cell for (detector, fault), cell in of_faults.items() if fault == "weak-bias"}
    figure = Figure(
        "isolation-weak-bias",
        "Isolation matrices, weak bias",
        "Each row is a faulty sensor (63, by quantity, inlet to outlet), grey where no run has this fault; each column is "
        "the isolated sensor. Yellow on the diagonal: correct; yellow in the first column: missed.",
        lambda: draw_matrices({d: confusion(c.isolated, c.active) for d, c in weak.items()}),
        "Five confusion matrices of 64 by 64, one per detector",
    )
    remarks = [
        "The paper shows Fig. 6 as images without numbers: the fusing EKF isolates no pressure sensor, the fusing UKF is weak "
        "on temperature, the fusing EnKF isolates all.",
        "P0 is the paper's identity for the fusing EKF and UKF; the fusing EnKF starts from the sensors' noise instead, since "
        "members spread by 1 MPa at every node leave the gas model in their first step.",
    ]
    weak_bias = [r for r in rows if r.metric == "isolation_recall" and r.fault == "weak-bias" and np.isfinite(r.value)]
    highlights = [
        f"{d}: of the samples of a weak bias, the faulty sensor is isolated in "
        + ", ".join(f"{r.value:.0%} ({r.quantity})" for r in weak_bias if r.detector == d)
        for d in (*PAPER, *OURS)
        if any(r.detector == d for r in weak_bias)
    ]
    return Summary(rows=rows, figures=[figure], highlights=highlights, remarks=[*remarks, *left_out(rows)])


def _size_error(relative: Any) -> Any:
    known = np.isfinite(relative)
    return mean_over_runs(100 * np.where(known, relative, 0.0).sum(axis=0), known.sum(axis=0))


SCENARIO = Scenario(
    name="pipeline/isolation",
    title="Isolation: which sensor is faulty",
    about="The same faults, accommodated during the run: the paper's bank treats the sensor with the largest "
    "residual (20) as missing while an entry of (19) exceeds its threshold; the consistent bank leaves a sensor out until "
    "it is healthy again. Thresholds: one alarm in a thousand samples (Shaheen 2024, Fig. 6).",
    settings={**COMMON, "faults": ("weak-bias", "weak-drift")},
    seeds=3,
    full_seeds=50,
    tasks=isolation_tasks,
    work=trial,
    summarise=isolation_summary,
)
