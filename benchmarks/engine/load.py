"""engine/load: a load step from 100 to 80 %, healthy and with each of the ten sensors faulty."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.engine.support import campaign
from fusion_sfdia.benchmarks.engine.support.campaign_figures import drive_figure, run_figure, share_matrix
from fusion_sfdia.benchmarks.engine.support.trials import NAMES, row
from fusion_sfdia.common.run_statistics import Estimate, mean_over_runs, share
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.models.marine_engine.plant import SENSORS
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.plots import panels
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import pick, span
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task, seed_blocks

Array = NDArray[Any]

CHUNK = 50  # runs in one task
CASES = ("none", *SENSORS)
SHOWN = "S(2){3}"  # the first of K24's faults, in the figures of single runs
ALLOWED = {  # the operation that the detector's envelope and drifts cover
    "steady": "full load, as the registered detector",
    "moving": "all load changes",
}

METRICS = (
    "missed_detection_rate",
    "missed_detection_rate_other_agents",
    "isolated_at_end",
    "exact_isolation_at_end",
    "isolated_sensors_at_end",
)


def load_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Each kind of load change with each detector; the faults of all sensors with the same noise."""
    campaign.require_settings(settings)
    for name, known in (("drives", campaign.DRIVES), ("allowed", ALLOWED)):
        if unknown := [d for d in settings[name] if d not in known]:
            raise ValueError(f"setting {name} has {', '.join(unknown)}; known: {', '.join(known)}")
    if not 0 < settings["change"] <= settings["onset"]:
        raise ValueError(
            f"the load changes at {settings['change']:g} s, the fault begins at {settings['onset']:g} s; expected this order"
        )
    common = {k: settings[k] for k in ("detector", "noise", "size", "change", "onset", "duration")}
    return [
        common | {"drive": drive, "allowed": allowed, "seeds": block}
        for drive in settings["drives"]
        for allowed in settings["allowed"]
        for block in seed_blocks(seeds, CHUNK)
    ]


def load_detector(task: Task) -> AdaptiveThreshold:
    """The detector of a task."""
    if task["allowed"] == "steady":
        return campaign.steady_detector(task["detector"], task["noise"])
    return campaign.moving_detector(task["detector"], task["noise"], task["duration"], task["change"])


def load_work(task: Task) -> Arrays:
    """First firings (11, B, N) of the healthy runs and with each sensor faulty; until the onset the runs are the same.

    thresholds (B, N): their mean over the noise bound in the healthy runs from the onset on. diverged (11, B). signal
    (K, N) without noise and u (K, 1), every tenth sample. trace: of the first run with the sensor SHOWN faulty.
    """
    detector = load_detector(task)
    t, u, signal = campaign.truth(task["duration"], task["drive"], task["change"])
    onset = int(np.searchsorted(t, task["onset"] - detector.plant.dt / 2))
    biases = np.zeros((len(CASES), 1, len(SENSORS)))
    biases[1:, 0] = np.diag(campaign.sizes(campaign.steady_detector(task["detector"], task["noise"]), task["size"]))
    draws = campaign.noise(detector.plant, t.size, task["seeds"])
    state, before = campaign.first_firings(
        detector, t[:onset], u[:onset], (signal[k] + next(draws) for k in range(onset)), shown=(0,)
    )
    after = (signal[k] + next(draws) + biases for k in range(onset, t.size))
    shown = CASES.index(SHOWN), 0
    _, found = campaign.first_firings(detector, t[onset:], u[onset:], after, campaign.fork(state, len(CASES)), shown)
    first = np.minimum(before["first"], found["first"])
    thresholds = found["threshold"][0] / np.array([s.noise_bound for s in detector.plant.sensors])
    return {
        "first": first,
        "thresholds": thresholds,
        "diverged": found["diverged"],
        "size": biases[:, 0],
        "signal": signal[::10],
        "u": u[::10],
        "trace": np.concatenate([before["trace"], found["trace"]], axis=1),
    }


def condition(drive: str, allowed: str) -> str:
    """The condition of a row: the kind of load change, and the operation that the detector covers."""
    return f"{drive}, detector {allowed}"


def load_summary(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """False alarms, detection and isolation by drive, detector and faulty sensor."""
    cells: dict[tuple[str, str], list[Arrays]] = {}
    for task, arrays in results:
        cells.setdefault((task["drive"], task["allowed"]), []).append(arrays)
    rows: list[Row] = []
    firsts: dict[tuple[str, str], Array] = {}
    for (drive, allowed), parts in cells.items():
        first = firsts[drive, allowed] = np.concatenate([p["first"] for p in parts], axis=1)
        diverged = np.concatenate([p["diverged"] for p in parts], axis=1)
        thresholds = np.concatenate([p["thresholds"] for p in parts])
        for name, values in zip(NAMES, thresholds.T, strict=True):
            mean = mean_over_runs(values, np.ones(values.size))
            one = partial(row, "engine/load", settings["detector"], "none", name, condition=condition(drive, allowed))
            rows.append(one("threshold_noise_bounds", mean))
        for i, case in enumerate(CASES):
            at = partial(row, "engine/load", settings["detector"], case, "all", condition=condition(drive, allowed))
            rows += [at("diverged", share(diverged[i])), *campaign.diagnosis_rows(at, first[i], None if i == 0 else i - 1)]
            if i:
                size = 100 * parts[0]["size"][i, i - 1] / parts[0]["signal"][0, i - 1]
                others = [j for j, n in enumerate(NAMES) if n[:3] != NAMES[i - 1][:3]]
                own, propagated = (campaign.response(first[i], settings["onset"], group) for group in ([i - 1], others))
                rows += [
                    at("fault_percent", Estimate(float(size), math.nan, math.nan, first.shape[1])),
                    at("missed_detection_rate", own.missed),
                    at("detection_delay", own.delay),
                    at("missed_detection_rate_other_agents", propagated.missed),
                ]
    drives = {task["drive"]: arrays for task, arrays in results}
    figures = [drive_figure(drives, settings["onset"]), *(_matrix_figure(a, firsts) for a in settings["allowed"])]
    moved = [cell for cell in cells if cell[0] != "constant" and cell[1] == settings["allowed"][-1]]
    figures += [_run_figure(settings, *cell, cells[cell][0]) for cell in moved]
    return Summary(rows, figures, highlights=[_silence(settings, rows)], remarks=_remarks(settings, rows))


def _matrix_figure(allowed: str, firsts: dict[tuple[str, str], Array]) -> Figure:
    chosen = {drive: np.isfinite(first) for (drive, of), first in firsts.items() if of == allowed}

    def draw() -> Drawing:
        figure, axes = panels([f"{drive}: {what}" for drive in chosen for what in ("fired", "isolated")], width=8.5)
        for k, fired in enumerate(chosen.values()):
            share_matrix(axes[2 * k], fired.mean(axis=1), CASES, NAMES, ylabel="faulty sensor")
            share_matrix(axes[2 * k + 1], campaign.logic().isolated(fired).mean(axis=1), CASES, tuple(SENSORS))
        return figure

    return Figure(
        f"modules-{allowed}",
        f"Modules that fire and isolated sensors, detector for {ALLOWED[allowed]}",
        "Share of runs in which a module has fired (left) and a sensor is in the diagnosis set S^F (right) at the end. Dark: "
        "all runs.",
        draw,
        "Matrices of faulty sensor against modules that fired and against isolated sensors, for each load change",
    )


def _run_figure(settings: Settings, drive: str, allowed: str, arrays: Arrays) -> Figure:
    return run_figure(
        f"run-{drive}-{allowed}",
        f"{campaign.DRIVES[drive]}, then a fault of {SHOWN}: detector for {ALLOWED[allowed]}",
        arrays["trace"],
        arrays["first"][CASES.index(SHOWN), 0],
        settings,
        (("load change", settings["change"]), (SHOWN, settings["onset"])),
        "the load changes, the fault begins (thick: in this module's sensor)",
    )


def _silence(settings: Settings, rows: list[Row]) -> str:
    moved = [condition(d, a) for d in settings["drives"] if d != "constant" for a in settings["allowed"]]
    found = [f"{r.condition} {r.value:.0%}" for r in pick(rows, fault="none", metric="alarm_at_end", condition=moved)]
    return f"Healthy runs with an alarm during a load change: {'; '.join(found)}."


def _remarks(settings: Settings, rows: list[Row]) -> list[str]:
    remarks = []
    for r in pick(rows, fault="none", metric="alarm_at_end"):
        found = {m: pick(rows, condition=r.condition, metric=m) for m in METRICS}
        percent = {m: span(100 * x.value for x in values) for m, values in found.items()}
        remarks.append(
            f"{r.condition}: healthy runs with an alarm {r.value:.0%}; with a faulty sensor, missed by its own module "
            f"{percent['missed_detection_rate']} % and by all other agents {percent['missed_detection_rate_other_agents']} %, "
            f"isolated {percent['isolated_at_end']} %, exactly {percent['exact_isolation_at_end']} %, with "
            f"{span(x.value for x in found['isolated_sensors_at_end'] if x.fault != 'none')} sensors isolated on average."
        )
    drive = settings["drives"][0]
    for allowed in settings["allowed"]:
        mean = pick(rows, metric="threshold_noise_bounds", condition=condition(drive, allowed))
        values = "; ".join(f"{r.quantity} {r.value:.3g}" for r in mean)
        remarks.append(f"Mean thresholds over the noise bound, {campaign.DRIVES[drive]}, detector {allowed}: {values}.")
    remarks.append(
        f"Faults of {settings['size']:g} thresholds are {span(r.value for r in pick(rows, metric='fault_percent'))} % of the "
        "nominal values, by sensor: no noise within its bounds can mask them for the sensor's own module at full load."
    )
    return remarks


SCENARIO = Scenario(
    name="engine/load",
    title="A load step, healthy and with each sensor faulty",
    about="Load from 100 to 80 % by a PI governor and in one step of the fuel setting, and constant load: false alarms of a "
    "detector designed for full load and of one designed for load changes; detection and isolation of a fault of each "
    "sensor.",
    settings={
        "detector": campaign.VALID,
        "noise": campaign.USUAL_NOISE,
        "drives": tuple(campaign.DRIVES),
        "allowed": tuple(ALLOWED),
        "size": 2.0,
        "change": 5.0,
        "onset": 8.0,
        "duration": 20.0,
    },
    seeds=2,
    full_seeds=100,
    tasks=load_tasks,
    work=load_work,
    summarise=load_summary,
    full={"duration": 60.0},
)
