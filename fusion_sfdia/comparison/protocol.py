"""The protocol of the comparison: what every detector is put through on every plant, as data.

A run of a seed is a healthy trunk: `settle_of` samples in which filters forget how they began, then one segment for each
group of conditions, in an order that is drawn for each seed, so that no kind of fault is tied to a phase of the operation. A
condition (a fault of a kind, size and length) branches off the trunk where the segment of its group begins; the conditions of
a group share noise and the faulty sensor, those of different groups do not. Mismatch cases are runs of their own, which share
the noise of one another. All sensors fail in turn: each kind goes through an order of its own, drawn once, by the seed; with
a multiple of as many seeds as there are sensors each one fails equally often. All detectors see the same readings.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fusion_sfdia.comparison.published import PAPER_FAULTS, PaperFault
from fusion_sfdia.comparison.truths import DEPARTURES, PLANT_FAULTS
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.random_streams import stream
from fusion_sfdia.evaluation.faults import Fault
from fusion_sfdia.experiments.scenario import Array, Settings, Task, seed_blocks
from fusion_sfdia.registry import detectors, plants, require_known

GRADED = ("bias", "drift", "noise", "scale")  # kinds that have a size
UNGRADED = ("freeze", "dropout")
SEVERAL = ("two-faults", "three-faults")  # biases of SEVERAL_SIGMA at once
ATTACKS = ("replay", "sign")  # on one reading: the samples before over again; its negative
LENGTH = "length"  # biases of several lengths
PUBLISHED = "published"  # those of the plant's papers, of their sizes
KINDS = (*GRADED, *UNGRADED, *SEVERAL, *ATTACKS, PUBLISHED)
SEVERAL_SIGMA = 10.0
TROUBLED_SIGMA = 10.0  # of the bias that is to be found in spite of a departure
HEALTHY = "none"
CHUNK = 25  # seeds in one task, which is set up once
LEAST_RUNS = 10  # of a calibration: their differences show how uncertain it is
USUAL_SETTLE = 100  # samples
SETTLE = {  # where more is needed until the rate of false alarms is steady
    "marine-engine": 400,  # its filter forgets with 145 samples (charge-air pressure); twice the rate still in samples 200-300
}

SETTINGS = {
    "plants": tuple(plants()),
    "detectors": tuple(detectors()),
    "faults": KINDS,
    "magnitudes": (1.0, 3.0, 10.0, 30.0),  # of the sensor's noise
    "lengths": (2, 5, 30, 120),  # samples: of biases of a small and a large size, beside each other
    "settle": 0,  # samples; 0: as many as the plant needs
    "window": 30,  # samples of all other faults
    "false_alarm": 1e-3,  # per step over all sensors: of all detectors when they are compared
    "calibration_error": 1 / 6,  # standard error of the rate that is set, as a share of it, if samples were independent
    "departures": True,
    "plant_faults": True,
}


class Condition(NamedTuple):
    """A fault: its name, kind, size in the sensor's sigma (NaN for none), samples, and the group whose segment it shares."""

    name: str
    kind: str
    sigmas: float
    length: int
    group: str


def sizes(settings: Settings) -> tuple[float, float]:
    """A small and a large fault of those that are tried: 3 and 10 sigma where they are among them."""
    known = sorted(settings["magnitudes"])
    return 3.0 if 3.0 in known else known[0], 10.0 if 10.0 in known else known[-1]


def conditions(settings: Settings, plant: str) -> list[Condition]:
    """All conditions with the usual truth, the healthy one first, group after group."""
    window = int(settings["window"])
    found = [Condition(HEALTHY, HEALTHY, np.nan, window, HEALTHY)]
    for kind in settings["faults"]:
        if kind in GRADED:
            found += [Condition(f"{kind}-{m:g}-sigma", kind, m, window, kind) for m in settings["magnitudes"]]
        elif kind == PUBLISHED:
            found += [Condition(fault.name, kind, np.nan, window, kind) for fault in PAPER_FAULTS.get(plant, ())]
        else:
            found.append(Condition(kind, kind, SEVERAL_SIGMA if kind in SEVERAL else np.nan, window, kind))
    if "bias" in settings["faults"]:
        for m in dict.fromkeys(sizes(settings)):
            found += [Condition(length_name(m, n), LENGTH, m, n, LENGTH) for n in sorted(settings["lengths"])]
    if settings["plant_faults"]:
        found += [Condition(fault.name, "plant", np.nan, window, "plant") for fault in PLANT_FAULTS.get(plant, ())]
    return found


def length_name(sigmas: float, samples: int) -> str:
    """The condition of a bias of that size and length."""
    return f"bias-{sigmas:g}-sigma-{samples}-samples"


def settle_of(settings: Settings, plant: str) -> int:
    """Samples before anything is judged."""
    return int(settings["settle"]) or SETTLE.get(plant, USUAL_SETTLE)


def segments(settings: Settings, plant: str) -> dict[str, int]:
    """Length of the segment of each group, in windows."""
    found: dict[str, int] = {}
    for c in conditions(settings, plant):
        found[c.group] = max(found.get(c.group, 1), -(-c.length // int(settings["window"])))
    return found


def onsets(settings: Settings, plant: str, seed: int) -> dict[str, int]:
    """The first sample (from 0) of the segment of each group: segments follow each other in an order of that seed."""
    lengths = segments(settings, plant)
    groups = list(lengths)
    step, found = settle_of(settings, plant), {}
    for i in stream(seed, "order of segments").permutation(len(groups)):
        found[groups[i]] = step
        step += lengths[groups[i]] * int(settings["window"])
    return found


def judged_steps(settings: Settings, plant: str) -> int:
    """Samples of a trunk after settling."""
    return sum(segments(settings, plant).values()) * int(settings["window"])


def trunk_steps(settings: Settings, plant: str) -> int:
    """Samples of a trunk."""
    return settle_of(settings, plant) + judged_steps(settings, plant)


def calibration_runs(settings: Settings, plant: str) -> int:
    """Healthy runs, each as long as a trunk, whose scores set a threshold.

    Of n independent samples a share p exceeds it with the relative standard error e = 1 / sqrt(n p), so that n = 1 / (p e^2):
    36 of 36 000 samples for 1e-3 and a sixth. Samples of a run depend on each other; how far off the rate may be is measured.
    """
    samples = 1.0 / (settings["false_alarm"] * settings["calibration_error"] ** 2)
    return max(LEAST_RUNS, int(np.ceil(samples / judged_steps(settings, plant))))


def sensors_of(plant: Plant, condition: Condition, seed: int) -> list[int]:
    """The sensors that fail in a run, none where the plant itself fails: a drawn order of all, gone through by the seed."""
    if condition.kind == PUBLISHED and (named := paper_fault(plant, condition).sensor) is not None:
        return [plant.sensor_index(named)]
    everyone = len(plant.sensors)
    count = {HEALTHY: 0, "plant": 0, "two-faults": 2, "three-faults": 3}.get(condition.kind, 1)
    order = stream(0, "order of sensors", condition.group).permutation(everyone)
    return [int(order[(seed + j) % everyone]) for j in range(min(count, everyone))]


def paper_fault(plant: Plant, condition: Condition) -> PaperFault:
    """The fault of a paper that a condition is named after."""
    (found,) = (fault for fault in PAPER_FAULTS[plant.name] if fault.name == condition.name)
    return found


def faults_of(plant: Plant, condition: Condition, seed: int, onset: float, signal: Array) -> list[Fault]:
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
                found.append(paper_fault(plant, condition).make(plant, name, seed, onset, length))
            case kind:
                found.append(Fault(name, kind, onset, length))
    return found


def tasks(settings: Settings, seeds: int) -> list[Task]:
    """One detector on one plant and CHUNK seeds a task: what it needs to be set up is done once. ValueError as in `check`."""
    check(settings)
    common = {k: list(v) if isinstance(v, tuple) else v for k, v in settings.items() if k not in ("plants", "detectors")}
    return [
        {"plant": plant, "detector": detector} | common | {"seeds": block}
        for plant in settings["plants"]
        for detector in settings["detectors"]
        for block in seed_blocks(seeds, CHUNK)
    ]


def check(settings: Settings) -> None:
    """Raise ValueError for unknown names; numbers have the scenario's bounds."""
    for what, known in (("plant", tuple(plants())), ("detector", tuple(detectors())), ("fault", KINDS)):
        for name in settings[f"{what}s"]:
            require_known(what, name, known)


def departures(settings: Settings, plant: str) -> list[str]:
    """Names of the departures that are tried."""
    return [departure.name for departure in DEPARTURES.get(plant, ())] if settings["departures"] else []
