"""Between values of a bridge, each with its own time stamp, and a watch: rows from values."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from datetime import datetime, timedelta
from heapq import nlargest
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.diagnosis.watch import Watch

Array = NDArray[Any]

MAX_LEAD, MAX_LAG = 60.0, 3600.0  # s
RECENT, OF_ONE = 25, 5  # leads that are kept, of all sources and of each
CONFIRMING = 3  # recent leads as large, with which a lead is that of clocks, not of one wrong stamp
YEARS = (1971, 9000)  # of times that are stated; others are no times


class TimedValue(NamedTuple):
    """A reading or input, NaN where it is missing, with the time that its source states.

    arrived: when it came, None where that is not known. has_time: whether the source states a time; of one that does not,
    stamp is the time of arrival, and of one whose time cannot be read, None. retained: whether it may have been sent long
    before it arrived. fault: why it cannot be used, "" where it can or says itself that it is missing.
    """

    number: float
    stamp: datetime | None
    arrived: datetime | None = None
    has_time: bool = True
    retained: bool = False
    fault: str = ""


class Values:
    """Rows of a watch from the latest values of sensors and inputs.

    stale: seconds by which the stamp of a value may be before the newest one; an older one is missing (None: it counts, as
    sources that report changes alone do not renew it). max_lead, max_lag: seconds by which a stamp may be ahead of its arrival
    and behind it; beyond, the value is missing, and the stamp counts for nothing. together: seconds by which stamps of one row
    may differ, None for half the plant's dt. delay: seconds that a value usually waits until it is read. sources: where each
    name comes from, by default a source each.
    """

    def __init__(
        self,
        watch: Watch,
        stale: float | None,
        max_lead: float = MAX_LEAD,
        max_lag: float = MAX_LAG,
        *,
        together: float | None = None,
        delay: float = 0.0,
        sources: Mapping[str, str] | None = None,
    ) -> None:
        self.watch, self.plant = watch, watch.detector.plant
        self.stale = np.inf if stale is None else stale
        self.names = (*self.plant.sensor_names, *(s.name for s in self.plant.inputs))
        self.newest: datetime | None = None  # of the last row
        self.clocks = SourceClocks(max_lead, max_lag, together or self.plant.dt / 2, delay)
        self.sources = sources or {}
        self.said: set[tuple[str, str]] = set()  # what is remarked once

    def checked(self, name: str, value: TimedValue) -> TimedValue | None:
        """The value as it counts, with a stamp; None where it is no reading: without a time, and perhaps sent long ago.

        One whose time cannot be used is missing from its arrival on; of a clock that is steadily ahead of the others the time
        of arrival counts. What is wrong with values of a source is said once.
        """
        source = self.sources.get(name, name)
        if value.fault:
            self._say(name, "fault", f"{name}: {value.fault}; its value is missing")
        if value.stamp is None and (value.arrived is None or not value.has_time):
            return None
        if value.has_time:
            why = self.clocks.fault(source, value)
            if (remark := self.clocks.remark(source, value)) is not None:
                self._say(source, "clock", f"{source}: {remark}")
            if not why and not self.clocks.is_ahead(value):
                return value
            if why and value.stamp is not None:
                self._say(source, "time", f"{source}: {why}; such values are missing")
            if why and (value.retained or value.arrived is None):
                return None
            value = value._replace(number=np.nan if why else value.number, has_time=False)
        assert value.arrived is not None
        return value._replace(stamp=self.clocks.of_arrival(value.arrived))

    def row(self, values: Mapping[str, TimedValue], fresh: set[str] | None = None) -> tuple[datetime, Array, Array] | None:
        """The time stamp, y (N,) and u (m,), of which the newest value states the time; None where none is newer than the
        row before. fresh: the names whose values state it, None for all; those whose source has a time go first.
        """
        given = [v for name, v in values.items() if fresh is None or name in fresh]
        known = [v.stamp for v in given if v.has_time and v.stamp] or [v.stamp for v in given if v.stamp]
        if not known or (self.newest is not None and max(known) <= self.newest):
            return None
        self.newest = newest = max(known)
        self.clocks.follow(newest)
        numbers = np.full(len(self.names), np.nan)
        for i, name in enumerate(self.names):
            value = values.get(name)
            if value is not None and value.stamp is not None and (newest - value.stamp).total_seconds() <= self.stale:
                numbers[i] = value.number
        count = len(self.plant.sensors)
        return self.on_grid(newest), numbers[:count], numbers[count:]

    def on_grid(self, stamp: datetime) -> datetime:
        """The stamp, of a plant that holds for steps of dt only the nearest one a number of steps after the first."""
        start, dt = self.watch.clock.start or stamp, self.plant.dt
        if not self.plant.numerics.fixed_dt:
            return stamp
        return start + timedelta(seconds=round((stamp - start).total_seconds() / dt) * dt)

    def _say(self, name: str, what: str, text: str) -> None:
        if (name, what) not in self.said:
            self.said.add((name, what))
            self.watch.refused(text)


class SourceClocks:
    """The time stamps of sources against the clock of this computer, on which their values arrive.

    A lead is the seconds by which a stamp is ahead of its arrival, negative where it is behind. A stamp counts where its lead
    is at most max_lead, its lag at most max_lag, and its lead at most `tolerance` more than recent ones, unless CONFIRMING of
    these are as large: a single stamp ahead would make all later values late. Stamps behind their arrival are never ahead of
    others. With an infinite bound, for recordings that are played back, recent leads do not matter.
    """

    def __init__(self, max_lead: float, max_lag: float, tolerance: float, delay: float) -> None:
        self.max_lead, self.max_lag, self.tolerance, self.delay = max_lead, max_lag, tolerance, delay
        self.leads: deque[float] = deque(maxlen=RECENT)
        self.of: dict[str, deque[float]] = {}
        self.before: dict[str, tuple[datetime | None, datetime | None]] = {}  # stamp and arrival of the last value of each
        self.verdicts: dict[str, str] = {}  # on that value
        self.latest: datetime | None = None  # the newest stamp that counts, or of a row
        self.offset = 0.0  # s, its lead

    def fault(self, source: str, value: TimedValue) -> str:
        """Why the stamp of a value does not count, "" where it does."""
        if value.stamp is None:
            return "no time"
        if value.arrived is None:
            return ""
        this = (value.stamp, None if value.retained else value.arrived)
        before = self.before.get(source)
        if before is not None and (this == before or (value.retained and before[0] == value.stamp)):
            return self.verdicts[source]  # of another value of the same message, or read again
        self.before[source] = this
        self.verdicts[source] = why = self._fault(source, value.stamp, value)
        return why

    def _fault(self, source: str, stamp: datetime, value: TimedValue) -> str:
        assert value.arrived is not None
        lead = (stamp - value.arrived).total_seconds()
        if not value.retained:
            self.of.setdefault(source, deque(maxlen=OF_ONE)).append(lead)
        which = f"time stamp {stamp.isoformat(sep=' ', timespec='seconds')} is {seconds_in_words(abs(lead))}"
        if lead > self.max_lead:
            return f"{which} ahead of its arrival, more than max_lead = {self.max_lead:g} s"
        if not YEARS[0] <= stamp.year <= YEARS[1]:
            return f"{which} away from its arrival"
        if value.retained:
            return ""
        if -lead > self.max_lag:
            return f"{which} behind its arrival, more than max_lag = {self.max_lag:g} s (inf plays back a recording)"
        usual = nlargest(CONFIRMING, [0.0] * CONFIRMING + [*self.leads])[-1]
        self.leads.append(lead)
        if lead > usual + self.tolerance and max(self.max_lead, self.max_lag) < np.inf:
            return f"{which} ahead of its arrival, unlike those before it"
        if (self.latest is None or stamp >= self.latest) and not self.is_ahead(value):
            self.latest, self.offset = stamp, lead
        return ""

    def is_ahead(self, value: TimedValue) -> bool:
        """Whether the clock of a value whose stamp counts is ahead of the others: if its source fell silent, their values
        would be late.
        """
        if value.arrived is None or value.stamp is None or value.retained or max(self.max_lead, self.max_lag) == np.inf:
            return False
        of_most = sorted(self.leads)[len(self.leads) // 4]
        return (value.stamp - value.arrived).total_seconds() > max(of_most, 0.0) + self.tolerance

    def remark(self, source: str, value: TimedValue) -> str | None:
        """A line on the clock of a source whose last leads are all on one side, by more than the tolerance; else None."""
        leads = self.of.get(source, ())
        if len(leads) < OF_ONE:
            return None
        off = median(leads)
        beyond = self.tolerance if off > 0 else self.tolerance + self.delay
        if (
            min(math.copysign(1.0, off) * lead for lead in leads) <= beyond
            or (self.max_lead if off > 0 else self.max_lag) == np.inf
        ):
            return None
        return (
            f"its clock is {seconds_in_words(abs(off))} {'ahead' if off > 0 else 'behind'} (median of {OF_ONE} values, time "
            f"stamp against arrival){'' if off > 0 else ', or its values are late by that'}; correct it or its time zone"
        )

    def follow(self, newest: datetime) -> None:
        """Go on from the time of a row, before which no later one will be."""
        self.latest = newest if self.latest is None else max(newest, self.latest)

    def of_arrival(self, arrived: datetime) -> datetime:
        """The time, on the clocks of the sources, of what arrived: as far from its arrival as the newest stamp was."""
        return arrived + timedelta(seconds=self.offset)


def seconds_in_words(seconds: float) -> str:
    """30 s, 18 h, 10 years: a length of time to about two digits."""
    for unit, length in (("years", 31557600.0), ("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length or (unit == "h" and seconds >= length):
            return f"{seconds / length:.3g} {unit}"
    return f"{seconds:.3g} s"
