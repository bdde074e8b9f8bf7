"""pipeline/units: effect of the states' units on the residual (20) of Shaheen 2024."""

from __future__ import annotations

from functools import cache, partial
from textwrap import fill
from typing import Any

from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.pipeline.support.rows import bar_series, judged_runs, row
from fusion_sfdia.benchmarks.pipeline.support.trials import COMMON, Results, grid, tasks, trial
from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.filters.estimators import Estimator, Extended, Unscented
from fusion_sfdia.learning.builders import PAPER_UNITS
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.models.gas_pipeline.published import QUANTITIES
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.plots import bars, legend_above, panels
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import left_out, span
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task
from fusion_sfdia.study.isolation_metrics import isolation_recall

VARIANTS: dict[str, tuple[str, Estimator, str]] = {  # detector, its filter, and what divides the states in (20)
    "EKF, paper's units": ("fusing-ekf", Extended(), "paper"),
    "UKF printed, paper's units": ("fusing-ukf", Unscented(redraw=False), "paper"),
    "UKF redrawn, paper's units": ("fusing-ukf", Unscented(), "paper"),
    "EKF, sigma units": ("fusing-ekf", Extended(), "sigma"),
    "UKF redrawn, sigma units": ("fusing-ukf", Unscented(), "sigma"),
}
BESIDE = "loo-chi2"


@cache
def _variant(name: str, snr: str, process_noise: str, feedback: str) -> FusingBank:
    plant = gas_pipeline(snr=snr, process_noise=process_noise, initial="identity")
    _, estimator, units = VARIANTS[name]
    paper = tuple(PAPER_UNITS.get(s.unit, 1.0) for s in plant.states)
    always = tuple((1e-12 * plant.sensor_sigma).tolist())  # the question is which sensor, not whether
    scale = paper if units == "paper" else tuple(plant.sensor_sigma.tolist())
    return FusingBank(plant, estimator, thresholds=always, residual_scale=scale, accommodate=False, feedback=feedback)


def units_tasks(settings: Settings, seeds: int) -> list[Task]:
    """A bias of 30 % through each variant, and through the leave-one-out chi-square."""
    cells = grid(detector=(*VARIANTS, BESIDE), fault=[["bias-30-percent"]], quantity=[list(QUANTITIES)], accommodate=(True,))
    return tasks(settings, cells, seeds)


def units_work(task: Task) -> Arrays:
    """A trial with the variant named in the task."""
    if task["detector"] not in VARIANTS:
        return trial(task)
    return trial(task, _variant(task["detector"], task["snr"], task["process_noise"], task["feedback"]))


def units_summary(settings: Settings, results: Results) -> Summary:
    """Share of faulty samples at which the largest residual is that of the faulty sensor."""
    rows: list[Row] = []
    shown: dict[tuple[Any, ...], Estimate] = {}
    for (name, quantity), cell in judged_runs(results, "detector", "quantity").items():
        estimate = isolation_recall(cell.isolated, cell.active)
        detector, condition = (VARIANTS[name][0], name) if name in VARIANTS else (name, "")
        at = partial(row, "pipeline/units", detector, "bias-30-percent", quantity, condition=condition)
        rows += [at("isolation_recall", estimate), at("diverged", cell.divergence)]
        shown[quantity, name] = estimate

    def draw() -> Drawing:
        figure, (axis,) = panels(["is the largest residual (20) that of the faulty sensor?"], columns=1, width=13.0, height=3.2)
        names = [d for d in (*VARIANTS, BESIDE) if (QUANTITIES[0], d) in shown]
        bars(axis, names, bar_series(shown, QUANTITIES, names), ylabel="faulty sensor isolated")
        axis.set_xticks(range(len(names)), [fill(n, 16) for n in names])
        axis.set_ylim(0, 1.05)
        legend_above(figure)
        return figure

    figure = Figure(
        "units",
        "The residual (20) in two units",
        "Share of faulty samples at which the faulty sensor has the largest residual, with states in MPa, kg/s and K, and "
        "divided by each sensor's sigma. 95 % intervals over runs.",
        draw,
        "Bars: share of faulty samples at which the faulty sensor has the largest residual, by variant of the "
        "bank and quantity",
    )
    remarks = [
        "(20) is a length in a space whose axes are MPa, kg/s and K: a pressure error of 2.5 MPa counts as much as a flow "
        "error of 2.5 kg/s, which is one standard deviation of the flow's noise at moderate SNR. It shows where the filter "
        "spreads it to the flow, or, in a filter with small process noise, where states are divided by their sensors' sigma.",
        *(f"Faulty samples at which the {q} sensor is isolated: {_isolated(shown, q)}." for q in QUANTITIES),
    ]
    return Summary(rows=rows, figures=[figure], remarks=[*remarks, *left_out(rows)])


def _isolated(shown: dict[tuple[Any, ...], Estimate], quantity: str) -> str:
    return "; ".join(f"{name} {span([e.value])}" for (of, name), e in shown.items() if of == quantity)


SCENARIO = Scenario(
    name="pipeline/units",
    title="Effect of units on the published residual",
    about="A bias of 30 % of the reading, with detection assumed: is the largest residual (20) that of the faulty sensor? "
    "With states in the paper's units, and in units of the sensors' noise, for the extended filter and the unscented one "
    "with and without redrawn sigma points.",
    settings=COMMON,
    seeds=2,
    full_seeds=30,
    tasks=units_tasks,
    work=units_work,
    summarise=units_summary,
)
