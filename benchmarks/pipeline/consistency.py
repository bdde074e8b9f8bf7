"""pipeline/consistency: consistency of the covariances, and an audit of the false-alarm budgets."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.pipeline.support.rows import bar_series, row
from fusion_sfdia.benchmarks.pipeline.support.trials import OURS, PAPER, SETTLE, SINGLE, Results, common, tasks
from fusion_sfdia.common.run_statistics import Estimate, mean_over_runs, rate_over_runs
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.learning.builders import PAPER_FILTERS
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.models.gas_pipeline.published import QUANTITIES
from fusion_sfdia.report.content import Figure, ResultTable, Summary
from fusion_sfdia.report.plots import bars, legend_above, panels
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import listed, pick
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task
from fusion_sfdia.study.trials import decide, faulted

NAME = "pipeline/consistency"
BUDGETS = (1e-1, 1e-2, 1e-3)
PAPER_STEPS = 45  # within which the paper's process noise takes no truth beyond 253 to 343 K; later it takes every one there


def consistency_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Detectors at each budget, with a truth that obeys the filter's model; the paper's banks for their covariance."""
    audited = ({"detector": d, "budget": b} for d in (*OURS, SINGLE) for b in BUDGETS)
    steps = min(int(settings["steps"]), PAPER_STEPS)
    return tasks(settings, (*audited, *({"detector": d, "budget": 0.0, "steps": steps} for d in PAPER)), seeds)


def consistency_work(task: Task) -> Arrays:
    """NEES and NIS per dimension and the number of alarm onsets, by run."""
    plant = gas_pipeline(snr=task["snr"], process_noise=task["process_noise"])
    never = (float("inf"),) * len(plant.sensors)  # the alarms of the paper's banks are not evaluated here
    detector: Any = (
        replace(registry.detector(task["detector"], plant), false_alarm=task["budget"])  # type: ignore[type-var]
        if task["budget"]
        else FusingBank(
            plant, PAPER_FILTERS[task["detector"].removeprefix("fusing-")], thresholds=never, feedback=task["feedback"]
        )
    )
    detector = detector.watching()
    data = faulted(detector.plant, task["steps"], task["seeds"], None, None, process_noise=True)
    decision = decide(detector, data, covariance=True, seed=task["seeds"][0])
    assert data.recording.x is not None and decision.covariance is not None
    scale = detector.plant.sensor_sigma
    error = ((decision.estimate - data.recording.x) / scale)[SETTLE:]
    unit = (decision.covariance / np.outer(scale, scale))[SETTLE:]
    n = error.shape[-1]
    diverged = np.asarray(decision.diverged.any(axis=0))
    sound = np.where(diverged[None, :, None, None], np.eye(n), unit + 1e-12 * np.eye(n))
    groups = {"all": np.arange(n), **detector.plant.quantities}
    nees = np.stack([_nees(error[..., g], sound[..., g[:, None], g]) for g in groups.values()], axis=-1)
    alarm = decision.alarm[SETTLE:]
    begins = alarm & ~np.concatenate([np.zeros_like(alarm[:1]), alarm[:-1]])
    return {"nees": nees.mean(axis=0), "nis": decision.nis[SETTLE:].mean(axis=0), "begins": begins.sum(axis=0),
            "alarms": alarm.sum(axis=0), "samples": np.full(alarm.shape[1], alarm.shape[0]), "diverged": diverged}  # fmt: skip


def _nees(error: Any, covariance: Any) -> Any:
    return np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0], axis=-1) / error.shape[-1]


def consistency_summary(settings: Settings, results: Results) -> Summary:
    """NEES and NIS, and audited budgets."""
    parts: dict[tuple[str, float], list[Arrays]] = {}
    for task, arrays in results:
        parts.setdefault((task["detector"], task["budget"]), []).append(arrays)
    rows: list[Row] = []
    audit: list[tuple[Any, ...]] = []
    covariance: list[tuple[str | float, ...]] = []
    for (detector, budget), found in parts.items():
        joined = {k: np.concatenate([f[k] for f in found]) for k in found[0]}
        ones, sound = np.ones(joined["nis"].size), ~joined["diverged"]
        if budget in (0.0, BUDGETS[-1]):
            if detector != "fusing-enkf":  # 40 members: the covariance of 63 states is singular
                for k, group in enumerate(("all", *QUANTITIES)):
                    nees = mean_over_runs(joined["nees"][sound, k], ones[sound])
                    rows.append(row(NAME, detector, "none", group, "nees", nees))
                    covariance.append((detector, group, nees.value, nees.low, nees.high, nees.n))
            known = np.isfinite(joined["nis"]) & sound
            rows.append(row(NAME, detector, "none", "all", "nis", mean_over_runs(joined["nis"][known], ones[known])))
        if budget:
            rate = rate_over_runs(joined["begins"], joined["samples"])
            at = partial(row, NAME, detector, "none", "all", condition=f"budget {budget:g}")
            rows.append(at("false_alarm_probability", rate))
            rows.append(at("alarm_time_share", rate_over_runs(joined["alarms"], joined["samples"])))
            audit.append(
                (
                    detector,
                    f"{budget:g}",
                    rate.value,
                    rate.low,
                    rate.high,
                    "no" if rate.low > budget else "yes" if rate.high <= budget else "undecided",
                )
            )
    tables = [
        ResultTable(
            "Normalised estimation error squared per state (1 is consistent)",
            ("detector", "states", "NEES", "low", "high", "runs"),
            tuple(covariance),
        ),
        ResultTable(
            "Audit of the false-alarm budget: alarm onsets per step over all 63 sensors",
            ("detector", "claimed", "measured", "low", "high", "kept"),
            tuple(audit),
        ),
    ]  # fmt: skip
    figure = Figure(
        "audit",
        "Claimed and measured false alarms",
        "Alarm onsets per step over all sensors, for a truth that obeys the model, with 95 % intervals. At or below the "
        "dashed line the claim is kept.",
        lambda: draw_audit(audit),
        "Bars of the measured false-alarm rate by detector, with three claimed budgets as dashed lines",
    )
    remarks = [
        "The truth is disturbed by the process noise that the filters assume; without it their covariances could not be "
        "consistent.",
        f"The paper's banks are judged in the first {PAPER_STEPS} samples: in an hour their process noise takes every truth "
        "beyond the temperatures of the gas equations, 253 to 343 K.",
        "With a window an alarm lasts as long as its samples are in the window, so the budget counts alarm onsets.",
        "In the paper's banks P_m is already a covariance divided by N, and beta divides it again. Squared errors over "
        f"each covariance, all states: {listed(pick(rows, metric='nees', quantity='all'))}.",
        f"Claims that are kept: {sum(a[-1] == 'yes' for a in audit)} of {len(audit)}; not kept: "
        f"{sum(a[-1] == 'no' for a in audit)}; the others are undecided by this number of runs.",
    ]
    return Summary(rows=rows, tables=tables, figures=[figure], remarks=remarks)


def draw_audit(audit: list[tuple[Any, ...]]) -> Drawing:
    """Measured rates by claim and detector, the claim as a dashed line."""
    figure, (axis,) = panels(["alarm onsets per step over all sensors"], columns=1, width=13.0, height=3.2)
    groups = [f"claimed {b:g}" for b in BUDGETS]
    of = {(a[0], f"claimed {a[1]}"): Estimate(a[2], a[3], a[4], 0) for a in audit}
    bars(axis, groups, bar_series(of, list(dict.fromkeys(a[0] for a in audit)), groups), ylabel="measured", log=True)
    for i, budget in enumerate(BUDGETS):
        axis.plot([i - 0.45, i + 0.45], [budget, budget], "--", color="black", linewidth=1, label="claimed")
    legend_above(figure)
    return figure


SCENARIO = Scenario(
    name=NAME,
    title="Consistency: covariances and false-alarm budgets",
    about="Is the claimed uncertainty correct? Normalised errors for a truth with process noise, and the false-alarm rate at "
    "each budget, for the consistent banks, a single filter, and the covariances of the published banks.",
    settings=common("truth"),
    seeds=3,
    full_seeds=50,
    tasks=consistency_tasks,
    work=consistency_work,
    summarise=consistency_summary,
)
