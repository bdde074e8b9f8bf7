"""Steps in one row of readings that have inertia: a temperature, a level or a concentration bends when the process changes.

The jump of a reading is its distance from the one before. A sensor has inertia if its healthy readings range over at least
`INERT` times the largest jump that a healthy block is expected to hold. A step of such a sensor is a jump `STEEP` times as
large, after and before which it does not go on to the same side, and with which no other channel jumps beyond its own healthy
jumps, one row earlier or later. By a change of the process a reading with a lag of first order, exp(-1 / T) from row to row,
would go on after a jump by that share of it: a step is one of the sensor where T is above 1 / log(STEEP) rows. Healthy logs
do not show T: where what drives a reading moved slowly in them, and T is shorter, a change of the process is taken for a step.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

INERT = 5.0  # least range of healthy readings, in largest healthy jumps
STEEP = 4.0  # of the largest healthy jump, from which on a jump is a step: T above 0.7 rows
BRIEF = 16  # rows
AROUND = 2  # rows before a row that decide whether it confirms a step


class JumpLimits(NamedTuple):
    """jump (n,): of each channel the largest healthy jump in a block; step (N,): of each sensor the least step, inf where it
    has no inertia.
    """

    jump: Array
    step: Array

    @classmethod
    def of(cls, jumps: Sequence[Array], ranges: Array, largest: Array) -> JumpLimits:
        """Learnt from the jumps (K, n) of healthy blocks, the ranges of the readings of sensors (N,), and the largest jumps to
        expect (B + 1, n): in each block by the others, and by all.

        A sensor that steps in a healthy block, by the limits of the other blocks, has none.
        """
        sensors = ranges.size
        inert = ranges >= INERT * largest[-1, :sensors]
        for of_block, jump in zip(jumps, largest, strict=False):
            by_others = cls(jump, np.where(inert, STEEP * jump[:sensors], np.inf))
            none = np.zeros((len(of_block), sensors), bool)
            inert &= ~steps(by_others, of_block, none, Stepped.none(jump.size, sensors))[0].any(axis=0)
        return cls(largest[-1], np.where(inert, STEEP * largest[-1, :sensors], np.inf))


class Stepped(NamedTuple):
    """What the rows before leave: their jumps (AROUND, n); of each sensor (N,) whether it had stopped, by how much jumps have
    put it off, 0 where they have not, the row of the first of them, counted to the next row, negative, and whether it was a
    step.
    """

    jumps: Array
    stopped: Array
    off: Array
    since: Array
    sure: Array

    @classmethod
    def none(cls, channels: int, sensors: int) -> Stepped:
        """At the beginning."""
        no = np.zeros(sensors, bool)
        return cls(np.full((AROUND, channels), np.nan), no, np.zeros(sensors), np.zeros(sensors, int), no)


def steps(limits: JumpLimits, jumps: Array, stopped: Array, before: Stepped) -> tuple[Array, Array, Stepped]:
    """Of each row and sensor (K, N) by how much steps have put it off, 0 where they have not, and the row of the first of them.

    jumps (K, n), stopped (K, N): sensors that have no new readings, whose next jump is none. A step is known one row later. It
    is over when jumps have taken it back; in the row in which that happens the sensor still counts as off, and also where
    other channels jumped with it, if it was at most `BRIEF` rows before.
    """
    rows, n = len(jumps), limits.step.size
    jumps = jumps.copy()
    jumps[:, :n][np.concatenate([before.stopped[None], stopped])[:-1]] = np.nan
    every = np.concatenate([before.jumps, jumps])
    own, confirmed = np.nan_to_num(every[:, :n]), _confirmed(limits, every)
    jump = limits.jump[:n]
    far = (np.abs(own) > jump) & np.isfinite(limits.step)
    off, since, sure, last = before.off, before.since, before.sure, 0
    size, first = np.zeros((rows, n)), np.zeros((rows, n), int)
    for k in np.flatnonzero((confirmed | far[AROUND:]).any(axis=1)).tolist():
        size[last:k], first[last:k] = np.where(sure, off, 0.0), since
        off = np.where(sure | (since >= k - BRIEF), off, 0.0)
        now, was = np.where(far[k + AROUND], own[k + AROUND], 0.0), off
        sure = sure | (confirmed[k] & (np.abs(off) > limits.step))
        begins = (off == 0) & (np.abs(now) > limits.step)
        since = np.where(begins, k, since)
        off = np.where((off != 0) | begins, off + now, 0.0)
        back = (was != 0) & (np.abs(off) <= np.where(sure, limits.step, jump))
        size[k], first[k], last = np.where(sure & ~back, off, np.where(back, was, 0.0)), since, k + 1
        off, sure = np.where(back, 0.0, off), sure & ~back
    size[last:], first[last:] = np.where(sure, off, 0.0), since
    return size, first, Stepped(every[len(every) - AROUND :], np.asarray(stopped[-1]), off, since - rows, sure)


def _confirmed(limits: JumpLimits, every: Array) -> Array:
    """Whether the row before each of these rows but the first `AROUND` was a step (K, N), for jumps every (AROUND + K, n)."""
    n = limits.step.size
    size = np.nan_to_num(np.abs(every))
    far = size > limits.jump
    around = far[:-2] | far[1:-1] | far[2:]
    with_others = around.sum(axis=1, keepdims=True) - around[:, :n] > 0
    own = np.nan_to_num(every[:, :n])
    on = (far[:-2, :n] & (own[:-2] * own[1:-1] > 0)) | (far[2:, :n] & (own[2:] * own[1:-1] > 0))
    return np.asarray((size[1:-1, :n] > limits.step) & ~with_others & ~on)
