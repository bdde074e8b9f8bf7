"""Methods of monitoring, learnt from one healthy recording of the chemical plant and judged on another."""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.chemical.support.recordings import MEASUREMENTS, VALVES, recording
from fusion_sfdia.benchmarks.chemical.support.tasks import SIGMAS, sigmas
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.identifiability import identifiability
from fusion_sfdia.learning.identification.choice import Candidate, ModelChoice
from fusion_sfdia.learning.identification.healthy_runs import groups_of, runs_of
from fusion_sfdia.learning.outlier_detectors.calibration import Calibration
from fusion_sfdia.learning.outlier_detectors.methods import Methods
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.signals import Signal
from fusion_sfdia.study.experiments.scenario import Arrays, Task

Array = NDArray[Any]

METHODS = {  # the name of the detector in rows: that of the method
    "loo-glr": "bank", "loo-ewma": "predictors", "limits": "limits", "pca": "pca", "dynamic-pca": "dynamic pca",
    "one-class": "one-class",
}  # fmt: skip
REPEATED = ("limits", "pca", "dynamic-pca", "one-class")  # take the repeated analyses, as they need complete samples
FOLDS = 4
SENSORS = tuple(Signal(*one) for one in MEASUREMENTS)
INPUTS = tuple(Signal(one, "%") for one in VALVES)
LENGTHS = {"bias": 80, "drift": 100}  # samples
BEFORE = 60  # samples of a run before its fault
ONSETS = (150, 400, 650)  # samples of d00_te
END = 20  # samples at the end of a drift


class Measurement(NamedTuple):
    """The position of the measurement, the meaning of sigma, and the sample of d00_te at which the fault begins."""

    position: int
    sigma: str
    onset: int


def cases(task: Task) -> list[Measurement]:
    """The faulty runs of each kind."""
    return [Measurement(number - 1, sigma, onset) for number, sigma, onset in product(task["measurements"], SIGMAS, ONSETS)]


@cache
def chosen(folder: str, kind: str, order: int) -> ModelChoice:
    """The model of d00, of the stated kind or, without one, chosen by left-out stretches."""
    candidates = [Candidate(kind, order)] if kind else None
    return ModelChoice.of(
        "tennessee-eastman", SENSORS, [recording(folder, "d00")], inputs=INPUTS, candidates=candidates, folds=FOLDS
    )


def monitored(task: Task) -> Arrays:
    """Of one method: alarms in d00_te after the first samples, isolated (K, runs, 41) and active of both kinds of faults,
    whether each drift ends isolated, the held-out rate, and the smallest biases that can be isolated, in both sigmas (2, 41).
    """
    folder, name = task["data"], task["detector"]
    choice = chosen(folder, task["kind"], task["order"])
    methods = Methods(choice, SENSORS, INPUTS, task["false_alarm"])
    repeated = name in REPEATED
    groups = groups_of(runs_of(SENSORS, INPUTS, [recording(folder, "d00", repeated=repeated)]), FOLDS)[1]
    calibration = Calibration.of(methods.fits[METHODS[name]], groups, task["false_alarm"])
    detector, log = calibration.detector, recording(folder, "d00_te", repeated=repeated)
    dt = detector.plant.dt
    alarm = run(detector, detector.init((), -dt), log)[1].alarm[BEFORE:]

    report = identifiability(choice.plant)
    of = sigmas(folder, choice.plant)
    isolable_size = np.stack([report.told_apart * report.sigma / of[sigma] for sigma in SIGMAS])
    arrays = {
        "healthy alarm": alarm,
        "held-out": np.array([calibration.rate]),
        "isolable size": isolable_size,
        "isolable": isolable_size <= task["size"],
        "model": np.array([str(choice.chosen)]),
    }
    for kind, length in LENGTHS.items():
        faulty, active = with_faults(task, log, of, kind)
        found = run(detector, detector.init(faulty.y.shape[1:-1], -dt), faulty)[1].isolated[BEFORE:, :, : len(SENSORS)]
        exact = np.all(found == active[BEFORE:], axis=-1)
        arrays |= {
            f"{kind} isolated": found,
            f"{kind} active": active[BEFORE:],
            f"{kind} end": exact[length - END : length].mean(axis=0) > 0.5,
        }
    return arrays


def with_faults(task: Task, log: Log, sigma: dict[str, Array], kind: str) -> tuple[Log, Array]:
    """Runs from BEFORE samples before each fault to its end, y (K, B, 41), and where faults are active (K, B, 41).

    A bias has the stated size at once, a drift at its end; the signs alternate.
    """
    runs, length = cases(task), LENGTHS[kind]
    shape = np.ones(length) if kind == "bias" else np.arange(1, length + 1) / length
    rows = np.arange(-BEFORE, length)
    y = np.stack([log.y[case.onset + rows] for case in runs], axis=1)
    u = np.stack([log.u[case.onset + rows] for case in runs], axis=1)
    active = np.zeros(y.shape, bool)
    for b, case in enumerate(runs):
        sign = -1.0 if b % 2 else 1.0
        y[BEFORE:, b, case.position] += sign * task["size"] * sigma[case.sigma][case.position] * shape
        active[BEFORE:, b, case.position] = True
    return Log(log.t[: len(rows)], y, u), active
