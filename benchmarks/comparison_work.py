"""The work of a comparison: one detector on one plant, calibrated to the common rate of false alarms and put through all.

Until the first alarm the deployed and the silent detector have the same state, so a branch of the deployed one begins with that
of the silent trunk: as one that has not alarmed yet. What it does on healthy readings, where some alarms last, is told apart.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.comparison_calibration import (
    Calibrated,
    CannotRunError,
    calibrated,
    deployed,
    silent,
    silent_scores,
)
from fusion_sfdia.benchmarks.comparison_protocol import (
    HEALTHY,
    TROUBLED_SIGMA,
    Condition,
    conditions,
    departures,
    faults_of,
    onset_step,
    sensors_of,
    trunk_steps,
)
from fusion_sfdia.benchmarks.comparison_recordings import beginning, healthy, plant_of
from fusion_sfdia.benchmarks.comparison_records import Branch, join, labelled, record
from fusion_sfdia.benchmarks.comparison_truths import departed, failing
from fusion_sfdia.benchmarks.scenario import Arrays, Task
from fusion_sfdia.core.batch_detector import CLOCK
from fusion_sfdia.core.detector import Decision, Detector, State, run
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.faults import apply
from fusion_sfdia.evaluation.simulate import Recording

Array = NDArray[Any]

SWEPT = ("bias",)  # of which receiver operating characteristics are drawn
TIMED_STEPS = 10


class Trunk(NamedTuple):
    """A healthy recording, the silent detector's scores (K, S) on it, and its states before the samples asked for."""

    recording: Recording
    scores: Array
    states: dict[int, State]


def work(task: Task) -> Arrays:
    """All of one detector on one plant, or the `reason` why there is nothing.

    Of the conditions (J, S): the arrays of `comparison_records`, condition, truth ("" for the plant's own). Of the silent
    detector: trunk (K, S), its scores at nominal thresholds after settling, and swept (J', W, S) in swept_condition (J',).
    deployed_alarms (S,): its samples with an alarm of the deployed one. scale, claim, nominal_alarms (R,) of calibration runs
    of calibration_steps; step_seconds, batch_seconds (of a run in a batch), state_bytes, step_bytes. Seconds and step_bytes
    differ from one call to the next; all else has the same bits for the same task.
    """
    try:
        calibration = calibrated(
            task["plant"], task["detector"], task["settle"], task["calibration_steps"], task["calibration_seeds"],
            task["false_alarm"],
        )  # fmt: skip
    except CannotRunError as problem:
        return {"reason": np.array(str(problem))}
    found = conditions(task, task["plant"])
    recording = healthy(task["plant"], trunk_steps(task, task["plant"]), tuple(task["seeds"]))
    start = time.process_time()
    trunk = follow(silent(calibration.detector), recording, {onset_step(task, c.group) for c in found})
    seconds = (time.process_time() - start) / trunk.scores.size
    groups = [list(members) for _, members in groupby(found, key=lambda c: c.group)]
    usual = [branch_out(task, calibration, trunk, members) for members in groups]
    swept = [members for members in groups if members[0].kind in SWEPT]
    return {
        **join([*usual, *(mistaken(task, calibration, name) for name in departures(task, task["plant"]))]),
        "trunk": trunk.scores[task["settle"] :].astype(np.float32),
        "swept": np.concatenate([swept_scores(task, calibration, trunk, members) for members in swept] or [_NOTHING]),
        "swept_condition": np.array([c.name for members in swept for c in members]),
        "scale": np.array(calibration.scale),
        "claim": np.array(calibration.claim),
        "nominal_alarms": (calibration.scores > 1).sum(axis=0),
        "deployed_alarms": deployed_alarms(task, calibration, trunk),
        "batch_seconds": np.array(seconds),
        **cost(calibration.detector, recording),
    }


_NOTHING = np.empty((0, 0, 0), np.float32)


def follow(detector: Detector, recording: Recording, stops: set[int]) -> Trunk:
    """Run along a recording and keep the states before the samples `stops`."""
    runs = recording.y.shape[1]
    u = recording.u_of_runs
    state = detector.init((runs,), float(recording.t[0]) - detector.plant.dt)
    scores, states = [], {}
    for k, t in enumerate(recording.t):
        if k in stops:
            states[k] = state
        state, decision = detector.step(state, float(t), recording.y[k], u[k])
        scores.append(silent_scores(decision))
    return Trunk(recording, np.stack(scores), states)


def branched(state: State, copies: int) -> State:
    """The state of a batch so many times side by side."""
    return (*state[:CLOCK], *(np.concatenate([a] * copies) for a in state[CLOCK:]))


def readings(task: Task, plant: Plant, recording: Recording, members: Sequence[Condition]) -> Branch:
    """The readings of the segment that the conditions share, one condition after the other along the batch."""
    onset, window, seeds = onset_step(task, members[0].group), task["window"], tuple(task["seeds"])
    before = slice(max(0, onset - window), onset + window)  # what a replay repeats
    shown = [plant_fault(task, c.group, c.name) if c.kind == "plant" else recording for c in members]
    y, signal = (np.concatenate([getattr(r, what)[before] for r in shown], axis=1) for what in ("y", "signal"))
    lists = [
        faults_of(task, plant, c, seed, float(recording.t[onset]), recording.signal[onset : onset + window, b])
        for c in members
        for b, seed in enumerate(seeds)
    ]
    changed = apply(plant, recording.t[before], y, lists, seeds * len(members), signal=signal)
    now = slice(onset - before.start, None)
    u = np.concatenate([r.u_of_runs[onset : onset + window] for r in shown], axis=1)
    return Branch(u, changed.y[now], y[now], signal[now], changed.active[now], changed.size[now])


def run_on(task: Task, detector: Any, trunk: Trunk, members: Sequence[Condition]) -> tuple[Branch, Decision]:
    """A detector on the conditions of a group, all at once, from where its trunk has brought it."""
    branch, onset = readings(task, detector.plant, trunk.recording, members), onset_step(task, members[0].group)
    t = trunk.recording.t[onset : onset + task["window"]]
    return branch, run(detector, branched(trunk.states[onset], len(members)), t, branch.y, branch.u)[1]


def branch_out(task: Task, calibration: Calibrated, trunk: Trunk, members: Sequence[Condition], truth: str = "") -> Arrays:
    """What the deployed detector makes of the conditions of a group."""
    plant = calibration.detector.plant
    branch, decision = run_on(task, deployed(calibration), trunk, members)
    sensors = [sensors_of(task, plant, c, seed) for c in members for seed in task["seeds"]]
    return labelled(record(plant, decision, branch), [c.name for c in members], truth, sensors)


def swept_scores(task: Task, calibration: Calibrated, trunk: Trunk, members: Sequence[Condition]) -> Array:
    """Scores (J, W, S) of the silent detector at nominal thresholds, under the faults of a group."""
    _, decision = run_on(task, silent(calibration.detector), trunk, members)
    scores = silent_scores(decision).reshape(task["window"], len(members), -1)
    return np.asarray(scores.transpose(1, 0, 2), np.float32)


def mistaken(task: Task, calibration: Calibrated, name: str) -> Arrays:
    """Healthy and with a bias, where the truth departs from what the detector was made for."""
    members = [Condition(HEALTHY, HEALTHY, np.nan, 0), Condition(f"bias-{TROUBLED_SIGMA:g}-sigma", "bias", TROUBLED_SIGMA, 0)]
    recording = departed(task["plant"], name, task["settle"] + task["window"], tuple(task["seeds"]))
    trunk = follow(silent(calibration.detector), beginning(recording, task["settle"] + 1), {task["settle"]})
    return branch_out(task, calibration, trunk._replace(recording=recording), members, name)


def plant_fault(task: Task, group: int, name: str) -> Recording:
    """Readings of a run whose plant fails where the segment of the group begins."""
    onset = (onset_step(task, group) - 1e-6) * plant_of(task["plant"]).dt  # with the last healthy reading, but for rounding
    return failing(task["plant"], name, trunk_steps(task, task["plant"]), tuple(task["seeds"]), onset)


def deployed_alarms(task: Task, calibration: Calibrated, trunk: Trunk) -> Array:
    """Samples with an alarm (S,) of the deployed detector on the healthy trunk after settling, latched ones too."""
    recording, settle = trunk.recording, task["settle"]
    y, u = recording.y[settle:], recording.u_of_runs[settle:]
    _, decision = run(deployed(calibration), trunk.states[settle], recording.t[settle:], y, u)
    return np.asarray(decision.alarm.sum(axis=0))


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
        "state_bytes": np.array(sum(a.nbytes for a in state)),
        "step_bytes": np.array(peak - held),
    }
