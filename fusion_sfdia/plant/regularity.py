"""Regularities of healthy readings that look like faults: a value that is repeated until a new one comes, a step of resolution,
and a period at which readings jump.

A slow sensor in a fast log repeats its value, a coarse one reads multiples of a step, and a cyclic one, such as a compass,
jumps by its period. None of this is a fault; taken for noise of each reading it is isolated as one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

FEWEST = 5  # runs of equal readings, or changes, from which a regularity is known
SEVERAL = 0.2  # share of changes by two steps of resolution and more, above which equal readings in a row mean a repeat
OFTEN = 0.2  # share of the runs that have two readings and more, from which on a sensor repeats its value at times
OFTEN_IN_STEPS = 0.35  # the same of readings in steps, of which some are equal by chance
BY_STEPS = 1.5  # times as many pauses as changes by one step: new readings of such noise have 0.8 times as many
SPREAD = 6.0  # standard deviations of the lengths of runs, within which a run is a repeat
LONGEST_PHASE = 60  # rows between new readings that are sought in a log with coarse readings
BY_CHANCE = 1e-4  # probability of a phase without a repeat
ON_LATTICE, OFF = 0.95, 0.02  # share of changes that are multiples of a step, and by how much of a step they may be off
SMALLEST = 0.05  # quantile of the changes that is taken as the step, so that a rounding or a fault does not hide it
DIGITS = 1e-9  # of the largest reading, or change: smaller changes are rounding
TURNS = {
    "deg": 360.0, "°": 360.0, "degree": 360.0, "degrees": 360.0, "rad": 2 * np.pi, "gon": 400.0, "grad": 400.0, "turn": 1.0,
    "rev": 1.0, "h": 24.0, "min": 60.0, "s": 60.0,
}  # fmt: skip
COUNTERS = tuple(float(2**n) for n in (8, 10, 12, 14, 15, 16, 24, 31, 32))
EDGE = 0.1  # of a period, from its ends, in which a reading that jumps lies before and after
CONTINUOUS = 4.0  # largest change at a jump without the period over the usual ones


class Repeat(NamedTuple):
    """Readings that repeat their value.

    usual: readings of one value, 1 where most are new; longest: so many at most, more is a frozen sensor.
    on_phase: the position of new readings modulo `usual`, where only that tells them from coarse ones; None elsewhere.
    """

    usual: int
    longest: int
    on_phase: int | None = None

    @property
    def words(self) -> str:
        """When new readings come: "new every 10 rows"."""
        return f"new every {self.usual} rows" if self.usual > 1 else "in some of the rows"


def equal_readings(column: Array) -> tuple[Array, Array, Array]:
    """The positions of the readings of a sensor (K,), NaN where missing, and of each run of equal ones its start among them and
    its length.
    """
    at = np.flatnonzero(np.isfinite(column))
    starts = np.flatnonzero(np.diff(column[at], prepend=np.nan) != 0)
    return at, starts, np.diff(starts, append=at.size)


def resolution(column: Array) -> float:
    """The step whose multiples the changes of readings (K,) are, 0 for none: of most of them, so that a fault hides it not."""
    known = column[np.isfinite(column)]
    if known.size < 2:
        return 0.0
    changes = np.abs(np.diff(known))
    changes = changes[changes > DIGITS * np.max(np.abs(known))]
    if changes.size < FEWEST:  # of a reading that hardly moves: all by one step
        steady = changes.size > 1 and changes.size < known.size / FEWEST and np.ptp(changes) < OFF * np.min(changes)
        return float(np.median(changes)) if steady else 0.0
    return step_of(changes) if np.unique(known).size <= known.size / 2 else 0.0


def step_of(changes: Array) -> float:
    """The step whose multiples most of the changes (K,) are, which are positive; 0 for none."""
    step = float(np.quantile(changes, SMALLEST, method="lower"))
    if step <= DIGITS * np.max(changes):
        return 0.0
    multiple = np.maximum(np.rint(changes / step), 1.0)
    return float(np.median(changes / multiple)) if np.mean(np.abs(changes / step - multiple) < OFF) >= ON_LATTICE else 0.0


def repeat(column: Array, step: float | None = None) -> Repeat | None:
    """How the readings of a sensor (K,), NaN where missing, repeat their value; None where they do not. step: `resolution`.

    Of coarse readings that come anew at a fixed phase those between are repeats; of others `repeats` decides.
    """
    at, starts, lengths = equal_readings(column)
    if lengths.size < FEWEST + 2:
        return None
    step, inner, values = resolution(column) if step is None else step, lengths[1:-1], column[at[starts]]
    if step and np.median(inner) >= 2 and (found := _on_phase(starts[1:])) is not None:
        return found
    return of_lengths(inner) if repeats(inner, values[1:-1], np.abs(np.diff(values))[1:], step) else None


def repeats(lengths: Array, values: Array, changes: Array, step: float = 0.0) -> bool:
    """Whether runs of equal readings (R,) of such values, which end with such changes, are repeats of one reading; step: that
    of the changes is used where it is 0.

    Without a step of resolution new readings are never equal. With one they are, where hardly any changes by more than a step.
    Where less than half of the runs have two readings or more, these are of several values, not of the end of a range; and
    where there is a step, more readings pause between two changes by several steps than change by one step there.
    """
    again = lengths > 1
    if np.mean(again) < OFTEN:
        return False
    step = step or step_of(changes)
    multiple = np.rint(changes / step) if step else changes
    several = not step or bool(np.mean(multiple >= 2) >= SEVERAL)
    if not several or np.median(lengths) >= 2:
        return several
    if (step and np.mean(again) < OFTEN_IN_STEPS) or np.unique(values[again]).size < FEWEST:
        return False
    large, single = multiple >= 2, lengths == 1
    pauses = np.sum(large[:-1] & (lengths[1:] == 2) & large[1:])
    by_one = np.sum(large[:-2] & single[1:-1] & (multiple[1:-1] == 1) & single[2:] & large[2:])
    return not step or bool(pauses >= BY_STEPS * by_one + FEWEST)


def of_lengths(lengths: Array) -> Repeat:
    """The repeat of runs of equal readings, half of them of two and more; those ten times as long as usual are no repeats."""
    usual = float(np.median(lengths))
    inner = lengths[lengths <= 10 * usual]
    longest = max(1.5 * float(np.quantile(inner, 0.95)), float(np.mean(inner) + SPREAD * np.std(inner)))
    return Repeat(round(usual), int(np.ceil(longest)))


def _on_phase(starts: Array) -> Repeat | None:
    """The repeat of readings that change at one phase only; the longest interval of those that have one."""
    for rows in range(LONGEST_PHASE, 1, -1):
        phase = np.bincount(starts % rows, minlength=rows)
        off = int(starts.size - phase.max())
        if off <= 0.02 * starts.size and LONGEST_PHASE * (1 / rows) ** (starts.size - off - 1) < BY_CHANCE:
            return Repeat(rows, rows, int(np.argmax(phase)))
    return None


def repeated(column: Array, found: Repeat) -> Array:
    """Which readings (K,) repeat the one before: not the first of a run, nor those after `longest`, of a frozen sensor."""
    at, starts, lengths = equal_readings(column)
    age = np.arange(at.size) - np.repeat(starts, lengths)
    out = np.zeros(column.size, bool)
    if found.on_phase is None:
        out[at] = (age > 0) & (age < found.longest)
    else:
        out[at] = (age > 0) & (np.arange(at.size) % found.usual != found.on_phase)
    return out


def period(column: Array, unit: str) -> float | None:
    """The period by which readings (K,) in a unit jump: that of an angle or a clock in it, or a power of two of a counter.

    All readings lie within one period from 0, or half of one on either side. Each jump is from near one end of it to near the
    other, and without the period the readings change there as they do elsewhere.
    """
    known = column[np.isfinite(column)]
    of_unit = (TURNS[unit.strip()],) if unit.strip() in TURNS else COUNTERS if unit in ("", "1") else ()
    if not of_unit or known.size < 3 * FEWEST or np.unique(known).size < 2 * FEWEST:
        return None
    changes, low, high = np.diff(known), float(np.min(known)), float(np.max(known))
    for turn in of_unit:
        begin = 0.0 if low > -EDGE * turn else -turn / 2
        if low < begin - EDGE * turn or high > begin + (1 + EDGE) * turn:
            continue
        jumps = np.abs(changes) > turn / 2
        if not jumps.any() or jumps.all():
            continue
        before, after = known[:-1][jumps] - begin, known[1:][jumps] - begin
        ends = (np.minimum(before, after) < EDGE * turn) & (np.maximum(before, after) > (1 - EDGE) * turn)
        left = np.abs(changes[jumps] - np.sign(changes[jumps]) * turn)
        usual = float(np.quantile(np.abs(changes[~jumps]), 0.95))
        if ends.all() and np.max(left) <= max(CONTINUOUS * usual, 1e-6 * turn) and usual < turn / 8:
            return turn
    return None
