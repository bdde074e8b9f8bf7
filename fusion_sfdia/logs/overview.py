"""What a log holds, in words: its length, its step and its gaps."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import some
from fusion_sfdia.common.clock import posix
from fusion_sfdia.logs.epochs import FIRST, LONGEST, LONGEST_COUNT, Calendar, candidates, is_near, shown_as
from fusion_sfdia.logs.loaded_log import Finding, counted
from fusion_sfdia.logs.time_order import HOUR, places_changing
from fusion_sfdia.logs.times import Expected, Times
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

GAP = 2.5  # usual steps: a time between rows that is longer counts as a gap
REGULAR, MULTIPLE = 0.8, 0.02  # share of the steps that are the usual one; how far a ratio of steps may be from a whole number
BEGIN_1904 = 2082844800.0  # s from 1904 to 1970


def overview(plant: Plant, log: Log, times: Times, expected: Expected) -> list[Finding]:
    """Findings on the rows, their step and gaps, stamps in the future, sensors without readings, and the time zone."""
    t, clock = log.t, times.clock
    span = f" from {clock.at(float(t[0]))} to {clock.at(float(t[-1]))}"
    step = float(np.median(np.diff(t))) if t.size > 1 else plant.dt
    every = f", usually {step:.6g} s apart" if t.size > 1 else ""
    found = [Finding("rows", "", t.size, f"{counted(t.size, 'row')}{span}{every}; times are {times.kind}")]
    found += times.notes
    if clock.start is not None and clock.start.tzinfo is None:
        text = "the stamps state no time zone: state tz in a map, or an hour is wrong where clocks change"
        found.append(Finding("zone", "", 0, text))
        for k in np.flatnonzero(np.abs(np.diff(t) - step - HOUR) <= min(0.6 * step + 1.0, 0.1 * HOUR)):
            if places := places_changing(clock.start + timedelta(seconds=float(t[k]) + step + 1.0), back=False):
                text = (
                    f"an hour is missing after {clock.at(float(t[k]))}, where summer time begins in {', '.join(places)}: "
                    f'state the zone of the logger in a map: tz = "{places[0]}", or tz = "UTC" if its clock does not change'
                )
                found.append(Finding("hour missing", "", 1, text))
                break
    found += suspected_times(plant, t, times, expected)
    gaps = np.flatnonzero(np.diff(t) > GAP * step)
    if gaps.size:
        longest = gaps[np.argmax(np.diff(t)[gaps])]
        text = (
            f"{counted(gaps.size, 'gap')} without rows, the longest {t[longest + 1] - t[longest]:.6g} s after "
            f"{clock.at(float(t[longest]))}"
        )
        found.append(Finding("gap", "", gaps.size, text))
    missing: Array = np.isnan(log.y)
    if silent := [plant.sensor_names[i] for i in np.flatnonzero(missing.all(axis=0))]:
        found.append(Finding("silent", "", len(silent), f"no reading of {some(silent)}"))
    partly = missing.any(axis=0) & ~missing.all(axis=0)
    if partly.any():
        total = int(missing[:, partly].sum())
        text = f"{counted(total, 'reading')} missing, of {counted(int(partly.sum()), 'sensor')}"
        found.append(Finding("missing", "", total, text))
    return found


def suspected_times(plant: Plant, t: Array, times: Times, expected: Expected) -> list[Finding]:
    """Findings on times (K,) in order that are almost surely not what they were taken for, or whose step is not the plant's."""
    step = float(np.median(np.diff(t))) if t.size > 1 else plant.dt
    return [*_in_the_future(t, times, expected), *_unusual_step(plant, t, step, times, expected)]


def _in_the_future(t: Array, times: Times, expected: Expected) -> list[Finding]:
    """A finding on stamps that are later than the present, with what else they may be."""
    if times.clock.start is None:
        return []
    since_1970 = posix(times.clock.start)
    count = int(np.sum(since_1970 + t > expected.latest))
    if not count:
        return []
    text = f"{counted(count, 'stamp')} in the future, up to {times.clock.at(float(t[-1]))}"
    others = [] if times.numbers is None else candidates(times.numbers, times.taken, expected.dt, expected.latest)
    others = [c for c in others if isinstance(c, Calendar) or c.since is not None]
    if others and times.numbers is not None:
        text += f": the numbers may be {', or '.join(shown_as(times.numbers, c) for c in others)}; state it in a map"
    elif FIRST <= since_1970 - BEGIN_1904 and since_1970 + float(t[-1]) - BEGIN_1904 <= expected.latest:
        text += ": 66 years too late, as if seconds since 1904 were taken as since 1970; export the log anew"
    else:
        text += ": correct the clock of the logger, or state format in a map"
    return [Finding("future", "", count, text)]


def _unusual_step(plant: Plant, t: Array, step: float, times: Times, expected: Expected) -> list[Finding]:
    """A finding on rows that are closer or wider apart than those of the plant, or, without one, than a log's are."""
    usual = expected.dt
    if usual is None:
        begin = 0.0 if times.clock.start is not None else float(np.max(np.abs(t)))
        if times.stated or times.numbers is None or (step <= LONGEST and begin <= LONGEST_COUNT):
            return []
        text = f"rows are {step:.6g} s apart" if step > LONGEST else f"times are {begin:.6g} s after their start"
    elif is_near(step, usual):
        ratio = max(step / usual, usual / step)
        steps = np.diff(t)
        regular = steps.size > 1 and np.mean(np.isclose(steps, step, rtol=MULTIPLE, atol=0.0)) >= REGULAR
        if not regular or abs(ratio - round(ratio)) <= MULTIPLE * ratio:
            return []
        text = f"rows are {step:.6g} s apart, no multiple and no part of the {usual:g} s of plant {plant.name!r}"
        return [Finding("step", "", 0, text)]
    else:
        text = f"rows are {step:.6g} s apart, the readings of plant {plant.name!r} {usual:g} s"
        if times.stated or times.numbers is None or "%" in times.taken:
            return [Finding("step", "", 0, f"{text}; times are {times.kind}")]
    text += ": are the times in seconds?"
    assert times.numbers is not None
    if others := candidates(times.numbers, times.taken, expected.dt, expected.latest):
        text += f" They may be {', or '.join(shown_as(times.numbers, c) for c in others)}; state it in a map"
    return [Finding("time unit suspected", "", 0, text)]
