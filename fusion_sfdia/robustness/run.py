"""The work of `robustness`: one variant of a detector on one plant, at the common rate of false alarms, in every world.

Thresholds are scaled on healthy readings of the right model, those of a commissioned variant after commissioning on a log of
the right model. That scale holds for the variant that is commissioned on another log, too.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from time import thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.comparison.calibration import as_scores, calibrated
from fusion_sfdia.comparison.protocol import HEALTHY
from fusion_sfdia.comparison.subjects import ComparedPlant, cases_of, compared_plant, plant_of
from fusion_sfdia.core.detector import Detector, NotApplicableError
from fusion_sfdia.core.silent import silent, silent_score
from fusion_sfdia.core.state import State, chosen_runs
from fusion_sfdia.evaluation.simulate import simulate
from fusion_sfdia.experiments.scenario import Arrays, Task
from fusion_sfdia.experiments.timing import best_times
from fusion_sfdia.robustness.building import RefusedLogError, as_compared, build
from fusion_sfdia.robustness.material import Branched, Truth, logged, material
from fusion_sfdia.robustness.protocol import CALIBRATION_STEPS, SMALL, calibration_runs, graded, settle_of
from fusion_sfdia.robustness.records import Kept, join, record
from fusion_sfdia.robustness.variants import ALONE, Variant

Array = NDArray[Any]

WARM = 30  # samples before the onset at which the detector is deployed
TIMED_STEPS, TIMED_SECONDS = 40, 1.0


def work(task: Task) -> Arrays:
    """All of one variant on one plant, or the `reason` why it does not apply; with `variants` in the task, what steps cost.

    Of all runs (R,): the arrays of `records.record`, and row, their condition; condition, mismatch (J,): its names.
    tests_process: whether the detector has hypotheses about the process. refused (M, 2): mismatch cases whose log `commission`
    refuses, and why. healthy_scores (W, S), biased_scores (W', S): of the silent detector on the right model, healthy and
    under the bias of SMALL sigma. scale: of the thresholds.
    """
    of = compared_plant(task["plant"])
    if "variants" in task:
        return cost(of, [Variant(*pair) for pair in task["variants"]])
    variant = Variant(task["detector"], task["knowledge"])
    settle, runs = settle_of(cases_of(of)), calibration_runs(task)
    try:
        calibration = calibrated(of, as_compared(of, variant), settle, CALIBRATION_STEPS, runs, task["false_alarm"])
    except (NotApplicableError, RefusedLogError) as problem:
        return {"reason": np.array(str(problem))}
    common = {k: v for k, v in task.items() if k not in ("detector", "knowledge")}
    worlds = material(of, json.dumps(common | {"other_operation": variant.knowledge == ALONE}, sort_keys=True))
    kept: list[Kept] = []
    refused: list[tuple[str, str]] = []
    for world in worlds:
        usual = not variant.needs_log or logged(of, world.mismatch) is None
        try:
            detector = calibration.detector if usual else build(of, variant, world.mismatch)
        except RefusedLogError as problem:
            refused.append((world.mismatch, str(problem)))
            continue
        kept += followed(scaled(detector, calibration.scale), world)
    return {
        **join([record(one) for one in kept]),
        "condition": np.array([one.branched.condition.fault.name for one in kept]),
        "mismatch": np.array([one.branched.condition.mismatch for one in kept]),
        "tests_process": np.array(bool(kept[0].hypotheses)),
        "refused": np.array(refused, dtype=str).reshape(-1, 2),
        **silent_scores(calibration.detector, worlds[0]),
        "scale": np.array(calibration.scale),
    }


def scaled(detector: Any, scale: float) -> Any:
    """The detector with its thresholds times a factor."""
    return replace(detector, threshold_scale=scale * detector.threshold_scale)


def followed(detector: Any, world: Truth) -> list[Kept]:
    """What a detector decides in a world: silent at first, deployed from WARM samples before the onset on."""
    quiet, first = silent(detector), max(0, world.t.size - WARM)
    state: State = detector.init(world.y.shape[1:2], float(world.t[0]) - detector.plant.dt)
    for k, t in enumerate(world.t):
        state, _ = (quiet if k < first else detector).step(state, float(t), world.y[k], world.u[k])
    return [branched_off(detector, state, one) for one in world.branches]


def branched_off(detector: Detector, state: State, branch: Branched) -> Kept:
    """The decisions under a condition, from the state of all runs at the onset on."""
    kept, now = Kept.empty(detector, branch), chosen_runs(state, np.arange(branch.readings.y.shape[1]))
    for k, t in enumerate(branch.t):
        now, decision = detector.step(now, float(t), branch.readings.y[k], branch.readings.u[k])
        kept.take(k, decision)
    return kept


def silent_scores(detector: Any, world: Truth) -> Arrays:
    """Scores (W, S) of the silent detector on the right model, healthy and under the small bias."""
    quiet = silent(detector)
    names = {HEALTHY: "healthy_scores", graded("bias", SMALL, 1).name: "biased_scores"}
    state: State = quiet.init(world.y.shape[1:2], float(world.t[0]) - detector.plant.dt)
    for k, t in enumerate(world.t):
        state, _ = quiet.step(state, float(t), world.y[k], world.u[k])
    found = {}
    for one in world.branches:
        if (name := names.get(one.condition.fault.name)) is not None:
            now, scores = state, []
            for k, t in enumerate(one.t):
                now, decision = quiet.step(now, float(t), one.readings.y[k], one.readings.u[k])
                scores.append(as_scores(silent_score(decision)))
            found[name] = np.array(scores, np.float32)
    return found


def cost(of: ComparedPlant, those: Sequence[Variant]) -> Arrays:
    """Least processor seconds of a step of each variant that applies, taken in turns: `variant` and `step_seconds` (V,)."""
    plant = plant_of(of)
    recording = simulate(plant, TIMED_STEPS, (0,), process_noise=plant.truth.disturbed)
    calls: dict[str, Callable[[], object]] = {}
    for variant in those:
        try:
            detector = build(of, variant)
        except (NotApplicableError, RefusedLogError):
            continue
        state = detector.init((), float(recording.t[0]) - plant.dt)
        y, u = recording.y[:, 0], recording.u_of_runs[:, 0]
        for k, t in enumerate(recording.t[:-1]):
            state, _ = detector.step(state, float(t), y[k], u[k])
        calls[variant.name] = partial(detector.step, state, float(recording.t[-1]), y[-1], u[-1])
    times = best_times(calls, TIMED_SECONDS, thread_time)
    return {"variant": np.array(list(times)), "step_seconds": np.array([one.best for one in times.values()])}
