"""pipeline/accommodation: the estimate and the replaced reading while a sensor is faulty (Shaheen 2024, Fig. 7)."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.pipeline.support.rows import bar_series, judged_runs, row
from fusion_sfdia.benchmarks.pipeline.support.trials import COMMON, PAPER, STRENGTHS, Results, tasks, trial
from fusion_sfdia.common.run_statistics import Estimate, share
from fusion_sfdia.models.gas_pipeline.published import FAULTS, QUANTITIES
from fusion_sfdia.report.content import Figure, ResultTable, Summary
from fusion_sfdia.report.plots import bars, legend_above, panels
from fusion_sfdia.report.results import Published, Row
from fusion_sfdia.report.scenario_sentences import left_out, listed, pick, span
from fusion_sfdia.study.estimation_metrics import root_mean_square
from fusion_sfdia.study.experiments.scenario import Scenario, Settings, Task
from fusion_sfdia.study.trials import READINGS

NAME = "pipeline/accommodation"
READING = "reading of the faulty sensor"  # the condition of rows that are not of the state estimate
NAMES = (*PAPER, "loo-glr")
UNITS = dict(zip(QUANTITIES, ("Pa", "kg/s", "K"), strict=True))
LOWER = Published(1.0, "Shaheen 2024, Fig. 7: diagnosis lowers the error of every bank")
ERRORS = dict(zip(READINGS, ("rmse", "rmse_unaccommodated", "rmse_healthy"), strict=True))


def _short(fault: str) -> str:
    return "".join(word[0] for word in fault.split("-")).upper()


def accommodation_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Each fault with and without fault diagnosis, and healthy."""
    return tasks(
        settings,
        (
            {"detector": d, "fault": f, "quantity": q, "accommodate": a}
            for d in NAMES
            for f, q, a in (*product(STRENGTHS, [list(QUANTITIES)], (True, False)), (["none"], ["all"], True))
        ),
        seeds,
    )


def accommodation_summary(settings: Settings, results: Results) -> Summary:
    """RMSE of the estimate of the faulty quantity, and of the faulty sensor's reading, with and without diagnosis."""
    rows: list[Row] = []
    shown: dict[tuple[Any, ...], Estimate] = {}
    cells = judged_runs(results, "detector", "fault", "quantity", "accommodate")
    for (detector, fault, quantity, accommodate), cell in cells.items():
        name = "rmse_healthy" if fault == "none" else "rmse" if accommodate else "rmse_unaccommodated"
        for of in QUANTITIES if quantity == "all" else (quantity,):
            shown[detector, fault, of, accommodate] = estimate = root_mean_square(
                cell["square_error"][..., [QUANTITIES.index(of)]]
            )
            rows.append(row(NAME, detector, fault, of, name, estimate))
        lost = name.replace("rmse", "diverged")
        rows.append(row(NAME, detector, fault, quantity, lost, cell.divergence))
        if name == "rmse":
            rows += [
                row(NAME, detector, fault, quantity, metric, root_mean_square(square), condition=READING)
                for metric, square in zip(ERRORS.values(), np.split(cell["reading_square_error"], 3, axis=-1), strict=True)
            ]

    rows += diagnosis_rows(rows)

    def draw() -> Drawing:
        figure, axes = panels([f"{q}, {u}" for q, u in UNITS.items()], columns=1, width=13.0, height=2.3)
        cases = {f"{_short(f)}\n{'with' if a else 'without'}": (f, a) for f in FAULTS for a in (True, False)}
        for axis, quantity in zip(axes, QUANTITIES, strict=True):
            of = {(d, g): shown.get((d, f, quantity, a)) for d in NAMES for g, (f, a) in cases.items()}
            bars(axis, list(cases), bar_series(of, NAMES, list(cases)), ylabel="RMSE", log=True)
        legend_above(figure)
        return figure

    figure = Figure(
        "accommodation",
        "Error of the estimate with and without diagnosis",
        "SB, WB, SD, WD: strong and weak bias and drift. Logarithmic scale, 95 % intervals over runs; lower is better.",
        draw,
        "Three panels of bars, one a quantity: the root mean square error of four detectors with and without diagnosis",
    )
    return Summary(
        rows=rows,
        figures=[figure],
        tables=[readings_table(rows)],
        highlights=_highlights(rows),
        remarks=[*_remarks(rows), *left_out(rows)],
    )


def diagnosis_rows(rows: list[Row]) -> list[Row]:
    """The share of cases (fault, quantity) in which diagnosis lowers the error of the estimate, of each bank of the paper that
    was run both ways.
    """
    lower = {d: [diagnosed < without for without, diagnosed in _both_ways(pick(rows, detector=d))] for d in PAPER}
    return [row(NAME, d, "all", "all", "lower_error_share", share(of), LOWER) for d, of in lower.items() if of]


def _both_ways(rows: list[Row]) -> list[tuple[float, float]]:
    """The errors of the estimate without and with diagnosis, by detector, fault and quantity."""
    value = {(r.detector, r.fault, r.quantity, r.metric): r.value for r in pick(rows, quantity=QUANTITIES, condition="")}
    pairs = [(v, value.get((*key[:3], "rmse"))) for key, v in value.items() if key[3] == "rmse_unaccommodated"]
    return [(without, diagnosed) for without, diagnosed in pairs if diagnosed is not None]


def readings_table(rows: list[Row]) -> ResultTable:
    """Error of the faulty sensor's reading: as measured, replaced by each detector, and without the fault."""
    lines: list[tuple[str | float, ...]] = []
    for quantity, unit in UNITS.items():
        for fault in FAULTS:
            of = pick(rows, fault=fault, quantity=quantity, condition=READING)
            value = {(r.detector, r.metric): r.value for r in of}
            if value:
                any_of = {r.metric: r.value for r in sorted(of, key=lambda r: r.n)}  # of the detector with the most runs left
                replaced = [value.get((d, "rmse"), float("nan")) for d in NAMES]
                lines.append((f"{quantity}, {unit}", fault, any_of["rmse_unaccommodated"], *replaced, any_of["rmse_healthy"]))
    return ResultTable(
        "Reading of the faulty sensor while it is faulty: root mean square error",
        ("quantity", "fault", "as measured", *NAMES, "without the fault"),
        tuple(lines),
        "A missed fault counts with the reading as measured. A replaced reading may have a smaller error than a healthy one.",
    )


def _highlights(rows: list[Row]) -> list[str]:
    """The remaining error of the reading that replaces the faulty one."""
    of_reading = pick(rows, condition=READING)
    raw = {(r.detector, r.fault, r.quantity): r.value for r in pick(of_reading, metric="rmse_unaccommodated")}
    left = [
        replace(r, value=r.value / raw[r.detector, r.fault, r.quantity])
        for r in pick(of_reading, metric="rmse")
        if raw.get((r.detector, r.fault, r.quantity))
    ]
    return [f"Error of the faulty sensor's reading after accommodation over that before: {listed(left)}."] if left else []


def _remarks(rows: list[Row]) -> list[str]:
    """Sentences on what this run shows."""
    both = _both_ways(rows)
    remarks = ["Fig. 7 is published as bars without numbers; it states that diagnosis lowers the error of every bank."]
    if both:
        lower = sum(diagnosed < without for without, diagnosed in both)
        remarks.append(
            f"Here diagnosis lowers the error of the estimate in {lower} of {len(both)} cases (detector, fault, quantity)."
        )
    worst = pick(rows, quantity="pressure", metric="rmse_unaccommodated", detector=PAPER, condition="")
    if worst:
        most = max(worst, key=lambda r: r.value)
        remarks.append(
            "Without diagnosis the paper finds the largest errors with the extended filter. Of its banks, "
            f"{most.detector} errs most on pressure here: {span([most.value])} Pa with a {most.fault.replace('-', ' ')}."
        )
    ours = {r.quantity: r.value for r in pick(rows, metric="rmse_healthy", detector=NAMES[-1], condition="")}
    times = [
        replace(r, value=r.value / ours[r.quantity])
        for r in pick(rows, metric="rmse_healthy", detector=PAPER, quantity=QUANTITIES, condition="")
        if ours.get(r.quantity)
    ]
    if times:
        remarks.append(
            "As printed, a bank divides its covariance by N^2 each step (P_i = beta P_m) and hardly follows its readings. "
            f"Healthy, its error over that of {NAMES[-1]}, one central filter, is {listed(times)}."
        )
    return remarks


SCENARIO = Scenario(
    name=NAME,
    title="Accommodation: estimate and reading while a sensor is faulty",
    about="Root mean square error of the faulty quantity's states over the whole run, with and without fault diagnosis and "
    "isolation, and of the same runs without a fault (Shaheen 2024, Fig. 7); and of the faulty sensor's reading, replaced.",
    settings=COMMON,
    seeds=2,
    full_seeds=50,
    tasks=accommodation_tasks,
    work=trial,
    summarise=accommodation_summary,
    papers=("shaheen2024",),
)
