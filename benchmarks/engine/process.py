"""engine/process: faults of the engine itself and attacks on single measurements, and whether they are taken for sensor faults.

Both are future work of K24. The detector knows sensor faults alone: a process fault is right where an alarm accuses no sensor.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.engine.support.campaign import (
    DRIVES,
    USUAL_NOISE,
    VALID,
    check,
    engine_detector,
    moving_detector,
    noise,
    response,
    share,
    sizes,
    truth,
    verdict_rows,
    watch,
)
from fusion_sfdia.benchmarks.engine.support.campaign_figures import run_figure
from fusion_sfdia.benchmarks.engine.support.process_figures import (
    ALL,
    ATTACKS,
    attack_cases,
    attack_figure,
    process_cases,
    process_figure,
    told,
)
from fusion_sfdia.benchmarks.engine.support.trials import NAMES, row
from fusion_sfdia.evaluation.fault_effects import apply_faults
from fusion_sfdia.evaluation.faults import Fault
from fusion_sfdia.evaluation.metrics import Estimate
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.experiments.scenario import Arrays, Scenario, Settings, Task, seed_blocks
from fusion_sfdia.models.marine_engine.plant import SENSORS
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.findings import pick, span

Array = NDArray[Any]

CHUNK = 5  # runs in one task
PROCESS, ATTACK = "process", "attack"


def process_tasks(settings: Settings, seeds: int) -> list[Task]:
    """All process faults at full load, and all attacks with each way to change the load, on the same noise."""
    check(settings)
    if unknown := [d for d in settings["drives"] if d not in DRIVES]:
        raise ValueError(f"setting drives has {', '.join(unknown)}; known: {', '.join(DRIVES)}")
    common = {k: settings[k] for k in ("detector", "noise", "onset", "duration")}
    process = {"what": PROCESS, "drive": "constant", "severities": list(settings["severities"])}
    attacks = [{"what": ATTACK, "drive": d, "size": settings["size"], "period": settings["period"]} for d in settings["drives"]]
    return [common | part | {"seeds": block} for part in (process, *attacks) for block in seed_blocks(seeds, CHUNK)]


def process_work(task: Task) -> Arrays:
    """First firings (cases, B, N), diverged (cases, B)."""
    name, level, onset, duration = (task[k] for k in ("detector", "noise", "onset", "duration"))
    steady = engine_detector(name, level)
    moving = task["drive"] != "constant"
    detector = moving_detector(name, level, duration, onset) if moving else steady
    t, u, healthy = truth(duration, task["drive"], onset)
    draws = np.stack(list(noise(detector.plant, t.size, task["seeds"])))
    if task["what"] == PROCESS:
        signals = [truth(duration, "constant", onset, case).signal for case in process_cases(task["severities"])]
        y = np.stack(signals, axis=1)[:, :, None] + draws[:, None]
    else:
        lists = [attack(*case, sizes(steady, task["size"]), healthy[0], task) for case in attack_cases()]
        everyone = np.repeat((healthy[:, None] + draws)[:, None], len(lists), axis=1)
        runs = [faults for faults in lists for _ in task["seeds"]]
        y = apply_faults(detector.plant, t, everyone, runs).y
    shown = _drawn(task["severities"]) if task["what"] == PROCESS else 0
    _, found = watch(detector, t, u, y, shown=(shown, 0))
    return {k: found[k] for k in ("first", "diverged", "trace")}


def _drawn(severities: list[float]) -> int:
    """The process fault of which a single run is drawn: the first kind, as severe as any."""
    return int(np.argmax(severities))


def attack(kind: str, sensor: str, size: Array, nominal: Array, task: Task) -> list[Fault]:
    """The faults that an attack is; size, nominal (N,)."""
    if sensor == ALL:
        return [Fault(s, "replay", task["onset"], period=task["period"]) for s in SENSORS]
    i = list(SENSORS).index(sensor)
    match kind:
        case "offset":
            return [Fault(sensor, "bias", task["onset"], magnitude=size[i])]
        case "scaling":
            return [Fault(sensor, "scale", task["onset"], magnitude=1 + size[i] / nominal[i])]
        case "sign":
            return [Fault(sensor, "scale", task["onset"], magnitude=-1.0)]
    return [Fault(sensor, "replay", task["onset"], period=task["period"])]


def process_summary(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Alarms, delays and sensors accused by process fault and by attack."""
    cells: dict[tuple[str, str], list[Arrays]] = {}
    for task, arrays in results:
        cells.setdefault((task["what"], task["drive"]), []).append(arrays)
    rows: list[Row] = []
    firsts: dict[tuple[str, str], Array] = {}
    for (what, drive), parts in cells.items():
        first = firsts[what, drive] = np.concatenate([p["first"] for p in parts], axis=1)
        diverged = np.concatenate([p["diverged"] for p in parts], axis=1)
        cases = process_cases(list(settings["severities"])) if what == PROCESS else attack_cases()
        for case, times, lost in zip(cases, first, diverged, strict=True):
            where = (f"{case[0]} {case[1]:.0%}", "all") if what == PROCESS else (case[0], f"{case[1]}, {drive}")
            at = partial(row, "engine/process", settings["detector"], *where)
            faulty = list(SENSORS).index(str(case[1])) if case[1] in SENSORS else None
            answer = response(times, settings["onset"], range(len(NAMES)))
            early = Estimate(float((times < settings["onset"]).any(axis=-1).sum()), math.nan, math.nan, len(times))
            rows += [
                at("missed_detection_rate", answer.missed),
                at("detection_delay", answer.delay),
                at("runs_with_false_alarm", early),
                at("diverged", share(lost)),
                *verdict_rows(at, times, faulty),
            ]
    figures = []
    for key in (k for k in firsts if k[0] == PROCESS):
        figures += [process_figure(list(settings["severities"]), firsts[key]), _run_figure(settings, cells[key][0])]
    figures += [attack_figure(drive, first) for (what, drive), first in firsts.items() if what == ATTACK]
    noticed = [x for (what, _), first in firsts.items() if what == PROCESS for x in told(list(settings["severities"]), first)]
    return Summary(rows, figures, highlights=_highlights(rows), remarks=[*noticed, *_remarks(settings, rows)])


def _run_figure(settings: Settings, arrays: Arrays) -> Figure:
    severities = list(settings["severities"])
    kind, severity = process_cases(severities)[_drawn(severities)]
    title = f"{kind} of {severity:.0%}: residuals, thresholds and decisions"
    first = arrays["first"][_drawn(severities), 0]
    begun = ((kind, settings["onset"]),)
    return run_figure("run", title, arrays["trace"], first, settings, begun, "the process fault begins")


def _highlights(rows: list[Row]) -> list[str]:
    told = [
        f"{r.fault}: detected {1 - r.value:.0%}, sensors accused {a.value:.0%}"
        for r, a in zip(
            pick(rows, quantity="all", metric="missed_detection_rate"),
            pick(rows, quantity="all", metric="sensor_accused_at_end"),
            strict=True,
        )
    ]
    return [f"Process faults taken for sensor faults. {'; '.join(told)} of the runs."] if told else []


def _remarks(settings: Settings, rows: list[Row]) -> list[str]:
    remarks = []
    for drive in settings["drives"]:
        for kind in ATTACKS:
            where = [f"{sensor}, {drive}" for sensor in SENSORS]
            missed = pick(rows, fault=kind, quantity=where, metric="missed_detection_rate")
            if missed:
                right = pick(rows, fault=kind, quantity=where, metric="isolated_at_end")
                alone = pick(rows, fault=kind, quantity=where, metric="exact_isolation_at_end")
                found = [r.quantity.split(",")[0] for r in missed if r.value < 0.5]
                named = f" ({', '.join(found)})"
                remarks.append(
                    f"{kind} ({ATTACKS[kind]}), {DRIVES[drive]}: detected in most runs on {len(found)} of {len(missed)} sensors"
                    f"{named if 0 < len(found) < len(missed) else ''}; the attacked sensor is accused in "
                    f"{span(100 * r.value for r in right)} % of the runs, alone in {span(100 * r.value for r in alone)} %."
                )
        every = pick(rows, fault="replay", quantity=f"{ALL}, {drive}", metric="missed_detection_rate")
        remarks += [f"All sensors replayed at once, {DRIVES[drive]}: detected in {1 - r.value:.0%} of the runs." for r in every]
    return remarks


SCENARIO = Scenario(
    name="engine/process",
    title="Process faults and attacks on measurements",
    about="Fouling, a lost injector, a heavy propeller; offset, scaling, changed sign and replay of single measurements, at "
    "full load and as the load falls: what is detected, and whether it is taken for a fault of which sensors.",
    settings={
        "detector": VALID,
        "noise": USUAL_NOISE,
        "drives": ("constant", "governor"),
        "severities": (0.05, 0.2),
        "size": 2.0,
        "period": 3.0,
        "onset": 4.0,
        "duration": 16.0,
    },
    seeds=2,
    full_seeds=100,
    tasks=process_tasks,
    work=process_work,
    summarise=process_summary,
    full={"duration": 60.0},
    bounds={"severities": (1e-3, 0.99)},
)
