"""The protocol of the comparison: what every detector is put through on every plant, as data.

A run of a seed is a healthy trunk: `settle` samples in which filters forget how they began, then one segment of `window`
samples for each group of conditions. A condition (a fault of a kind and size) branches off the trunk where the segment of its
group begins and lasts as long as that segment; so the conditions of a group share noise and the faulty sensor, those of
different groups do not. Departures are runs of their own, which share the noise of one another. Sensors fail in turn, another
one in each group and seed: with fewer seeds than take turns a kind of fault does not meet every one. All detectors see the
same readings.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fusion_sfdia.benchmarks.comparison_published import PAPER_FAULTS, PaperFault
from fusion_sfdia.benchmarks.comparison_truths import DEPARTURES, PLANT_FAULTS
from fusion_sfdia.benchmarks.detectors import DETECTORS
from fusion_sfdia.benchmarks.registry import PLANTS, require_known
from fusion_sfdia.benchmarks.scenario import Array, Settings, Task, seed_blocks
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.faults import Fault

GRADED = ("bias", "drift", "noise", "scale")  # kinds that have a size
UNGRADED = ("freeze", "dropout")
SEVERAL = ("two-faults", "three-faults")  # biases of SEVERAL_SIGMA at once
ATTACKS = ("replay", "sign")  # on one reading: the samples before over again; its negative
PUBLISHED = "published"  # those of the plant's papers, of their sizes
KINDS = (*GRADED, *UNGRADED, *SEVERAL, *ATTACKS, PUBLISHED)
SEVERAL_SIGMA = 10.0
TROUBLED_SIGMA = 10.0  # of the bias that is to be found in spite of a departure
HEALTHY = "none"
PER_QUANTITY = 2  # sensors of a quantity that fail, unless all are asked for
CHUNK = 25  # seeds in one task, which is set up once

SETTINGS = {
    "plants": tuple(PLANTS),
    "detectors": tuple(DETECTORS),
    "faults": KINDS,
    "magnitudes": (1.0, 3.0, 10.0, 30.0),  # of the sensor's noise
    "settle": 60,  # samples: the printed filters are slow to forget how they began
    "window": 30,  # samples
    "false_alarm": 1e-3,  # per step over all sensors: of all detectors when they are compared
    "calibration_seeds": 20,
    "calibration_steps": 400,  # samples of each that are judged
    "all_sensors": False,
    "departures": True,
    "plant_faults": True,
}


class Condition(NamedTuple):
    """A fault: its name, kind and size in the sensor's sigma (NaN for none), the group whose segment and sensor it shares."""

    name: str
    kind: str
    sigmas: float
    group: int


def conditions(settings: Settings, plant: str) -> list[Condition]:
    """All conditions with a right model, the healthy one first."""
    found = [Condition(HEALTHY, HEALTHY, np.nan, 0)]
    for kind in settings["faults"]:
        group = found[-1].group + 1
        if kind in GRADED:
            found += [Condition(f"{kind}-{m:g}-sigma", kind, m, group) for m in settings["magnitudes"]]
        elif kind == PUBLISHED:
            found += [Condition(fault.name, kind, np.nan, group) for fault in PAPER_FAULTS.get(plant, ())]
        else:
            found.append(Condition(kind, kind, SEVERAL_SIGMA if kind in SEVERAL else np.nan, group))
    last = found[-1].group + 1
    if settings["plant_faults"]:
        found += [Condition(fault.name, "plant", np.nan, last) for fault in PLANT_FAULTS.get(plant, ())]
    return found


def onset_step(settings: Settings, group: int) -> int:
    """The first sample (from 0) of the segment of a group."""
    return int(settings["settle"] + group * settings["window"])


def trunk_steps(settings: Settings, plant: str) -> int:
    """Samples of a trunk."""
    return onset_step(settings, conditions(settings, plant)[-1].group + 1)


def failing_sensors(plant: Plant, *, everyone: bool = False) -> list[int]:
    """The sensors that fail in turn, quantity after quantity: some of each, spread evenly, or all."""
    chosen: list[list[int]] = []
    for members in plant.quantities.values():
        count = members.size if everyone else min(PER_QUANTITY, members.size)
        chosen.append([int(members[(2 * i + 1) * members.size // (2 * count)]) for i in range(count)])
    return [one[i] for i in range(max(map(len, chosen))) for one in chosen if i < len(one)]


def sensors_of(settings: Settings, plant: Plant, condition: Condition, seed: int) -> list[int]:
    """The sensors that fail in a run; another one for each seed and group, none where the plant itself fails."""
    if condition.kind == PUBLISHED and (named := paper_fault(plant, condition).sensor) is not None:
        return [plant.sensor_index(named)]
    count = {HEALTHY: 0, "plant": 0, "two-faults": 2, "three-faults": 3}.get(condition.kind, 1)
    order = failing_sensors(plant, everyone=settings["all_sensors"])
    return [order[(seed + condition.group + j) % len(order)] for j in range(min(count, len(order)))]


def paper_fault(plant: Plant, condition: Condition) -> PaperFault:
    """The fault of a paper that a condition is named after."""
    (found,) = (fault for fault in PAPER_FAULTS[plant.name] if fault.name == condition.name)
    return found


def faults_of(settings: Settings, plant: Plant, condition: Condition, seed: int, onset: float, signal: Array) -> list[Fault]:
    """The sensor faults of a run from `onset` (s) on; signal (window, N): what is true meanwhile."""
    length = settings["window"] * plant.dt
    found = []
    for i in sensors_of(settings, plant, condition, seed):
        name, sigma = plant.sensors[i].name, float(plant.sensor_sigma[i])
        size = condition.sigmas * sigma
        match condition.kind:
            case "bias" | "two-faults" | "three-faults":
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
    """Raise ValueError for settings that no comparison can be made of."""
    for what, known in (("plant", tuple(PLANTS)), ("detector", tuple(DETECTORS)), ("fault", KINDS)):
        names = settings[f"{what}s"]
        for name in names:
            require_known(what, name, known)
        if not names or len(set(names)) < len(names):
            raise ValueError(f"setting {what}s is {','.join(names) or 'empty'}; wanted at least one, each once")
    magnitudes = settings["magnitudes"]
    if not magnitudes or min(magnitudes) <= 0 or len(set(magnitudes)) < len(magnitudes):
        raise ValueError(f"setting magnitudes is {magnitudes}; wanted positive numbers, each once, such as 1,3,10,30")
    for name, least in (("settle", 1), ("window", 2), ("calibration_seeds", 2), ("calibration_steps", 1)):
        if settings[name] < least:
            raise ValueError(f"setting {name} is {settings[name]}; wanted at least {least}")
    samples = settings["calibration_seeds"] * settings["calibration_steps"]
    if not 1 / samples <= settings["false_alarm"] < 1:
        raise ValueError(
            f"setting false_alarm is {settings['false_alarm']:g}; {samples} samples of calibration_seeds x calibration_steps "
            f"can set rates from {1 / samples:g} to less than 1"
        )


def departures(settings: Settings, plant: str) -> list[str]:
    """Names of the departures that are tried."""
    return [departure.name for departure in DEPARTURES.get(plant, ())] if settings["departures"] else []
