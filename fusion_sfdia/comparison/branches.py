"""Branches off a trunk: the readings of every condition and seed, and detectors that follow them all in one pass over time.

A detector takes one time for a whole batch. So branches are not run one after the other: at each sample the batch holds those
that are under way, and each begins with the state of its trunk.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.comparison.calibration import as_scores
from fusion_sfdia.comparison.protocol import PROCESS, FaultCondition, faults_of
from fusion_sfdia.comparison.recordings import failing
from fusion_sfdia.comparison.records import BranchReadings, KeptDecisions, kept
from fusion_sfdia.comparison.subjects import ComparedPlant, plant_of
from fusion_sfdia.core.detector import Decision, Detector
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.silent import silent_score
from fusion_sfdia.core.state import State, chosen_runs, joined_runs
from fusion_sfdia.evaluation.cases import ProcessFaultCase
from fusion_sfdia.evaluation.fault_effects import apply_faults
from fusion_sfdia.evaluation.simulate import Recording

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

    def some(self, members: Sequence[int]) -> Branches:
        """Some of the runs, the readings of all."""
        return self._replace(runs=tuple(self.runs[i] for i in members), rows=self.rows[list(members)])


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


class WalkStep(NamedTuple):
    """A sample of a walk: its number, the state before it, the rows of the branches behind the trunk, and the Decision."""

    k: int
    state: State
    rows: Array
    decision: Decision


def walk(
    detector: Detector,
    recording: Recording,
    found: Branches,
    *,
    first: int = 0,
    states: Mapping[int, State] | None = None,
    trunk: bool = True,
) -> Iterator[WalkStep]:
    """Step a detector along a recording from its `first` sample on: the runs of the trunk, behind them the branches under way.

    states: those of another walk along the trunk, with which trunk and branches begin; None to begin anew, and branches with
    the state of the walk itself. Without the trunk, samples at which no branch is under way are left out.
    """
    count, dt = recording.y.shape[1] if trunk else 0, detector.plant.dt
    u, y = recording.u_of_runs, recording.y
    starting: dict[int, list[int]] = {}
    for i, run in enumerate(found.runs):
        starting.setdefault(run.onset, []).append(i)
    state = None
    if trunk:
        state = detector.init((count,), float(recording.t[first]) - dt) if states is None else states[first]
    active = np.empty(0, int)
    for k in range(first, recording.t.size):
        stay = np.array([j for j, i in enumerate(active) if k < found.runs[i].onset + found.runs[i].length], int)
        begin = starting.get(k, [])
        before = state if states is None else states.get(k)
        if stay.size < active.size and state is not None:
            state = chosen_runs(state, np.concatenate([np.arange(count), count + stay]))
        if begin:
            assert before is not None
            own = chosen_runs(before, np.array([found.runs[i].b for i in begin]))
            state = own if state is None or count + stay.size == 0 else joined_runs(state, own)
        active = np.concatenate([active[stay], np.array(begin, int)])
        if state is None or count + active.size == 0:
            continue
        rows = np.array([found.rows[i] + k - found.runs[i].onset for i in active], int)
        readings = (found.readings.y[rows], found.readings.u[rows])
        if trunk:
            readings = np.concatenate([y[k], readings[0]]), np.concatenate([u[k], readings[1]])
        after, decision = detector.step(state, float(recording.t[k]), *readings)
        yield WalkStep(k, state, rows, decision)
        state = after


class Silent(NamedTuple):
    """Of a silent detector the scores on its trunk (K, B), those by the rows of Branches, and states before some samples."""

    trunk: Array
    runs: Array
    states: dict[int, State]


def silent_walk(detector: Detector, recording: Recording, found: Branches, kept: Collection[int]) -> Silent:
    """Walk with a silent detector; kept: the samples before which its states are expected."""
    count = recording.y.shape[1]
    seen = Silent(np.empty((recording.t.size, count)), np.full(len(found.readings.y), np.nan), {})
    for k, state, rows, decision in walk(detector, recording, found):
        if k in kept:
            seen.states[k] = chosen_runs(state, np.arange(count))
        score = as_scores(silent_score(decision))
        seen.trunk[k], seen.runs[rows] = score[:count], score[count:]
    return seen


def deployed_walk(
    detector: Detector, recording: Recording, found: Branches, states: Mapping[int, State], first: int, *, trunk: bool = False
) -> tuple[Array, KeptDecisions]:
    """Walk with a deployed detector: alarms on the trunk (K, B), and decisions by the rows of Branches."""
    count, n = recording.y.shape[1] if trunk else 0, len(detector.plant.sensors)
    total = len(found.readings.y)
    alarms = np.zeros((recording.t.size, count), bool)
    flags, numbers = np.zeros((2, total), bool), np.empty((3, total, n))
    seen = KeptDecisions(flags[0], flags[1], np.zeros((total, n), bool), numbers[0], numbers[1], numbers[2])
    for k, _, rows, decision in walk(detector, recording, found, first=first, states=states, trunk=trunk):
        now = kept(detector.plant, decision)
        alarms[k] = now.alarm[:count]
        for all_of, of_now in zip(seen, now, strict=True):
            all_of[rows] = of_now[count:]
    return alarms, seen
