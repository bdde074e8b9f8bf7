"""The protocol of the comparison: what every detector is put through on every plant, as data.

A run of a seed is a healthy trunk: `settle_of` samples in which filters forget how they began, then one segment for each
group of conditions, in an order that is drawn for each seed, so that no kind of fault is tied to a phase of the operation. A
condition (a fault of a kind, size and length) branches off the trunk where the segment of its group begins; the conditions of
a group share noise and the faulty sensor, those of different groups do not. Mismatch cases are runs of their own, which share
the noise of one another. All sensors fail in turn: each kind goes through an order of its own, drawn once, by the seed; with
a multiple of as many seeds as there are sensors each one fails equally often. All detectors are given the same readings.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.cases import ComparisonCases, MismatchCase, PaperFault, ProcessFaultCase
from fusion_sfdia.study.experiments.scenario import Array, Settings

GRADED = ("bias", "drift", "noise", "scale")  # kinds that have a size
UNGRADED = ("freeze", "dropout")
SEVERAL = ("two-faults", "three-faults")  # biases of SEVERAL_SIGMA at once
ATTACKS = ("replay", "sign")  # on one reading: the samples before over again; its negative
LENGTH = "length"  # biases of several lengths
PUBLISHED = "published"  # those of the plant's papers, of their sizes
PROCESS = "process"  # no sensor is faulty
KINDS = (*GRADED, *UNGRADED, *SEVERAL, *ATTACKS, PUBLISHED)
SEVERAL_SIGMA = 10.0
MISMATCH_SIGMA = 10.0  # of the bias that is to be found in spite of a model mismatch
HEALTHY = "none"
LEAST_RUNS = 10  # of a calibration: their differences show how uncertain it is
RUNS_PER_SEED = 3  # of a calibration, where its error is not set

# Weights of the loss by which detectors are ranked. A missed fault is the unit. A healthy sensor isolated costs twice that: a
# good reading is taken out, a technician is sent to the wrong place, and what is really wrong goes on. A late alarm costs half:
# even without a name somebody would have looked. The model is wrong half of the time: no plant is as its model, and how often
# that matters nobody knows beforehand.
COSTS = {"missed_cost": 1.0, "false_isolation_cost": 2.0, "delay_cost": 0.5, "wrong_model_share": 0.5}

SETTINGS = {
    "plants": tuple(registry.plants()),
    "detectors": tuple(registry.compared_detectors()),
    "faults": KINDS,
    "magnitudes": (1.0, 3.0, 10.0, 30.0),  # of the sensor's noise
    "lengths": (2, 5, 30, 120),  # samples: of biases of a small and a large size, beside each other
    "settle": 0,  # samples; 0: as many as the cases of the plant state
    "window": 30,  # samples of all other faults
    "false_alarm": 1e-3,  # per step over all sensors: of all detectors when they are compared
    "calibration_error": 0.0,  # standard error of the rate that is set, as a share of it; 0: by the number of seeds
    "mismatch_cases": True,
    "process_faults": True,
    **COSTS,
}


class FaultCondition(NamedTuple):
    """A fault: its name, kind, size in the sensor's sigma (NaN for none), samples, and the group whose segment it shares.

    case: the fault of a paper or of the process behind it, where it is one.
    """

    name: str
    kind: str
    sigmas: float
    length: int
    group: str
    case: PaperFault | ProcessFaultCase | None = None

    @property
    def columns(self) -> tuple[str, str]:
        """Its `fault` and `condition` in metrics.csv."""
        if self.kind == LENGTH:
            return f"bias-{self.sigmas:g}-sigma", f"{self.length} samples"
        return self.name, ""


def sizes(settings: Settings) -> tuple[float, float]:
    """A small and a large fault of those that are tried: 3 and 10 sigma where they are among them."""
    known = sorted(settings["magnitudes"])
    return 3.0 if 3.0 in known else known[0], 10.0 if 10.0 in known else known[-1]


def conditions(settings: Settings, cases: ComparisonCases) -> list[FaultCondition]:
    """All conditions without model mismatch, the healthy one first, group after group."""
    window = int(settings["window"])
    found = [FaultCondition(HEALTHY, HEALTHY, np.nan, window, HEALTHY)]
    for kind in settings["faults"]:
        if kind in GRADED:
            found += [FaultCondition(f"{kind}-{m:g}-sigma", kind, m, window, kind) for m in settings["magnitudes"]]
        elif kind == PUBLISHED:
            found += [FaultCondition(fault.name, kind, np.nan, window, kind, fault) for fault in cases.paper_faults]
        else:
            found.append(FaultCondition(kind, kind, SEVERAL_SIGMA if kind in SEVERAL else np.nan, window, kind))
    if "bias" in settings["faults"]:
        for m in dict.fromkeys(sizes(settings)):
            found += [FaultCondition(length_name(m, n), LENGTH, m, n, LENGTH) for n in sorted(settings["lengths"])]
    if settings["process_faults"]:
        found += [FaultCondition(fault.name, PROCESS, np.nan, window, PROCESS, fault) for fault in cases.process_faults]
    return found


def length_name(sigmas: float, samples: int) -> str:
    """The condition of a bias of that size and length."""
    return f"bias-{sigmas:g}-sigma-{samples}-samples"


def settle_of(settings: Settings, cases: ComparisonCases) -> int:
    """Samples before anything is judged."""
    return int(settings["settle"]) or cases.settle


def segments(settings: Settings, cases: ComparisonCases) -> dict[str, int]:
    """Length of the segment of each group, in windows."""
    found: dict[str, int] = {}
    for c in conditions(settings, cases):
        found[c.group] = max(found.get(c.group, 1), -(-c.length // int(settings["window"])))
    return found


def onsets(settings: Settings, cases: ComparisonCases, seed: int) -> dict[str, int]:
    """The first sample (from 0) of the segment of each group: segments follow each other in an order of that seed."""
    lengths = segments(settings, cases)
    groups = list(lengths)
    step, found = settle_of(settings, cases), {}
    for i in stream(seed, "order of segments").permutation(len(groups)):
        found[groups[i]] = step
        step += lengths[groups[i]] * int(settings["window"])
    return found


def judged_steps(settings: Settings, cases: ComparisonCases) -> int:
    """Samples of a trunk after settling."""
    return sum(segments(settings, cases).values()) * int(settings["window"])


def trunk_steps(settings: Settings, cases: ComparisonCases) -> int:
    """Samples of a trunk."""
    return settle_of(settings, cases) + judged_steps(settings, cases)


def calibration_runs(settings: Settings, cases: ComparisonCases, seeds: int) -> int:
    """Healthy runs, each as long as a trunk, whose scores set a threshold for a comparison of so many seeds.

    Of n independent samples a share p exceeds it with the relative standard error e = 1 / sqrt(n p), so that n = 1 / (p e^2):
    36 of 36 000 samples for 1e-3 and a sixth. Samples of a run depend on each other; how far off the rate may be is measured.

    Without a set error there are RUNS_PER_SEED a seed. The rate that is judged has the variance v / seeds + v / runs, v that
    of one run; a seed takes some 6 times the steps of a calibration run. So of all with the same cost sqrt(6) = 2.4 runs a
    seed have the least variance, and 3 widen the interval by sqrt(1 + 1/3), 15 %.
    """
    if not settings["calibration_error"]:
        return max(LEAST_RUNS, RUNS_PER_SEED * seeds)
    samples = 1.0 / (settings["false_alarm"] * settings["calibration_error"] ** 2)
    return max(LEAST_RUNS, int(np.ceil(samples / judged_steps(settings, cases))))


def stated_error(settings: Settings, samples: int) -> float:
    """The relative standard error of a rate that is set by so many independent samples."""
    return float(1.0 / np.sqrt(samples * settings["false_alarm"]))


def sensors_of(plant: Plant, condition: FaultCondition, seed: int) -> list[int]:
    """The sensors that fail in a run, none in one with a process fault: a drawn order of all, gone through by the seed."""
    if isinstance(condition.case, PaperFault) and condition.case.sensor is not None:
        return [plant.sensor_index(condition.case.sensor)]
    everyone = len(plant.sensors)
    count = {HEALTHY: 0, PROCESS: 0, "two-faults": 2, "three-faults": 3}.get(condition.kind, 1)
    order = stream(0, "order of sensors", condition.group).permutation(everyone)
    return [int(order[(seed + j) % everyone]) for j in range(min(count, everyone))]


def faults_of(plant: Plant, condition: FaultCondition, seed: int, onset: float, signal: Array) -> list[Fault]:
    """The sensor faults of a run from `onset` (s) on; signal (samples, N): what is true meanwhile."""
    length = condition.length * plant.dt
    found = []
    for i in sensors_of(plant, condition, seed):
        name, sigma = plant.sensors[i].name, float(plant.sensor_sigma[i])
        size = condition.sigmas * sigma
        match condition.kind:
            case "bias" | "length" | "two-faults" | "three-faults":
                found.append(Fault(name, "bias", onset, length, size))
            case "drift":  # reaches its size half-way and holds it
                found.append(Fault(name, "drift", onset, length, size, rise=length / 2))
            case "scale":  # by a factor with which a signal above the noise errs by that size
                level = max(float(np.sqrt(np.mean(signal[:, i] ** 2))), sigma)
                found.append(Fault(name, "scale", onset, length, 1.0 + size / level))
            case "noise":
                found.append(Fault(name, "noise", onset, length, size))
            case "sign":
                found.append(Fault(name, "scale", onset, length, -1.0))
            case "published":
                assert isinstance(condition.case, PaperFault)
                found.append(condition.case.make(plant, name, seed, onset, length))
            case kind:
                found.append(Fault(name, kind, onset, length))
    return found


def mismatch_cases(settings: Settings, cases: ComparisonCases) -> tuple[MismatchCase, ...]:
    """The mismatch cases that are tried: those that are not kept for the scenario `robustness`."""
    return tuple(case for case in cases.mismatch if not case.unseen) if settings["mismatch_cases"] else ()
