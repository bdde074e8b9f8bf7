"""engine/process: process faults and attacks on single measurements: detection, and false isolation of sensors.

Both are future work in K24. The detector assumes sensor faults only; under a process fault it should isolate no sensor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.engine.support import campaign
from fusion_sfdia.benchmarks.engine.support.campaign_figures import run_figure
from fusion_sfdia.benchmarks.engine.support.process_figures import (
    ALL,
    ATTACKS,
    attack_cases,
    attack_figure,
    noticed,
    process_cases,
    process_figure,
    severity_text,
)
from fusion_sfdia.benchmarks.engine.support.trials import NAMES, row
from fusion_sfdia.common.run_statistics import Estimate, share
from fusion_sfdia.diagnosis.fault_effects import apply_faults
from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.models.marine_engine.plant import SENSORS
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import pick, span
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task, seed_blocks

Array = NDArray[Any]

CHUNK = 25  # runs in one task
PROCESS, ATTACK = "process", "attack"


def process_tasks(settings: Settings, seeds: int) -> list[Task]:
    """All process faults at full load, and all attacks with each kind of load change, with the same noise."""
    campaign.require_settings(settings)
    if unknown := [d for d in settings["drives"] if d not in campaign.DRIVES]:
        raise ValueError(f"setting drives has {', '.join(unknown)}; known: {', '.join(campaign.DRIVES)}")
    common = {k: settings[k] for k in ("detector", "noise", "onset", "duration")}
    process = {"what": PROCESS, "drive": "constant", "severities": list(settings["severities"])}
    attacks = [{"what": ATTACK, "drive": d, "size": settings["size"], "period": settings["period"]} for d in settings["drives"]]
    return [common | part | {"seeds": block} for part in (process, *attacks) for block in seed_blocks(seeds, CHUNK)]


def process_work(task: Task) -> Arrays:
    """First firings (cases, B, N), diverged (cases, B)."""
    name, level, onset, duration = (task[k] for k in ("detector", "noise", "onset", "duration"))
    steady = campaign.steady_detector(name, level)
    moving = task["drive"] != "constant"
    detector = campaign.moving_detector(name, level, duration, onset) if moving else steady
    t, u, healthy = campaign.truth(duration, task["drive"], onset)
    draws = campaign.noise(detector.plant, t.size, task["seeds"])
    readings: Iterator[Array]
    if task["what"] == PROCESS:
        signals = [campaign.truth(duration, "constant", onset, case).signal for case in process_cases(task["severities"])]
        readings = (signal[:, None] + noise for signal, noise in zip(np.stack(signals, axis=1), draws, strict=True))
    else:
        size = campaign.sizes(steady, task["size"])
        lists = [attack(*case, size, healthy[0], task) for case in attack_cases()]
        readings = _attacked(detector.plant, t, healthy[:, None] + np.stack(list(draws)), lists)
    shown = _drawn(task["severities"]) if task["what"] == PROCESS else 0
    _, found = campaign.first_firings(detector, t, u, readings, shown=(shown, 0))
    return {k: found[k] for k in ("first", "diverged", "trace")}


def _attacked(plant: Plant, t: Array, y: Array, lists: Sequence[Sequence[Fault]]) -> Iterator[Array]:
    """Sample by sample the readings y (K, B, N) with the faults of each case (cases, B, N); only attacked columns are kept."""
    sensors = [[plant.sensor_index(fault.sensor) for fault in faults] for faults in lists]
    changed = [apply_faults(plant, t, y, faults).y[..., own] for faults, own in zip(lists, sensors, strict=True)]
    for k, healthy in enumerate(y):
        now = np.repeat(healthy[None], len(lists), axis=0)
        for case, own, values in zip(now, sensors, changed, strict=True):
            case[:, own] = values[k]
        yield now


def _drawn(severities: list[float]) -> int:
    """The process fault whose single run is drawn: the first kind at the largest severity."""
    return int(np.argmax(severities))


def attack(kind: str, sensor: str, size: Array, nominal: Array, task: Task) -> list[Fault]:
    """The sensor faults that make up an attack; size, nominal (N,)."""
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
    """Alarms, delays and isolated sensors by process fault and by attack."""
    cells: dict[tuple[str, str], list[Arrays]] = {}
    for task, arrays in results:
        cells.setdefault((task["what"], task["drive"]), []).append(arrays)
    rows: list[Row] = []
    firsts: dict[tuple[str, str], Array] = {}
    for (what, drive), parts in cells.items():
        first = firsts[what, drive] = np.concatenate([p["first"] for p in parts], axis=1)
        diverged = np.concatenate([p["diverged"] for p in parts], axis=1)
        if what == PROCESS:
            cases = [(kind, "all", severity_text(severity)) for kind, severity in process_cases(list(settings["severities"]))]
        else:
            cases = [(kind, sensor, drive) for kind, sensor in attack_cases()]
        for (kind, quantity, condition), times, lost in zip(cases, first, diverged, strict=True):
            at = partial(row, "engine/process", settings["detector"], kind, quantity, condition=condition)
            faulty = list(SENSORS).index(quantity) if quantity in SENSORS else None
            answer = campaign.response(times, settings["onset"], range(len(NAMES)))
            early = Estimate(float((times < settings["onset"]).any(axis=-1).sum()), math.nan, math.nan, len(times))
            rows += [
                at("missed_detection_rate", answer.missed),
                at("detection_delay", answer.delay),
                at("runs_with_false_alarm", early),
                at("diverged", share(lost)),
                *campaign.diagnosis_rows(at, times, faulty),
            ]
    figures = []
    for key in (k for k in firsts if k[0] == PROCESS):
        figures += [process_figure(list(settings["severities"]), firsts[key]), _run_figure(settings, cells[key][0])]
    figures += [attack_figure(drive, first) for (what, drive), first in firsts.items() if what == ATTACK]
    severities = list(settings["severities"])
    sentences = [x for (what, _), first in firsts.items() if what == PROCESS for x in noticed(severities, first)]
    return Summary(rows, figures, highlights=_highlights(rows), remarks=[*sentences, *_remarks(settings, rows)])


def _run_figure(settings: Settings, arrays: Arrays) -> Figure:
    severities = list(settings["severities"])
    kind, severity = process_cases(severities)[_drawn(severities)]
    title = f"{kind} of {severity:.0%}: residuals, thresholds and decisions"
    first = arrays["first"][_drawn(severities), 0]
    begun = ((kind, settings["onset"]),)
    return run_figure("run", title, arrays["trace"], first, settings, begun, "the process fault begins")


def _highlights(rows: list[Row]) -> list[str]:
    faults = [
        f"{r.fault}, {r.condition}: detected {1 - r.value:.0%}, false isolation {a.value:.0%}"
        for r, a in zip(
            pick(rows, quantity="all", metric="missed_detection_rate"),
            pick(rows, quantity="all", metric="any_sensor_isolated_at_end"),
            strict=True,
        )
    ]
    return [f"False isolation of sensors under process faults. {'; '.join(faults)} of the runs."] if faults else []


def _remarks(settings: Settings, rows: list[Row]) -> list[str]:
    remarks = []
    for drive in settings["drives"]:
        for kind in ATTACKS:
            of_kind = [r for r in rows if r.fault == kind and r.quantity in SENSORS and r.condition == drive]
            missed = pick(of_kind, metric="missed_detection_rate")
            if missed:
                right = pick(of_kind, metric="isolated_at_end")
                exact = pick(of_kind, metric="exact_isolation_at_end")
                found = [r.quantity for r in missed if r.value < 0.5]
                which = f" ({', '.join(found)})" if 0 < len(found) < len(missed) else ""
                remarks.append(
                    f"{kind} ({ATTACKS[kind]}), {campaign.DRIVES[drive]}: detected in most runs on {len(found)} of "
                    f"{len(missed)} sensors{which}; the attacked sensor is isolated in "
                    f"{span(100 * r.value for r in right)} % of the runs, exact isolation in "
                    f"{span(100 * r.value for r in exact)} %."
                )
        every = pick(rows, fault="replay", quantity=ALL, condition=drive, metric="missed_detection_rate")
        remarks += [
            f"All sensors replayed at once, {campaign.DRIVES[drive]}: detected in {1 - r.value:.0%} of the runs." for r in every
        ]
    return remarks


SCENARIO = Scenario(
    name="engine/process",
    title="Process faults and attacks on measurements",
    about="Process faults: fouling, a lost injector, a heavy propeller. Attacks: offset, scaling, sign change and replay of "
    "single measurements, at full load and during a load decrease. Results: detection, and isolated sensors.",
    settings={
        "detector": campaign.VALID,
        "noise": campaign.USUAL_NOISE,
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
