"""Detectors over the recordings of the chemical plant: with a process fault, and healthy with a bias in one measurement."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.chemical.support.recordings import FAULTS, MEASUREMENTS, identified, recording
from fusion_sfdia.benchmarks.chemical.support.tasks import SIGMAS, sigmas
from fusion_sfdia.detectors.detector import Decision, Detector, run
from fusion_sfdia.detectors.registry import find_detector
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.experiments.scenario import Arrays, Task

Array = NDArray[Any]

JUDGED = 480  # samples of d00_te before the half that is judged; the other may set something
WARM_UP = 40  # samples before the judged ones, in which a filter forgets its initial state
ONSETS = (60, 200, 340)  # samples of the judged half at which biases begin
SIGNS = (1.0, -1.0, 1.0)  # of the biases, by onset
LEARNT_RATE = 0.01  # of false alarms per step of detectors that learn: their data are too few for less


def chosen(task: Task) -> tuple[Detector, bool]:
    """The detector of a task, and whether it learns: from d00 and the first half of d00_te, analyses repeated."""
    folder, named = task["data"], find_detector(task["detector"])
    plant = identified(folder)
    if not named.learns:
        return named.build(plant, false_alarm=task["false_alarm"]), False
    train, test = (recording(folder, name, repeated=True) for name in ("d00", "d00_te"))
    healthy = np.stack([train.y[-JUDGED:], test.y[:JUDGED]], axis=1)
    return named.build(plant, healthy=healthy, false_alarm=LEARNT_RATE), True


def cases(task: Task) -> list[tuple[int, str, float, int]]:
    """The faulty runs: (position of the measurement, meaning of sigma, size in sigma, which onset)."""
    positions = [number - 1 for number in task["measurements"]]
    return list(product(positions, SIGMAS, task["sizes"], range(len(ONSETS))))


def biased(task: Task, log: Log, plant: Plant) -> tuple[Log, Array]:
    """The judged half with a bias in each run, y (K, B, 41), and where it is active (K, B, 41)."""
    runs, scale = cases(task), sigmas(task["data"], plant)
    active = np.zeros((len(log.t), len(runs), len(MEASUREMENTS)), bool)
    size = np.zeros(active.shape)
    for b, (i, sigma, times, which) in enumerate(runs):
        start = WARM_UP + ONSETS[which]
        active[start : start + task["length"], b, i] = True
        size[:, b, i] = SIGNS[which] * times * scale[sigma][i]
    return Log(log.t, log.y[:, None] + active * size, np.repeat(log.u[:, None], len(runs), axis=1)), active


def verdicts(detector: Detector, log: Log) -> Arrays:
    """Isolated (K, ..., 41), process and alarm (K, ...) after the warm-up: sensors isolated, a process hypothesis accepted."""
    start = detector.init(log.y.shape[1:-1], float(log.t[0]) - detector.plant.dt)
    decision: Decision = run(detector, start, *log)[1]
    accepted = np.zeros((*decision.alarm.shape, 0), bool) if decision.process is None else decision.process
    found = {
        "isolated": decision.isolated[..., : len(MEASUREMENTS)],
        "process": accepted.any(axis=-1),
        "alarm": decision.alarm,
        "hypotheses": accepted,
    }
    return {name: np.asarray(values)[WARM_UP:] for name, values in found.items()}


def trial(task: Task) -> Arrays:
    """All verdicts of a detector, prefixed by healthy, the process fault or bias; `active` of the biases; `names` (P,)."""
    detector, learns = chosen(task)
    folder = task["data"]
    logs = {name: recording(folder, f"{name}_te", repeated=learns) for name in ("d00", *FAULTS)}
    judged = logs["d00"].rows(slice(JUDGED - WARM_UP, None))
    arrays = {f"healthy {what}": values for what, values in verdicts(detector, judged).items()}
    for name in FAULTS:
        arrays |= {f"{name} {what}": values for what, values in verdicts(detector, logs[name]).items()}
    faulty, active = biased(task, judged, detector.plant)
    arrays |= {f"bias {what}": values for what, values in verdicts(detector, faulty).items()}
    names = [h.name for h in detector.process_hypotheses]
    return arrays | {"bias active": active[WARM_UP:], "names": np.array(names, dtype=str)}
