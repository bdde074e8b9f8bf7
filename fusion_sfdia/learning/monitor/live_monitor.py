"""A monitor over rows as they come: what the rows before leave to the next ones, and the detector that `watch` steps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.detector import Claims, Decision, ProcessHypothesis, chosen, joined, stack
from fusion_sfdia.detectors.state import State, mapped
from fusion_sfdia.learning.monitor.causes import Trouble, causes
from fusion_sfdia.learning.monitor.channels import Channels, pieces_of
from fusion_sfdia.learning.monitor.held_out import LearntLimits
from fusion_sfdia.learning.monitor.judging import Before, judged, reach
from fusion_sfdia.learning.monitor.residuals import Ahead, rows_of
from fusion_sfdia.learning.monitor.row_verdicts import Verdicts, decisions_of, plant_of, tested, verdicts_of
from fusion_sfdia.plant.gaps import LONG
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

AT_ONCE = 4096  # rows: of more, a log is judged in parts


class Past(NamedTuple):
    """What the rows before leave to the next ones."""

    ahead: Ahead
    before: Before
    trouble: Trouble

    @classmethod
    def none(cls, channels: Channels, learnt: LearntLimits) -> Past:
        """At the beginning of a piece."""
        return cls(Ahead.none(channels), Before.none(learnt), Trouble.none(len(channels.used), channels.count))


def follow(channels: Channels, learnt: LearntLimits, t: Array, v: Array, past: Past) -> tuple[Verdicts, Past]:
    """The verdicts on rows of the grid at t (K,), readings v (K, n) of all columns, and what is past for the next ones."""
    rows, ahead = rows_of(channels, v, past.ahead)
    tests, before = judged(learnt, rows, past.before)
    by, trouble = causes(learnt, tests, learnt.stated.beyond(v), past.trouble)
    return verdicts_of(channels, t, v, tests, by), Past(ahead, before, trouble)


class KeptRows(NamedTuple):
    """A `Past` in arrays of one shape: of how many rows it is, at most those that tests reach."""

    rows: Array
    past: Any


class LiveGrid(NamedTuple):
    """What a live monitor keeps: the time of the first row, NaN before it; the number of the present step; of its readings (n,)
    how many, their total, the least and the largest; and what was past before that step and with it.
    """

    start: Array
    step: Array
    known: Array
    total: Array
    least: Array
    most: Array
    before: KeptRows
    now: KeptRows


@dataclass(frozen=True, eq=False)
class LiveMonitor(Claims):
    """A monitor as a detector: one row after another, with the verdicts of `Monitor.diagnose` on the rows so far.

    Readings and inputs are NaN where missing. Rows go to the nearest step of the grid that begins with the first row, several
    at one step count by their mean, and after more than 60 steps without a row it begins anew. One run at a time.
    """

    channels: Channels
    dt: float
    learnt: LearntLimits

    @cached_property
    def plant(self) -> Plant:
        """The signals as a plant that does nothing."""
        return plant_of(self.channels, self.dt)

    @property
    def hypotheses(self) -> tuple[str, ...]:
        """The sensors."""
        return self.plant.sensor_names

    @property
    def process_hypotheses(self) -> tuple[ProcessHypothesis, ...]:
        """What else the trouble may be."""
        return tested(self.channels)

    def init(self, batch: tuple[int, ...] = (), t: float = 0.0, seed: int = 0) -> State:
        """Before the first row; ValueError for a batch."""
        if batch:
            raise ValueError(f"batch is {batch}; a live monitor follows one run, batch ()")
        columns, nothing = self.channels.hold.size, self._kept(Past.none(self.channels, self.learnt))
        nan, count = np.full(columns, np.nan), np.zeros(columns)
        grid = LiveGrid(np.array(np.nan), np.array(-1), count, count, nan, nan, nothing, nothing)
        return State(np.array(seed), np.array(0), np.array(float(t)), np.array(False), np.array(-1), grid)

    def step(self, state: State, t: float, y: Array, u: Array) -> tuple[State, Decision]:
        """Judge the readings y (N,) at t (s) with the inputs u (m,)."""
        count, m = len(self.channels.sensors), len(self.channels.inputs)
        if np.shape(y) != (count,) or np.shape(u) != (m,):
            raise ValueError(f"y {np.shape(y)}, u {np.shape(u)}; expected ({count},) and ({m},), NaN where missing")
        return self._stepped(state, t, np.concatenate([y, u]))

    def steps(self, state: State, t: Array, y: Array, u: Array) -> tuple[State, Decision] | None:
        """Judge rows at t (K,) at once, to rounding as `step` does; None where rows have gone before, or several are at one
        step of the grid.
        """
        at = np.rint((t - t[0]) / self.dt).astype(int)
        if not np.isnan(state.memory.start) or np.any(np.diff(at) < 1):
            return None
        parts, past = [], Past.none(self.channels, self.learnt)
        for piece in pieces_of(Log(t[:-1], y[:-1], u[:-1]), self.dt) if t.size > 1 else ():
            past = Past.none(self.channels, self.learnt)
            for k in range(0, len(piece.t), AT_ONCE):
                rows = slice(k, k + AT_ONCE)
                verdicts, past = follow(self.channels, self.learnt, piece.t[rows], piece.v[rows], past)
                parts.append(chosen(decisions_of(self.channels, verdicts), piece.rows[rows] >= 0))
        if parts:
            grid = state.memory._replace(start=np.array(t[0]), step=np.array(at[-2]), now=self._kept(past))
            state = state._replace(steps=state.steps + t.size - 1, memory=grid)
        state, last = self.step(state, float(t[-1]), y[-1], u[-1])
        return state, joined([*parts, stack([last])])

    def _stepped(self, state: State, t: float, y: Array) -> tuple[State, Decision]:
        grid: LiveGrid = state.memory
        start = t if np.isnan(grid.start) else float(grid.start)
        step, at = int(np.rint((t - start) / self.dt)), int(grid.step)
        if step < at:
            raise ValueError(
                f"t is {t:g} s, before the last row, at {float(state.t):g} s; give rows in the order of their times"
            )
        if step == at:
            known, total, least, most = grid.known, grid.total, grid.least, grid.most
            before = grid.before
        else:
            known, total = np.zeros(y.size), np.zeros(y.size)
            least = most = np.full(y.size, np.nan)
            before = grid.now
            if at >= 0 and step - at > LONG:
                before = self._kept(Past.none(self.channels, self.learnt))
            elif at >= 0 and step - at > 1:
                skipped = np.arange(at + 1, step)
                _, past = self._follow(start + self.dt * skipped, np.full((skipped.size, y.size), np.nan), before)
                before = self._kept(past)
        read = np.isfinite(y)
        y = np.where(read, y, np.nan)
        known, total = known + read, total + np.where(read, y, 0.0)
        least, most = np.fmin(least, y), np.fmax(most, y)
        with np.errstate(invalid="ignore", divide="ignore"):
            v = np.where(known == 0, np.nan, np.where(least == most, least, total / known))
        verdicts, past = self._follow(np.array([start + self.dt * step]), v[None], before)
        memory = LiveGrid(np.array(start), np.array(step), known, total, least, most, before, self._kept(past))
        return state._replace(steps=state.steps + 1, t=np.array(float(t)), memory=memory), chosen(
            decisions_of(self.channels, verdicts), -1
        )

    def _follow(self, t: Array, v: Array, kept: KeptRows) -> tuple[Verdicts, Past]:
        before = kept.past.before._replace(tails=kept.past.before.tails.last(int(kept.rows)))
        return follow(self.channels, self.learnt, t, v, kept.past._replace(before=before))

    def _kept(self, past: Past) -> KeptRows:
        tails = past.before.tails
        padded = past._replace(before=past.before._replace(tails=tails.padded(reach(self.learnt))))
        return KeptRows(np.array(len(tails.z)), mapped(np.asarray, padded))
