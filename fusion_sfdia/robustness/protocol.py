"""The protocol of `robustness`: which truths, which faults, and when, as data.

A run of a seed settles with silent thresholds, so that no alarm of the start lasts; its last WARM samples before the onset
are deployed. Mismatch acts from the start, sensor faults and process faults from the onset on. Conditions of one truth branch
off the same run at the onset and share its noise; the faulty sensor goes through an order by the seed, as in the comparison.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fusion_sfdia import registry
from fusion_sfdia.comparison.protocol import HEALTHY, PROCESS, PUBLISHED, FaultCondition
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.cases import USUAL_SETTLE, ComparisonCases, PaperFault
from fusion_sfdia.evaluation.faults import Fault
from fusion_sfdia.experiments.scenario import Settings
from fusion_sfdia.robustness.variants import KNOWLEDGE

SETTLE = 60  # samples, of plants that do not state a longer one
BIASES, DRIFTS = (3.0, 10.0, 30.0), (10.0, 30.0)  # sigma, on the right model
UNDER_MISMATCH = 10.0  # sigma
SMALL = 3.0  # sigma, of the bias whose area under the ROC is taken
SLOW = 10.0  # sigma, at the end of a slow drift
LATER = 0.1  # of a slow drift's rise: how long it is watched after that
LONG = 400  # samples; of a longer condition half the runs are made
LOG_RUNS, LOG_STEPS, FIRST_LOG = 4, 400, 920_000  # of a healthy log, and its first seed
CALIBRATION_STEPS = 320  # samples of a healthy run that sets a threshold

SETTINGS = {
    "plants": ("two-tanks", "marine-engine", "gas-pipeline", "power-network"),
    "detectors": ("loo-glr", *(d for d in ("robust-glr",) if d in registry.detectors())),
    "knowledge": KNOWLEDGE,
    "first_seed": 5000,  # those of a run are fresh: nothing was chosen on them; below 1000 to choose something
    "window": 30,  # samples of sensor faults
    "watch": 60,  # samples of healthy runs and of process faults
    "slow": (180, 480, 1500),  # samples in which a slow drift rises
    "false_alarm": 1e-3,  # per step over all sensors on the right model: thresholds are scaled to it
    "calibration_error": 0.3,  # of the rate, relative
}


class Condition(NamedTuple):
    """A fault under a mismatch case ("" for the right model), for some samples from the onset on."""

    mismatch: str
    fault: FaultCondition

    @property
    def length(self) -> int:
        """Samples."""
        return self.fault.length


def settle_of(cases: ComparisonCases) -> int:
    """Samples before the onset."""
    return SETTLE if cases.settle == USUAL_SETTLE else cases.settle


def log_steps(cases: ComparisonCases) -> int:
    """Samples of a run of a healthy log: longer where a filter settles longer."""
    return LOG_STEPS + settle_of(cases) - SETTLE


def slow_drift(plant: Plant, sensor: str, seed: int, onset: float, length: float) -> Fault:
    """A drift that reaches SLOW sigma in its rise and holds it for LATER of that."""
    size = SLOW * float(plant.sensor_sigma[plant.sensor_index(sensor)])
    return Fault(sensor, "drift", onset, length, size, rise=length / (1.0 + LATER))


def slow_name(samples: int) -> str:
    """The name of a slow drift."""
    return f"drift-{SLOW:g}-sigma-in-{samples}-samples"


def conditions(settings: Settings, cases: ComparisonCases) -> list[Condition]:
    """All conditions: of the right model sensor faults, process faults and slow drifts; of mismatch cases fewer."""
    window, watch = int(settings["window"]), int(settings["watch"])
    found = [Condition("", FaultCondition(HEALTHY, HEALTHY, np.nan, watch, HEALTHY))]
    found += [Condition("", graded("bias", size, window)) for size in BIASES]
    found += [Condition("", graded("drift", size, window)) for size in DRIFTS]
    for samples in settings["slow"]:
        rising = PaperFault(slow_name(samples), "a slow drift", slow_drift)
        length = round(samples * (1.0 + LATER))
        found.append(Condition("", FaultCondition(rising.name, PUBLISHED, SLOW, length, "slow drift", rising)))
    found += [Condition("", FaultCondition(c.name, PROCESS, np.nan, watch, PROCESS, c)) for c in cases.process_faults]
    for case in cases.mismatch:
        found.append(Condition(case.name, FaultCondition(HEALTHY, HEALTHY, np.nan, watch, HEALTHY)))
        found += [Condition(case.name, graded(kind, UNDER_MISMATCH, window)) for kind in ("bias", "drift")]
    return found


def graded(kind: str, sigmas: float, length: int) -> FaultCondition:
    """A bias or a drift of a size."""
    return FaultCondition(f"{kind}-{sigmas:g}-sigma", kind, sigmas, length, kind)


def calibration_runs(settings: Settings) -> int:
    """Healthy runs that set a threshold, see `comparison.protocol.calibration_runs`."""
    samples = 1.0 / (settings["false_alarm"] * settings["calibration_error"] ** 2)
    return max(10, int(np.ceil(samples / CALIBRATION_STEPS)))
