"""Branches off a trunk: the readings of every condition and seed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.diagnosis.fault_effects import apply_faults
from fusion_sfdia.diagnosis.simulate import Recording
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.cases import ProcessFaultCase
from fusion_sfdia.study.comparison.protocol import PROCESS, FaultCondition, faults_of
from fusion_sfdia.study.comparison.recordings import failing
from fusion_sfdia.study.comparison.records import BranchReadings
from fusion_sfdia.study.comparison.subjects import ComparedPlant, plant_of

Array = NDArray[Any]


class Run(NamedTuple):
    """A condition in the b-th run of a trunk, from the sample `onset` on for `length` samples."""

    condition: FaultCondition
    b: int
    onset: int
    length: int


class Branches(NamedTuple):
    """Runs, and their readings one run below the other (samples of all, N); rows: where each run begins."""

    runs: tuple[Run, ...]
    readings: BranchReadings
    rows: Array

    def of(self, members: Sequence[int], samples: int) -> Array:
        """Rows (samples, members) of the first samples of some runs."""
        return np.asarray(self.rows[list(members)] + np.arange(samples)[:, None])

    def some(self, members: Sequence[int] | Array) -> Branches:
        """Some of the runs, the readings of all."""
        return self._replace(runs=tuple(self.runs[i] for i in members), rows=self.rows[np.asarray(members, int)])


def branches(plant: ComparedPlant, recording: Recording, runs: Sequence[Run], window: int) -> Branches:
    """The readings of all runs of a recording; those before the onset, as many as a window, are what a replay repeats."""
    failed = failures(plant, recording, runs)
    parts = [branch(plant_of(plant), *failed.get(run, (recording, run.b)), run, window) for run in runs]
    readings = BranchReadings(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
    rows = np.cumsum([0, *(run.length for run in runs)])[:-1]
    return Branches(tuple(runs), readings, rows)


def failures(plant: ComparedPlant, recording: Recording, runs: Sequence[Run]) -> dict[Run, tuple[Recording, int]]:
    """Recordings, and places in them, of the runs with a process fault: those of a fault and onset at once."""
    alike: dict[tuple[str, int], list[Run]] = {}
    for run in runs:
        if run.condition.kind == PROCESS:
            alike.setdefault((run.condition.name, run.onset), []).append(run)
    found: dict[Run, tuple[Recording, int]] = {}
    for (_, onset), members in alike.items():
        fault = members[0].condition.case
        assert isinstance(fault, ProcessFaultCase)
        begin = (onset - 1e-6) * plant_of(plant).dt  # with the last healthy reading, but for rounding
        seeds, steps = tuple(recording.seeds[run.b] for run in members), onset + max(run.length for run in members)
        failed = failing(plant, fault, steps, seeds, begin)
        found |= {run: (failed, place) for place, run in enumerate(members)}
    return found


def branch(plant: Plant, recording: Recording, place: int, run: Run, window: int) -> BranchReadings:
    """The readings of one run (length, N), which is found at a place of a recording."""
    condition, _, onset, length = run
    before, now = slice(max(0, onset - window), onset + length), slice(min(window, onset), None)
    y, signal, seed = recording.y[before, place], recording.signal[before, place], recording.seeds[place]
    faults = faults_of(plant, condition, seed, float(recording.t[onset]), signal[now])
    changed = apply_faults(plant, recording.t[before], y[:, None], [faults], [seed], signal=signal[:, None])
    u = recording.u_of_runs[onset : onset + length, place]
    return BranchReadings(u, changed.y[now, 0], y[now], signal[now], changed.active[now, 0], changed.size[now, 0])
