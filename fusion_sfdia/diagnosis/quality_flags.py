"""Quality flags of readings, a number a reading, by which data are exchanged.

Those of QARTOD, the primary level of IOC Manuals and Guides 54, vol. 3 (UNESCO 2013): 1 good, 2 not evaluated, 3 suspect,
4 fail (bad), 9 missing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.verdicts import far_off
from fusion_sfdia.diagnosis.diagnose import Diagnosis
from fusion_sfdia.diagnosis.events import EVEN, GroupEvent, UndecidedEvent, follow_ups
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

GOOD, NOT_EVALUATED, SUSPECT, FAIL, MISSING = 1, 2, 3, 4, 9


def quality_flags(plant: Plant, y: Array, found: Diagnosis) -> NDArray[np.int8]:
    """The flag of each reading y (K, N), NaN where missing, by its diagnosis.

    FAIL: impossible, isolated, or within an event of its sensor. SUSPECT: above its threshold, one of several suspects, within
    an event that is rather another one's (confidence below `EVEN`), or in a row that allows no conclusion, as all readings
    are far from the model or more disagree with it than can be isolated. NOT_EVALUATED: without a residual or a threshold, in
    an operation that was not learnt and in which nothing was found, and, where nothing else is found of them, of the sensors
    that are furthest off where readings move together, and of a sensor from its event on to the end of findings that may be
    the same fault under another name (`follow_ups`).
    """
    d, names = found.decisions, plant.sensor_names
    known = np.isfinite(d.residual) & np.isfinite(d.threshold) & ~d.diverged[:, None]
    flags = np.where(known, GOOD, NOT_EVALUATED).astype(np.int8)
    with np.errstate(invalid="ignore"):
        unsure = np.abs(d.residual) > d.threshold
    unsure |= (far_off(d) | d.capped)[:, None]
    if d.suspect is not None:
        unsure |= d.suspect[:, : len(names)]
    flags[unsure & known] = SUSPECT
    failed = d.isolated[:, : len(names)].copy()
    for e in sorted(found.events, key=lambda e: e.kind != "outside"):
        rows = slice(np.searchsorted(found.t, e.start), np.searchsorted(found.t, e.end, side="right"))
        if e.kind == "outside":
            flags[rows][flags[rows] == GOOD] = NOT_EVALUATED
        later = follow_ups(e, found.events, found.t) if e.kind == "sensor" and not e.open else ()
        rest = slice(rows.start, np.searchsorted(found.t, max((o.end for o in later), default=e.end), side="right"))
        doubtful = e.most if isinstance(e, GroupEvent) else (e.hypothesis,) * bool(later)
        for i in (names.index(name) for name in doubtful if name in names):
            flags[rest, i][flags[rest, i] == GOOD] = NOT_EVALUATED
        perhaps = e.suspects if isinstance(e, UndecidedEvent) else (e.hypothesis,) if e.confidence < EVEN else ()
        for i in (names.index(name) for name in perhaps if name in names):
            flags[rows, i], failed[rows, i] = SUSPECT, False
        if e.kind == "sensor" and not e.confidence < EVEN and e.hypothesis in names:
            failed[rows, names.index(e.hypothesis)] = True
    flags[failed] = FAIL
    flags[np.isnan(y)] = MISSING
    flags[np.broadcast_to(d.absurd, flags.shape)] = FAIL
    return flags
