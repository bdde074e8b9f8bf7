"""chemical/monitored: sensor faults in a recording of the Tennessee Eastman process, with what healthy readings alone teach."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.chemical.support.monitoring import (
    BEFORE,
    LENGTHS,
    METHODS,
    cases,
    monitored,
)
from fusion_sfdia.benchmarks.chemical.support.recordings import MEASUREMENTS
from fusion_sfdia.benchmarks.chemical.support.tasks import SIGMAS, once, require_measurements, task_for_each
from fusion_sfdia.common.run_statistics import rate_over_runs
from fusion_sfdia.report.content import Figure, ResultTable, Summary
from fusion_sfdia.report.plots import Bars, bars, legend_above, panels
from fusion_sfdia.report.results import Row, row_of
from fusion_sfdia.report.scenario_sentences import listed, pick
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task
from fusion_sfdia.study.isolation_metrics import exact_isolation

Array = NDArray[Any]
Results = list[tuple[Task, Arrays]]

NAME = "chemical/monitored"
row = partial(row_of, "tennessee-eastman", NAME)


def monitored_tasks(settings: Settings, seeds: int) -> list[Task]:
    """One task a method: there is one recording, and nothing is random."""
    require_measurements(settings)
    return task_for_each(settings, METHODS)


def method_rows(task: Task, arrays: Arrays) -> list[Row]:
    """False alarms as counted in d00 and in d00_te, and exact isolation of biases and drifts where sizes suffice."""
    by, alarm, isolable = task["detector"], arrays["healthy alarm"], arrays["isolable"]
    found = [
        row(by, "none", "all", "alarm_probability", once(arrays["held-out"][0], 1), condition="d00, held out"),
        row(by, "none", "all", "alarm_probability", once(alarm.mean(), alarm.size), condition="d00_te"),
    ]
    size = f"{task['size']:g}-sigma"
    for kind in LENGTHS:
        isolated, active = arrays[f"{kind} isolated"], arrays[f"{kind} active"]
        end = arrays[f"{kind} end"]
        runs = cases(task)
        for s, sigma in enumerate(SIGMAS):
            of = partial(row, by, f"{kind}-{size}", condition=f"sigma of the {sigma}")
            for what in (*task["measurements"], "all"):
                which = np.array([
                    case.sigma == sigma and (isolable[s, case.position] if what == "all" else case.position == what - 1)
                    for case in runs
                ])  # fmt: skip
                name = what if what == "all" else MEASUREMENTS[what - 1][0]
                if which.any():
                    if kind == "bias":
                        yielded = exact_isolation(isolated[:, which], active[:, which])
                        found.append(of(name, "exact_isolation", yielded))
                    else:
                        named = end[which].astype(int)
                        found.append(of(name, "drift_isolation_probability", rate_over_runs(named, np.ones_like(named))))
    return found


def monitored_summary(settings: Settings, results: Results) -> Summary:
    """Rows of each method, a figure of them, and a table of what identifiability says."""
    rows = [r for task, arrays in results for r in method_rows(task, arrays)]
    names = [task["detector"] for task, _ in results]
    size = f"{settings['size']:g}-sigma"
    remarks = [
        f"Model: {results[0][1]['model'][0]}." if results else "",
        f"Stated rate of false alarms: {settings['false_alarm']:g} of the samples. Held out of d00: "
        f"{listed(pick(rows, metric='alarm_probability', condition='d00, held out'))}. "
        f"d00_te: {listed(pick(rows, metric='alarm_probability', condition='d00_te'))}.",
    ]
    for sigma in SIGMAS:
        at = {"quantity": "all", "condition": f"sigma of the {sigma}"}
        biases = pick(rows, metric="exact_isolation", fault=f"bias-{size}", **at)
        drifts = pick(rows, metric="drift_isolation_probability", fault=f"drift-{size}", **at)
        if biases and drifts:
            remarks.append(f"Sigma of the {sigma}: biases, exact isolation {listed(biases)}; drifts isolated {listed(drifts)}.")
    remarks.append(
        "The plant runs in closed loop: the controllers do not react to the faults, which are put into the recording. All "
        f"methods learn from d00 alone; each run of a fault begins {BEFORE} samples before it."
    )
    return Summary(
        rows=rows, figures=[isolation_figure(rows, names, size)], tables=[smallest_bias_table(settings, results)],
        remarks=[r for r in remarks if r],
    )  # fmt: skip


def isolation_figure(rows: list[Row], names: list[str], size: str) -> Figure:
    """Exact isolation of biases and drifts by method, for both meanings of sigma."""
    metrics = {"bias": "exact_isolation", "drift": "drift_isolation_probability"}

    def draw() -> Drawing:
        figure, axes = panels([f"{kind}es" if kind == "bias" else f"{kind}s" for kind in metrics], width=11.0, height=3.2)
        for axis, (kind, metric) in zip(axes, metrics.items(), strict=True):
            series = []
            for name in names:
                cells = [pick(rows, detector=name, metric=metric, fault=f"{kind}-{size}", quantity="all",
                              condition=f"sigma of the {sigma}") for sigma in SIGMAS]  # fmt: skip
                values, low, high = ([getattr(c[0], what) if c else np.nan for c in cells] for what in ("value", "low", "high"))
                series.append(Bars(name, values, low, high, [np.nan] * len(SIGMAS)))
            bars(axis, [f"sigma of the {s}" for s in SIGMAS], series, ylabel="exact isolation")
            axis.set_ylim(0, 1.05)
        legend_above(figure)
        return figure

    return Figure(
        "isolation",
        "Faults put into the healthy recording: exact isolation",
        "Biases: share of faulty samples in which exactly the faulty measurement is isolated. Drifts: share of runs in "
        "which that is so in most of their last 20 samples. 95 % intervals over runs.",
        draw,
        "Bars of exact isolation by method, for biases and drifts and both meanings of sigma",
    )


def smallest_bias_table(settings: Settings, results: Results) -> ResultTable:
    """The smallest bias that can be isolated, by measurement."""
    lines = []
    for task, arrays in results[:1]:
        for number in task["measurements"]:
            sizes = arrays["isolable size"][:, number - 1]
            lines.append((MEASUREMENTS[number - 1][0], *(float(v) for v in sizes)))
    return ResultTable(
        "The smallest bias that can be isolated", ("measurement", *(f"sigma of the {s}" for s in SIGMAS)), tuple(lines),
        f"By identifiability of the identified model, in sigma; {settings['size']:g} sigma are judged where it is less. "
        "It takes every measurement as read in every sample, which the analyses (in feed, in product) are not.",
    )  # fmt: skip


SCENARIO = Scenario(
    name=NAME,
    title="A recorded chemical plant: monitoring without a model",
    about="The Tennessee Eastman process in closed loop. Everything is learnt from one healthy recording, thresholds by "
    "cross-validation inside it; another healthy recording judges, with biases and drifts in ten measurements. The files are "
    "not part of the project: --set data=FOLDER.",
    settings={
        "data": "",
        "measurements": (2, 4, 7, 8, 9, 12, 18, 20, 23, 38),
        "size": 10.0,
        "false_alarm": 0.01,
        "kind": "",
        "order": 1,
    },
    seeds=1,
    full_seeds=1,
    tasks=monitored_tasks,
    work=monitored,
    summarise=monitored_summary,
    bounds={"false_alarm": (1e-3, 0.5)},
)
