"""pipeline/accommodation: the error of the estimate while a sensor is faulty (Shaheen 2024, Fig. 7)."""

from __future__ import annotations

from itertools import product
from typing import Any

from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.pipeline_published import FAULTS, QUANTITIES
from fusion_sfdia.benchmarks.pipeline_trials import (
    COMMON,
    PAPER,
    Results,
    bar_series,
    gather,
    row,
    run_rmse,
    tasks,
    trial,
)
from fusion_sfdia.benchmarks.plots import bars, panels
from fusion_sfdia.benchmarks.scenario import Figure, Row, Scenario, Settings, Summary, Task
from fusion_sfdia.metrics import Estimate

NAMES = (*PAPER, "loo-glr")
UNITS = ("Pa", "kg/s", "K")


def _short(fault: str) -> str:
    return "".join(word[0] for word in fault.split("-")).upper()


def accommodation_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Each fault with and without fault diagnosis, and healthy."""
    return tasks(
        settings,
        (
            {"detector": d, "fault": f, "quantity": q, "accommodate": a}
            for d in NAMES
            for f, q, a in (*product(FAULTS, QUANTITIES, (True, False)), ("none", "all", True))
        ),
        seeds,
    )


def accommodation_summary(settings: Settings, results: Results) -> Summary:
    """RMSE of the estimate of the faulty quantity with and without diagnosis."""
    rows: list[Row] = []
    shown: dict[tuple[Any, ...], Estimate] = {}
    cells = gather(results, "detector", "fault", "quantity", "accommodate")
    for (detector, fault, quantity, accommodate), cell in cells.items():
        name = "rmse_healthy" if fault == "none" else "rmse" if accommodate else "rmse_unaccommodated"
        for of in QUANTITIES if quantity == "all" else (quantity,):
            shown[detector, fault, of, accommodate] = estimate = run_rmse(cell, QUANTITIES.index(of))
            rows.append(row("pipeline/accommodation", detector, fault, of, name, estimate))
        lost = name.replace("rmse", "diverged")
        rows.append(row("pipeline/accommodation", detector, fault, quantity, lost, cell.divergence))

    def draw() -> Drawing:
        figure, axes = panels([f"{q}, {u}" for q, u in zip(QUANTITIES, UNITS, strict=True)], columns=3, width=14.0, height=3.6)
        cases = {f"{_short(f)}\n{'with' if a else 'without'}": (f, a) for f in FAULTS for a in (True, False)}
        for axis, quantity in zip(axes, QUANTITIES, strict=True):
            of = {(d, g): shown.get((d, f, quantity, a)) for d in NAMES for g, (f, a) in cases.items()}
            bars(axis, list(cases), bar_series(of, NAMES, list(cases)), ylabel="RMSE", log=True)
            axis.tick_params(axis="x", labelsize=7)
        return figure

    figure = Figure(
        "accommodation",
        "Error of the estimate with and without diagnosis",
        "SB, WB, SD, WD: strong and weak bias and drift. Logarithmic scale; lower is better. The paper's Fig. 7 has bars only.",
        draw,
        "Three panels of bars, one a quantity: the root mean square error of four detectors with and without diagnosis",
    )
    remarks = [
        "Fig. 7 is published as bars without numbers. That diagnosis lowers the error, and that the extended "
        "filter without it is "
        "worst on pressure, is found again.",
        "As printed, the bank all but forgets its readings (P_i = beta P_m divides the covariance by N^2 each step): its error "
        "when healthy is several times that of one central filter.",
    ]
    return Summary(rows=rows, figures=[figure], remarks=remarks)


SCENARIO = Scenario(
    name="pipeline/accommodation",
    title="Accommodation: the estimate while a sensor is faulty",
    about="Root mean square error of the faulty quantity's states over the whole run, with and without fault diagnosis and "
    "isolation, and of the same runs without a fault (Shaheen 2024, Fig. 7).",
    settings=COMMON,
    seeds=2,
    full_seeds=50,
    tasks=accommodation_tasks,
    work=trial,
    summarise=accommodation_summary,
)
