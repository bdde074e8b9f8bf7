"""pipeline/mismatch: readings from a model that differs from the filter's."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.pipeline.support.rows import bar_series, judged_runs, row
from fusion_sfdia.benchmarks.pipeline.support.trials import OURS, Results, common, grid, tasks, trial
from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.models.gas_pipeline.physics import pipeline_parameters
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.models.gas_pipeline.published import QUANTITIES
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.plots import bars, legend_above, panels
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import left_out, listed, pick
from fusion_sfdia.study import detection_metrics as metrics
from fusion_sfdia.study.estimation_metrics import root_mean_square
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task
from fusion_sfdia.study.isolation_metrics import false_flag_rate, isolation_recall

TRUTHS = ("the filter's model", "finer grid", "roughness +25 %", "ambient +1 K", "heat transfer +10 %", "all of these")
NAMES = ("fusing-enkf", *OURS)


@cache
def truth_plant(name: str, snr: str, process_noise: str) -> Plant:
    """The plant that generates the readings: 81 nodes, or changed parameters, as by ageing or weather; sizes are our choice."""
    nominal = pipeline_parameters()
    single = {
        "roughness +25 %": {"roughness": 1.25 * nominal.roughness},
        "ambient +1 K": {"ambient": nominal.ambient + 1.0},
        "heat transfer +10 %": {"heat_transfer": 1.1 * nominal.heat_transfer},
    }
    everything = {k: v for change in single.values() for k, v in change.items()}
    changes = everything if name == "all of these" else single.get(name, {})
    nodes = 81 if name in ("finer grid", "all of these") else 21
    return gas_pipeline(
        nodes=nodes, stations=21, snr=snr, process_noise=process_noise, parameters=pipeline_parameters(**changes)
    )


def mismatch_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Each truth, healthy and with a weak bias on any sensor."""
    faults = ["none", "weak-bias", "bias-5-sigma"]
    return tasks(settings, grid(truth=TRUTHS, detector=NAMES, fault=[faults], quantity=[["all"]], accommodate=(True,)), seeds)


def mismatch_work(task: Task) -> Arrays:
    """A trial whose readings come from the truth of the task."""
    return trial(task, truth=truth_plant(task["truth"], task["snr"], task["process_noise"]))


def mismatch_summary(settings: Settings, results: Results) -> Summary:
    """False alarms and recall by truth."""
    rows: list[Row] = []
    shown: dict[tuple[Any, ...], Estimate] = {}
    for (truth, detector, fault), cell in judged_runs(results, "truth", "detector", "fault").items():
        of = partial(row, "pipeline/mismatch", detector, fault, condition=truth)
        at = partial(of, "all")
        rows.append(at("diverged", cell.divergence))
        if fault == "none":
            rate = metrics.false_alarm_probability(cell["alarm"], cell.active)
            rows += [at("false_alarm_probability", rate), at("false_flag_rate", false_flag_rate(cell.isolated, cell.active))]
            shown[detector, truth] = rate
            errors = [root_mean_square(cell["square_error"][..., [i]]) for i in range(len(QUANTITIES))]
            rows += [of(quantity, "rmse", error) for quantity, error in zip(QUANTITIES, errors, strict=True)]
        else:
            rows.append(at("isolation_recall", isolation_recall(cell.isolated, cell.active)))

    def draw() -> Drawing:
        figure, (axis,) = panels(["healthy sensors, model mismatch"], columns=1, width=13.0, height=3.2)
        bars(axis, TRUTHS, bar_series(shown, NAMES, TRUTHS), ylabel="samples with a false alarm")
        axis.set_ylim(0, 1.05)
        legend_above(figure)
        return figure

    figure = Figure(
        "mismatch",
        "False alarms under model mismatch",
        "Share of healthy samples with an alarm, by the truth model. 95 % intervals over runs.",
        draw,
        "Bars of the false-alarm probability of three detectors for six truths",
    )
    remarks = [
        "The budget of false alarms holds for a correct model. A detector that assumes an exact model takes model errors for "
        "faults, and may exclude up to a quarter of the sensors. Samples with a false alarm: "
        + " ".join(f"{t}: {listed(pick(rows, metric='false_alarm_probability', condition=t))}." for t in TRUTHS),
        "Fewer alarms may be due to fewer detections. Faulty samples with the sensor isolated, over all truths: "
        + " ".join(f"{f}: {listed(pick(rows, metric='isolation_recall', fault=f))}." for f in ("weak-bias", "bias-5-sigma")),
        "Where the model is uncertain, give the filter a process noise that covers it, or estimate the parameter as a state.",
    ]
    return Summary(rows=rows, figures=[figure], remarks=[*remarks, *left_out(rows)])


SCENARIO = Scenario(
    name="pipeline/mismatch",
    title="Model mismatch: false alarms and isolation",
    about="Readings from a finer grid (81 nodes), a rougher pipe, warmer or more conductive ground than in the filter's model: "
    "false alarms without a fault, and isolation with one.",
    settings=common("truth"),
    seeds=2,
    full_seeds=50,
    tasks=mismatch_tasks,
    work=mismatch_work,
    summarise=mismatch_summary,
)
