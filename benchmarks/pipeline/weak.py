"""pipeline/weak: faults near the noise, slow drifts, and three sensors at once."""

from __future__ import annotations

from functools import partial

from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.pipeline.support.rows import bar_series, detection_rows, judged_runs, row
from fusion_sfdia.benchmarks.pipeline.support.trials import COMMON, OURS, PAPER, Results, grid, tasks, trial
from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.models.gas_pipeline.published import QUANTITIES
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.plots import bars, legend_above, panels
from fusion_sfdia.report.scenario_sentences import left_out, listed, pick
from fusion_sfdia.study.experiments.scenario import Scenario, Settings, Task
from fusion_sfdia.study.isolation_metrics import exact_isolation, false_flag_rate, isolation_recall

WEAK_FAULTS = ("bias-3-sigma", "bias-5-sigma", "drift-3-sigma")


def weak_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Single faults near the noise, without accommodation; three at once, with accommodation."""
    names = (PAPER[0], *OURS)
    one = grid(detector=names, fault=[list(WEAK_FAULTS)], quantity=[list(QUANTITIES)], accommodate=(False,))
    three = grid(detector=names, fault=[["three-8-sigma"]], quantity=[["all"]], accommodate=(True,))
    return tasks(settings, (*one, *three), seeds)


def weak_summary(settings: Settings, results: Results) -> Summary:
    """Areas near the noise, and exact isolation when three sensors fail at once."""
    single = judged_runs([r for r in results if r[0]["fault"] != ["three-8-sigma"]], "detector", "fault", "quantity")
    three = judged_runs([r for r in results if r[0]["fault"] == ["three-8-sigma"]], "detector")
    rows = detection_rows("pipeline/weak", single)
    for (detector,), cell in three.items():
        at = partial(row, "pipeline/weak", detector, "three-8-sigma", "all")
        rows += [
            at("diverged", cell.divergence),
            at("exact_isolation", exact_isolation(cell.isolated, cell.active)),
            at("isolation_recall", isolation_recall(cell.isolated, cell.active)),
            at("false_flag_rate", false_flag_rate(cell.isolated, cell.active)),
        ]

    shown = {(r.detector, f"{r.fault}\n{r.quantity}"): Estimate(r.value, r.low, r.high, r.n) for r in rows if r.metric == "auc"}

    def draw() -> Drawing:
        figure, (axis,) = panels(["area under the ROC"], columns=1, width=13.0, height=3.6)
        groups = [f"{f}\n{q}" for f in WEAK_FAULTS for q in QUANTITIES]
        bars(axis, groups, bar_series(shown, ("fusing-ekf", *OURS), groups), ylabel="area under the ROC")
        axis.set_ylim(0, 1.05)
        axis.axhline(0.5, color="0.3", linestyle="--", linewidth=1, label="chance")
        axis.tick_params(axis="x", labelsize=8)
        legend_above(figure)
        return figure

    figure = Figure(
        "weak-auc",
        "Faults near the noise: area under the ROC",
        "fusing-ekf: the state variance (19); loo-chi2: one sample; loo-glr: a window of 15. 95 % intervals over runs.",
        draw,
        "Bars of the area under the ROC for three detectors, three faults of 3 or 5 sigma and three quantities",
    )
    remarks = [
        "A filter with large gain absorbs a small bias after its first samples, and tests of one sample no longer detect "
        "it. A window keeps the first samples, and the fusing bank hardly follows its readings. "
        + " ".join(f"Areas, {f.replace('-', ' ')}: {listed(pick(rows, metric='auc', fault=f))}." for f in WEAK_FAULTS),
        "Three sensors that fail at once: the leave-one-out banks exclude one after the other, the paper's rule isolates "
        f"one. Exact isolation: {listed(pick(rows, metric='exact_isolation'))} of the faulty samples.",
    ]
    return Summary(rows=rows, figures=[figure], remarks=[*remarks, *left_out(rows)])


SCENARIO = Scenario(
    name="pipeline/weak",
    title="Faults near the noise, slow drifts, three at once",
    about="Biases of 3 and 5 standard deviations of the reading and drifts to 3, for 10 to 20 samples, and three simultaneous "
    "biases of 8: faults smaller than the published ones. Readings come from a grid four times finer than the filter's.",
    settings={**COMMON, "truth": "finer"},
    seeds=3,
    full_seeds=50,
    tasks=weak_tasks,
    work=trial,
    summarise=weak_summary,
)
