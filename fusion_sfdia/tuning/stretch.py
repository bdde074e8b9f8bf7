"""Tuning on a stretch of the log that is then diagnosed."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import shown
from fusion_sfdia.core.clock import Clock
from fusion_sfdia.core.log import Log
from fusion_sfdia.core.numerals import decimal
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.rate import Rate
from fusion_sfdia.tuning.tune import Source, tune
from fusion_sfdia.tuning.tuned import Tuned

FALSE_ALARM = Rate(1e-3)  # that of registered detectors


def on_stretch(plant: Plant, log: Log, between: str, detector: Any, clock: Clock = Clock()) -> Tuned:  # noqa: B008
    """Tune on the readings between two times of a log of one run, FROM..TO, see `within`; ValueError as `tune` raises it."""
    inside = within(log.t, between, clock)
    part = Log(*(a[inside] for a in log))
    return tune(plant, part, false_alarm=FALSE_ALARM, detector=detector, sources=[Source(f"the stretch {between}", clock)])


def within(t: NDArray[np.float64], between: str, clock: Clock) -> NDArray[np.bool_]:
    """Which times (K,) s are between those of FROM..TO, seconds or of the clock; a missing one is the log's first or last.

    ValueError for another form, and where no time is between them.
    """
    start, dots, end = (part.strip() for part in between.partition(".."))
    if not dots:
        raise ValueError(
            f"--healthy is {shown(between)}; expected FROM..TO, such as 0..3600 (s) or 2026-03-01T06:00..2026-03-01T14:20"
        )
    low, high = (_time(text, clock) if text else usual for text, usual in ((start, -np.inf), (end, np.inf)))
    inside = (t >= low) & (t <= high)
    if not np.any(inside):
        raise ValueError(
            f"no reading from {start or 'the beginning'} to {end or 'the end'}; the log goes from {clock.at(float(t[0]))} to "
            f"{clock.at(float(t[-1]))}"
        )
    return inside


def _time(text: str, clock: Clock) -> float:
    try:
        return decimal(text)
    except ValueError:
        pass
    if clock.start is None:
        raise ValueError(f"the time {shown(text)} is no number of seconds, and the log has seconds alone; give such as 0..3600")
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise ValueError(f"the time {shown(text)} is neither seconds nor such as 2026-03-01T14:20") from error
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=clock.start.tzinfo)
    elif clock.start.tzinfo is None:
        raise ValueError(f"the time {shown(text)} has a zone, those of the log have none; leave it out")
    return clock.seconds(moment)
