"""Walks of a detector along a trunk and all its branches, in one pass over time.

A detector takes one time for a whole batch. So branches are not run one after the other: at each sample the batch holds those
that are under way, and each begins with the state of its trunk.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Collection, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import shared_again, single
from fusion_sfdia.detectors.detector import Decision, Detector
from fusion_sfdia.detectors.silent import SILENT, silent_score
from fusion_sfdia.detectors.state import State, chosen_runs, joined_runs, leaves, mapped
from fusion_sfdia.diagnosis.simulate import Recording
from fusion_sfdia.study.comparison.branches import Branches
from fusion_sfdia.study.comparison.calibration import as_scores
from fusion_sfdia.study.comparison.records import KeptDecisions, kept

Array = NDArray[Any]

ROUNDING = 1e-9  # of a score: nearer to a threshold the detector itself decides


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
    trunk: Mapping[int, int] | None = None,
) -> Iterator[WalkStep]:
    """Step a detector along a recording from its `first` sample on: the runs of the trunk, and the branches under way.

    states: those of another walk along the trunk, with which trunk and branches begin; None to begin anew, and branches with
    the state of the walk itself, all in one batch, the trunk first. trunk: of its runs that are followed, by their numbers, the
    samples with which they begin, None for all from the first one on; samples at which no run is under way are left out. Runs
    that share most of their state (`alike`) are stepped together until one has alarmed or missed a reading.
    """
    B, dt, never = recording.y.shape[1], detector.plant.dt, recording.t.size
    onset, length, number = (np.array([getattr(run, what) for run in found.runs], int) for what in ("onset", "length", "b"))
    begins = [first] * B if trunk is None else [trunk.get(b, never) for b in range(B)]
    begin, number = np.concatenate([begins, onset]).astype(int), np.concatenate([np.arange(B), number])
    end = np.concatenate([np.full(B, never), onset + length])
    together, apart = Batch(np.arange(0), None), Batch(np.arange(0), None)
    for k in range(first, recording.t.size):
        if (new := np.flatnonzero(begin == k)).size:
            if states is not None:
                before = states[k]
            else:
                before = together.state if together.members.size else detector.init((B,), float(recording.t[k]) - dt)
            together = together.and_also(Batch(new, chosen_runs(before, number[new])))
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
    """Whether most of what a state of several runs holds is the same for all, such as covariances."""
    arrays = [a for a in leaves(state) if a.ndim]
    return bool(2 * sum(a.size for a in arrays if single(a) is not a) > sum(a.size for a in arrays))


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

    def begins(self, scale: float, first: int) -> dict[int, int]:
        """Of the runs of the trunk whose score exceeds a scale, the last sample until then with a state, from `first` on."""
        above, known = self.trunk[first:] > scale * (1 - ROUNDING), sorted(k for k in self.states if k >= first)
        return {
            int(b): known[bisect_right(known, first + int(above[:, b].argmax())) - 1] for b in np.flatnonzero(above.any(axis=0))
        }

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
    alarms and is in the states of the silent one: its decisions are taken over, on the trunk up to the last known state.
    """
    alarms, seen = np.zeros(recording.y.shape[:2], bool), quiet.at(scale)
    reached = quiet.begins(scale, first) if trunk else {}
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
