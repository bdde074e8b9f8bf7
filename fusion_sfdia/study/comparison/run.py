"""The work of a comparison: one detector on one plant, calibrated to the common rate of false alarms, under all conditions.

Until the first alarm the deployed and the silent detector have the same state, so a branch of the deployed one begins with
that of the silent trunk: as one that has not alarmed yet; one in which no silent score reaches the threshold is the silent
detector's. What it does on healthy readings, where some alarms last, is reported separately.
"""

from __future__ import annotations

import json
import time
import tracemalloc
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.silent import silent
from fusion_sfdia.detectors.state import State, chosen_runs, leaves
from fusion_sfdia.diagnosis.simulate import Recording
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.comparison.branches import Branches, Run, branches
from fusion_sfdia.study.comparison.calibration import Calibrated, calibrated, deployed
from fusion_sfdia.study.comparison.example import example
from fusion_sfdia.study.comparison.protocol import (
    GRADED,
    HEALTHY,
    LENGTH,
    MISMATCH_SIGMA,
    FaultCondition,
    calibration_runs,
    conditions,
    judged_steps,
    mismatch_cases,
    onsets,
    sensors_of,
    settle_of,
    sizes,
    trunk_steps,
)
from fusion_sfdia.study.comparison.recordings import healthy, mismatched
from fusion_sfdia.study.comparison.records import BranchReadings, KeptDecisions, join, record
from fusion_sfdia.study.comparison.subjects import ComparedDetector, ComparedPlant, cases_of, plant_of
from fusion_sfdia.study.comparison.walks import deployed_walk, silent_walk
from fusion_sfdia.study.experiments.scenario import Arrays, Task

Array = NDArray[Any]

TIMED_STEPS = 10


class Labelled(NamedTuple):
    """A condition, its mismatch case ("" for none), and its runs, one a seed."""

    condition: FaultCondition
    mismatch: str
    members: tuple[int, ...]


class Material(NamedTuple):
    """What all detectors are given: a recording, its branches, and which runs belong to which condition."""

    recording: Recording
    branches: Branches
    labels: tuple[Labelled, ...]


def work(task: Task, plant: ComparedPlant, detector: ComparedDetector) -> Arrays:
    """All of one detector on one plant, or the `reason` why it does not apply.

    Of the conditions (J, S): the arrays of `records.record`, condition, mismatch ("" for none), threshold (0; -1 and 1 for
    thresholds a standard error lower and higher). Of the silent detector: trunk (K, S), its scores at nominal thresholds
    after settling, and swept (J', W, S) in swept_condition (J'), NaN where a condition is over. deployed_alarms (S,): samples
    with an alarm of the deployed one on the trunk. scale, ends (2,), claim; of the calibration runs, calibration_samples each,
    nominal_alarms (R,) and calibration_alarms (R,), above the own and the common threshold. step_seconds, batch_seconds (of a
    run in a batch), state_bytes, step_bytes: seconds and step_bytes differ from one call to the next, all else has the same
    bits for the same task. Of the deployed detector also the arrays of `example`.
    """
    cases = cases_of(plant)
    settle, steps, runs = settle_of(task, cases), judged_steps(task, cases), calibration_runs(task, cases, task["all_seeds"])
    try:
        calibration = calibrated(plant, detector, settle, steps, runs, task["false_alarm"])
    except NotApplicableError as problem:
        return {"reason": np.array(str(problem))}
    key = of_all_detectors(task)
    usual = usual_material(plant, key)
    recording, found, labels = usual
    swept = [label for label in labels if is_swept(task, label.condition)]
    start = time.process_time()
    to_sweep = found.some(sorted({i for label in swept for i in label.members}))
    kept = {settle, *(run.onset for run in found.runs)}
    quiet = silent_walk(silent(calibration.detector), recording, to_sweep, kept)
    seconds = (time.process_time() - start) / (quiet.trunk.size + int(np.isfinite(quiet.runs).sum()))
    alarms, seen = deployed_walk(deployed(calibration), calibration.scale, recording, found, quiet, settle, trunk=True)
    parts = [labelled(calibration.detector.plant, usual, labels, seen)]
    headline = [label for label in labels if is_headline(task, label.condition)]
    to_vary = found.some([i for label in headline for i in label.members])
    for sign, scale in zip((-1, 1), calibration.ends, strict=True):
        _, varied = deployed_walk(deployed(calibration, scale), scale, recording, to_vary, quiet, settle)
        parts += [labelled(calibration.detector.plant, usual, headline, varied, sign)] if headline else []
    if mismatch_cases(task, cases):
        parts.append(under_mismatch(calibration, mismatch_material(plant, key), settle))
    return {
        **{k: np.concatenate([part[k] for part in parts]) for k in parts[0]},
        "trunk": quiet.trunk[settle:].astype(np.float32),
        "swept": swept_scores(found, swept, quiet.runs),
        "swept_condition": np.array([label.condition.name for label in swept]),
        "scale": np.array(calibration.scale),
        "ends": np.array(calibration.ends),
        "claim": np.array(calibration.claim),
        "nominal_alarms": (calibration.scores > 1).sum(axis=0),
        "calibration_alarms": (calibration.scores > calibration.scale).sum(axis=0),
        "calibration_samples": np.array(steps),
        "deployed_alarms": alarms[settle:].sum(axis=0),
        "batch_seconds": np.array(seconds),
        **cost(calibration.detector, recording),
        **example(deployed(calibration), recording, chosen_runs(quiet.states[settle], np.arange(1)), settle, task["window"]),
    }


def is_swept(task: Task, condition: FaultCondition) -> bool:
    """Whether areas under ROCs are taken: of biases, freezes and lengths, of all other sizes a small and a large one."""
    return condition.kind in ("bias", LENGTH, "freeze") or (condition.kind in GRADED and condition.sigmas in sizes(task))


def is_headline(task: Task, condition: FaultCondition) -> bool:
    """Whether it is run at thresholds a standard error lower and higher, too."""
    return condition.kind in GRADED and condition.sigmas in sizes(task)


def of_all_detectors(task: Task) -> str:
    """What a task has in common with those of other detectors, as JSON; a ComparedPlant has the digest of its own sources."""
    return json.dumps({k: v for k, v in task.items() if k not in ("detector", "sources")}, sort_keys=True)


@lru_cache(maxsize=1)
def usual_material(of: ComparedPlant, key: str) -> Material:
    """The usual recording and all conditions, for what is `of_all_detectors` in a task."""
    task, cases = json.loads(key), cases_of(of)
    seeds = tuple(task["seeds"])
    recording = healthy(of, trunk_steps(task, cases), seeds)
    found = conditions(task, cases)
    starts = [onsets(task, cases, seed) for seed in seeds]
    longest = {(c.group, c.sigmas): c for c in sorted(found, key=lambda c: c.length) if c.kind == LENGTH}
    runs: dict[Run, int] = {}
    labels = []
    for c in found:
        carrier = longest.get((c.group, c.sigmas), c)  # a shorter bias is the beginning of a longer one
        own = [Run(carrier, b, starts[b][c.group], carrier.length) for b in range(len(seeds))]
        labels.append(Labelled(c, "", tuple(runs.setdefault(run, len(runs)) for run in own)))
    return Material(recording, branches(of, recording, list(runs), task["window"]), tuple(labels))


@lru_cache(maxsize=1)
def mismatch_material(of: ComparedPlant, key: str) -> Material:
    """All mismatch cases as one recording, each healthy and with a bias after settling."""
    task, cases, plant = json.loads(key), cases_of(of), plant_of(of)
    seeds, window, settle = tuple(task["seeds"]), task["window"], settle_of(task, cases)
    tried = mismatch_cases(task, cases)
    parts = [mismatched(of, case, settle + window, seeds, settle * plant.dt) for case in tried]
    y, signal, u = (np.concatenate([getattr(p, k) for p in parts], axis=1) for k in ("y", "signal", "u_of_runs"))
    recording = replace(parts[0], y=y, signal=signal, u=u, x=None, seeds=seeds * len(tried))
    under = [
        FaultCondition(HEALTHY, HEALTHY, np.nan, window, "mismatch"),
        FaultCondition(f"bias-{MISMATCH_SIGMA:g}-sigma", "bias", MISMATCH_SIGMA, window, "mismatch"),
    ]
    runs: list[Run] = []
    labels = []
    for d, case in enumerate(tried):
        for c in under:
            members = range(len(runs), len(runs) + len(seeds))
            runs += [Run(c, d * len(seeds) + b, settle, window) for b in range(len(seeds))]
            labels.append(Labelled(c, case.name, tuple(members)))
    return Material(recording, branches(of, recording, runs, window), tuple(labels))


def under_mismatch(calibration: Calibrated, material: Material, settle: int) -> Arrays:
    """What a detector does where its model does not hold."""
    recording, found, labels = material
    quiet = silent_walk(silent(calibration.detector), beginning(recording, settle + 1), found.some([]), {settle})
    _, seen = deployed_walk(deployed(calibration), calibration.scale, recording, found, quiet, settle)
    return labelled(calibration.detector.plant, material, labels, seen)


def beginning(recording: Recording, steps: int) -> Recording:
    """The first samples of a recording."""
    names = ("t", "u", "y", "signal")
    return replace(recording, x=None, **{name: getattr(recording, name)[:steps] for name in names})


def labelled(plant: Plant, material: Material, labels: Sequence[Labelled], seen: KeptDecisions, threshold: int = 0) -> Arrays:
    """The records of conditions (J, S) with their names, mismatch cases, thresholds and first faulty sensors (-1 for none)."""
    found, records, sensors = material.branches, [], []
    for condition, _, members in labels:
        rows = found.of(members, condition.length)
        records.append(
            record(plant, KeptDecisions(*(a[rows] for a in seen)), BranchReadings(*(a[rows] for a in found.readings)))
        )
        seeds = [material.recording.seeds[found.runs[i].b] for i in members]
        sensors.append([(sensors_of(plant, condition, seed) or [-1])[0] for seed in seeds])
    return join(records) | {
        "condition": np.array([label.condition.name for label in labels]),
        "mismatch": np.array([label.mismatch for label in labels]),
        "threshold": np.full(len(labels), threshold),
        "sensor": np.array(sensors),
    }


def swept_scores(found: Branches, swept: Sequence[Labelled], scores: Array) -> Array:
    """Scores (J, W, S) of the silent detector under some conditions, NaN where one is over."""
    longest = max((label.condition.length for label in swept), default=0)
    kept = np.full((len(swept), longest, len(swept[0].members) if swept else 0), np.nan, np.float32)
    for j, (condition, _, members) in enumerate(swept):
        kept[j, : condition.length] = scores[found.of(members, condition.length)]
    return kept


def cost(detector: Detector, recording: Recording) -> Arrays:
    """Seconds of a step of one run, the least of some; bytes of its state, and largest in use in a step besides."""
    state: State = detector.init((), float(recording.t[0]) - detector.plant.dt)
    best, u = np.inf, recording.u_of_runs[:, 0]
    for k in range(min(TIMED_STEPS, recording.t.size)):
        start = time.process_time()
        state, _ = detector.step(state, float(recording.t[k]), recording.y[k, 0], u[k])
        best = min(best, time.process_time() - start)
    tracemalloc.start()
    again = detector.init((), float(recording.t[0]) - detector.plant.dt)
    tracemalloc.reset_peak()
    held, _ = tracemalloc.get_traced_memory()
    detector.step(again, float(recording.t[0]), recording.y[0, 0], u[0])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return {
        "step_seconds": np.array(best),
        "state_bytes": np.array(sum(a.nbytes for a in leaves(state))),
        "step_bytes": np.array(peak - held),
    }
