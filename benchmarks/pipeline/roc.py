"""pipeline/roc: detection of faults over all thresholds (Shaheen 2024, Fig. 5)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.pipeline.support.rows import JudgedRuns, detection_rows, judged_runs
from fusion_sfdia.benchmarks.pipeline.support.trials import (
    AFTERMATH,
    COMMON,
    OURS,
    PAPER,
    STRENGTHS,
    Results,
    grid,
    tasks,
    trial,
)
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.models.gas_pipeline.published import FAULTS, QUANTITIES
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.plots import panels, roc_curves
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import left_out, listed, pick, span
from fusion_sfdia.study import detection_metrics as metrics
from fusion_sfdia.study.experiments.scenario import Scenario, Settings, Task


def roc_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Every detector on every fault of every quantity, without accommodation."""
    return tasks(
        settings, grid(detector=(*PAPER, *OURS), fault=STRENGTHS, quantity=[list(QUANTITIES)], accommodate=(False,)), seeds
    )


def draw_roc(cells: Mapping[tuple[Any, ...], JudgedRuns], fault: str) -> Drawing:
    """One panel per quantity. The false-alarm axis is logarithmic, since all curves are near the corner."""
    figure, axes = panels(QUANTITIES, columns=3, width=10.5, height=3.4)
    for axis, quantity in zip(axes, QUANTITIES, strict=True):
        curves = {}
        for (detector, kind, of), cell in cells.items():
            if (kind, of) == (fault, quantity):
                score = cell["score"][..., QUANTITIES.index(quantity)]
                curve = metrics.roc(score, cell.active, cell.judged)
                area = metrics.auc(score, cell.active, cell.judged)
                curves[f"{detector}  {f'{area.value:.3f}' if area.n else 'no runs left'}"] = curve[:2]
        roc_curves(axis, curves)
        axis.set_aspect("auto")
        axis.set(xscale="log", xlim=(1e-4, 1.05))
        if curves:
            axis.legend(fontsize=7, title="area under curve", title_fontsize=7, loc="lower left")
    return figure


def roc_summary(settings: Settings, results: Results) -> Summary:
    """Rows, a figure per fault, and remarks."""
    cells = judged_runs(results, "detector", "fault", "quantity")
    rows = detection_rows("pipeline/roc", cells)
    plant = gas_pipeline(snr=str(settings["snr"]))
    sigmas = np.abs(plant.x0) / plant.sensor_sigma  # each state has its sensor
    remarks = [
        "The paper prints its Fig. 5 as curves without numbers, so the areas cannot be compared. It finds the "
        "unscented and ensemble filters better than the extended one, most clearly on pressure. Here the smallest areas are: "
        f"{_smallest(rows)}.",
        f"The faults, 20 to 90 % of a reading, are {span([0.2 * sigmas.min(), 0.9 * sigmas.max()])} standard deviations of its "
        "noise. Faults near the noise are in pipeline/weak.",
        "Thresholds are swept over runs without accommodation. A pressure fault then drives the estimate out of "
        f"the gas model, where its steps are limited. The {AFTERMATH} samples after a fault, in which such a filter recovers, "
        f"are not judged. With them (auc_all_samples) the areas are {listed(pick(rows, metric='auc_all_samples'))}; without "
        f"them {listed(pick(rows, metric='auc'))}. Results with accommodation are in pipeline/isolation.",
    ]
    figures = [
        Figure(
            f"roc-{fault}",
            f"Receiver operating characteristics, {fault.replace('-', ' ')}",
            "Probability of detection over the probability of a false alarm, per sample, with varying threshold. Upper left is "
            "better; grey: chance.",
            partial(draw_roc, cells, fault),
            f"Three panels, one per quantity, with the ROC curves of five detectors for {fault.replace('-', ' ')} faults",
        )
        for fault in FAULTS
    ]
    return Summary(rows=rows, figures=figures, remarks=[*remarks, *left_out(rows)])


def _smallest(rows: list[Row]) -> str:
    """Each detector's smallest area, with its quantity and fault."""
    found = pick(rows, metric="auc")
    detectors = dict.fromkeys(r.detector for r in found)
    least = [min((r for r in found if r.detector == d), key=lambda r: r.value) for d in detectors]
    return "; ".join(f"{r.detector} {span([r.value])} ({r.quantity}, {r.fault.replace('-', ' ')})" for r in least) or "unknown"


SCENARIO = Scenario(
    name="pipeline/roc",
    title="Detection: ROC curves of bias and drift faults",
    about="One sensor of a quantity is faulty in each run of an hour, its level 60-90 % (strong) or 20-40 % (weak) of its "
    "reading, for 10 to 20 samples (Shaheen 2024, sec. V-B, Fig. 5). Detectors: three published banks and two consistent ones.",
    settings=COMMON,
    seeds=3,
    full_seeds=50,
    tasks=roc_tasks,
    work=trial,
    summarise=roc_summary,
)
