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
from fusion_sfdia.core.alike import shared_again, single
from fusion_sfdia.core.detector import Decision, Detector
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.silent import SILENT, silent_score
from fusion_sfdia.core.state import State, chosen_runs, joined_runs, leaves, mapped
from fusion_sfdia.evaluation.cases import ProcessFaultCase
from fusion_sfdia.evaluation.fault_effects import apply_faults
from fusion_sfdia.evaluation.simulate import Recording

Array = NDArray[Any]

ROUNDING = 1e-9  # of a score: nearer to a threshold the detector itself decides


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


class Batch(NamedTuple):
    """Runs that are stepped together (M,), those of the trunk by their numbers 0 to B - 1, branches from B on; their state."""

    members: Array
    state: Any  # a State; None without runs

    def some(self, where: Array) -> Batch:
        """The runs where (M,) holds."""
        return self if where.all() else Batch(self.members[where], chosen_runs(self.state, np.flatnonzero(where)))

    def and_also(self, other: Batch) -> Batch:
        """These runs, and others behind them."""
        if not (self.members.size and other.members.size):
            return self if self.members.size else other
        return Batch(np.concatenate([self.members, other.members]), joined_runs(self.state, other.state))


class WalkStep(NamedTuple):
    """A sample of runs of a walk: its number, their state before it, and the Decision.

    trunk (M,): which are of the trunk, at their numbers; rows: of the others, those of Branches.
    """

    k: int
    state: State
    trunk: Array
    numbers: Array
    rows: Array
    decision: Decision


def walk(
    detector: Detector,
    recording: Recording,
    found: Branches,
    *,
    first: int = 0,
    states: Mapping[int, State] | None = None,
    trunk: Array | None = None,
) -> Iterator[WalkStep]:
    """Step a detector along a recording from its `first` sample on: the runs of the trunk, and the branches under way.

    states: those of another walk along the trunk, with which trunk and branches begin; None to begin anew, and branches with
    the state of the walk itself, all in one batch, the trunk first. trunk: its runs that are followed, by their numbers, None
    for all; samples at which no run is under way are left out. Of the runs that share arrays (`alike`) those are stepped
    apart that have alarmed or missed a reading.
    """
    B, dt = recording.y.shape[1], detector.plant.dt
    onset, length, number = (np.array([getattr(run, what) for run in found.runs], int) for what in ("onset", "length", "b"))
    end = np.concatenate([np.full(B, recording.t.size), onset + length])
    together, apart = Batch(np.arange(0), None), Batch(np.arange(0), None)
    if trunk is None or trunk.size:
        begin = detector.init((B,), float(recording.t[first]) - dt) if states is None else states[first]
        together = Batch(np.arange(B), begin) if trunk is None else Batch(trunk, chosen_runs(begin, trunk))
    for k in range(first, recording.t.size):
        if (new := np.flatnonzero(onset == k)).size:
            before = together.state if states is None else states[k]
            together = together.and_also(Batch(B + new, chosen_runs(before, number[new])))
        after, alone = [together, apart], np.zeros(together.members.shape, bool)
        for j, (members, state) in enumerate((together, apart)):
            if not members.size:
                continue
            on_trunk = members < B
            numbers, branch = members[on_trunk], members[~on_trunk] - B
            rows = found.rows[branch] + k - onset[branch]
            y, u = (np.empty((members.size, a.shape[-1])) for a in (found.readings.y, found.readings.u))
            y[on_trunk], y[~on_trunk] = recording.y[k, numbers], found.readings.y[rows]
            u[on_trunk], u[~on_trunk] = recording.u_of_runs[k, numbers], found.readings.u[rows]
            now, decision = detector.step(state, float(recording.t[k]), y, u)
            yield WalkStep(k, state, on_trunk, numbers, rows, decision)
            after[j] = Batch(members, now)
            if j == 0 and states is not None and shares(state):
                alone = decision.alarm | decision.diverged | np.isnan(y).any(axis=-1)
        stay = after[0].some(~alone)
        if alone.any():
            stay = stay._replace(state=mapped(shared_again, stay.state, together.state))
            after[1] = after[1].and_also(after[0].some(alone))
        together, apart = (batch.some(end[batch.members] > k + 1) for batch in (stay, after[1]))


def shares(state: State) -> bool:
    """Whether the runs of a state have arrays in common."""
    return any(single(a) is not a for a in leaves(state))


class Silent(NamedTuple):
    """Of a silent detector the scores on its trunk (K, B), and by the rows of Branches scores (NaN where it was not run) and
    decisions; states before some samples.
    """

    trunk: Array
    runs: Array
    seen: KeptDecisions
    states: dict[int, State]

    def reaches(self, scale: float, found: Branches) -> Array:
        """Whether its score exceeds a scale in each of some branches, or is not known."""
        within = self.runs <= scale * (1 - ROUNDING)
        return np.array(
            [not within[row : row + run.length].all() for row, run in zip(found.rows, found.runs, strict=True)], bool
        )

    def at(self, scale: float) -> KeptDecisions:
        """Its decisions with thresholds of that scale, as long as no score exceeds them."""
        return KeptDecisions(*map(np.copy, self.seen))._replace(scores=self.seen.scores * (SILENT / scale))


def silent_walk(detector: Detector, recording: Recording, found: Branches, kept_states: Collection[int]) -> Silent:
    """Walk with a silent detector; kept_states: the samples before which its states are expected."""
    count, total = recording.y.shape[1], len(found.readings.y)
    trunk, runs = np.empty((recording.t.size, count)), np.full(total, np.nan)
    seen, states = no_decisions(total, len(detector.plant.sensors)), {}
    for k, state, on_trunk, _, rows, decision in walk(detector, recording, found):
        if k in kept_states:
            states[k] = chosen_runs(state, np.arange(count))
        score = as_scores(silent_score(decision))
        trunk[k], runs[rows] = score[on_trunk], score[~on_trunk]
        keep(seen, rows, kept(detector.plant, decision), ~on_trunk)
    return Silent(trunk, runs, seen, states)


def deployed_walk(
    detector: Detector, scale: float, recording: Recording, found: Branches, quiet: Silent, first: int, *, trunk: bool = False
) -> tuple[Array, KeptDecisions]:
    """Walk with a deployed detector: alarms on the trunk (K, B), and decisions by the rows of Branches.

    scale: of its thresholds over those of the scores of `quiet`. Where these stay below it, the deployed detector never
    alarms and is in the states of the silent one: its decisions are taken over.
    """
    alarms, seen = np.zeros(recording.y.shape[:2], bool), quiet.at(scale)
    reached = np.flatnonzero((quiet.trunk[first:] > scale * (1 - ROUNDING)).any(axis=0)) if trunk else np.arange(0)
    loud = found.some(np.flatnonzero(quiet.reaches(scale, found)))
    for k, _, on_trunk, numbers, rows, decision in walk(
        detector, recording, loud, first=first, states=quiet.states, trunk=reached
    ):
        now = kept(detector.plant, decision)
        alarms[k, numbers] = now.alarm[on_trunk]
        keep(seen, rows, now, ~on_trunk)
    return alarms, seen


def no_decisions(total: int, sensors: int) -> KeptDecisions:
    """Room for the decisions of so many rows: no alarm, nothing isolated, no numbers."""
    flags, numbers = np.zeros((2, total), bool), np.full((3, total, sensors), np.nan)
    return KeptDecisions(flags[0], flags[1], np.zeros((total, sensors), bool), numbers[0], numbers[1], numbers[2])


def keep(seen: KeptDecisions, rows: Array, now: KeptDecisions, of: Array) -> None:
    """Write some runs (M,) of the decisions of a sample at their rows."""
    for all_of, of_now in zip(seen, now, strict=True):
        all_of[rows] = of_now[of]
