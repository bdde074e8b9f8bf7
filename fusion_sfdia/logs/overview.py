"""What a log holds, in words: its length, its step and its gaps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import some
from fusion_sfdia.core.log import Log
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.logs.findings import Finding, counted
from fusion_sfdia.logs.times import Expected, Times

Array = NDArray[Any]

STEP = 50.0  # usual steps over those of the plant, above which the times look as if in another unit than seconds
GAP = 2.5  # usual steps: a time between rows that is longer counts as a gap


def overview(plant: Plant, log: Log, times: Times, expected: Expected) -> list[Finding]:
    """Findings on the rows, their step and gaps, sensors without readings, and the time zone."""
    t, clock = log.t, times.clock
    span = f" from {clock.at(float(t[0]))} to {clock.at(float(t[-1]))}"
    step = float(np.median(np.diff(t))) if t.size > 1 else plant.dt
    every = f", usually {step:.6g} s apart" if t.size > 1 else ""
    found = [Finding("rows", "", t.size, f"{counted(t.size, 'row')}{span}{every}; times are {times.kind}")]
    found += times.notes
    if clock.start is not None and clock.start.tzinfo is None:
        text = "the stamps state no time zone: state tz in a map, or an hour is wrong where clocks change"
        found.append(Finding("zone", "", 0, text))
    if not 1 / STEP <= step / plant.dt <= STEP:
        text = f"rows are {step:.6g} s apart, the readings of plant {plant.name!r} {plant.dt:g} s: are the times in seconds?"
        found.append(Finding("unit suspected", "", 0, text))
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
