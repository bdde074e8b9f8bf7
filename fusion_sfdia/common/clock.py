"""Wall-clock times of a log, whose detectors count seconds."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.common.numerals import decimal


def posix(moment: datetime) -> float:
    """A moment in s since 1970; one without a time zone is taken as if it were in UTC."""
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


class Clock(NamedTuple):
    """Where the seconds t of a log begin: start, with its time zone, or None where the log has seconds alone."""

    start: datetime | None = None

    def at(self, t: float) -> str:
        """A time t (s) in words: "2026-03-01 14:20:05+01:00", or "1205 s" without a start."""
        moment = self.moment(t)
        return f"{t:.10g} s" if moment is None else stamp(moment)

    def iso(self, t: float) -> str | None:
        """A time t (s) for programs, by ISO 8601: "2026-03-01T14:20:05+01:00"; None without a start."""
        moment = self.moment(t)
        return None if moment is None else stamp(moment, "T")

    def wall(self, t: float, within: float = 0.0) -> str:
        """A time t (s) for people: "2026-03-01 14:20", "1205 s" without a start.

        With seconds where they are not 0 and `within` (s), a duration that it begins or ends, is below an hour, and with
        hundredths below a minute.
        """
        moment = self.moment(t)
        if moment is None:
            return f"{t:.10g} s"
        if within >= 60.0:
            moment = (moment + timedelta(microseconds=500_000)).replace(microsecond=0)
        if within >= 3600.0:
            moment = (moment + timedelta(seconds=30)).replace(second=0)
        hundredths = f".{moment.microsecond // 10_000:02d}" if moment.microsecond >= 10_000 else ""
        seconds = f":{moment:%S}{hundredths}" if moment.second or hundredths else ""
        return f"{moment:%Y-%m-%d %H:%M}{seconds}"

    @property
    def zone(self) -> str:
        """The zone of the clock for people: "Europe/Amsterdam", or "UTC+01:00"; "" without one."""
        if self.start is None or self.start.tzinfo is None:
            return ""
        return str(getattr(self.start.tzinfo, "key", "")) or f"UTC{self.start.isoformat()[-6:]}"

    def span(self, start: float, end: float) -> str:
        """From one time to another (s) for people: "from 2026-03-01 14:20 to 16:05", "at 2026-03-01 14:20" of one."""
        first, last = (self.wall(t, end - start) for t in (start, end))
        if start == end:
            return f"at {first}"
        same_day = self.start is not None and first.split(" ")[0] == last.split(" ")[0]
        return f"from {first} to {last.split(' ')[1] if same_day else last}"

    def moment(self, t: float) -> datetime | None:
        """A time t (s) on the wall clock, with the time zone of the start; None without a start."""
        if self.start is None or self.start.tzinfo is None:
            return None if self.start is None else self.start + timedelta(seconds=t)
        # on the clock of the zone, which may have changed in between
        return (self.start.astimezone(UTC) + timedelta(seconds=t)).astimezone(self.start.tzinfo)

    def seconds(self, moment: datetime) -> float:
        """Seconds from the start to a moment, which need not be in the same zone; both state one, or neither does."""
        if self.start is None:
            raise ValueError("a clock without a start; expected seconds in place of a time stamp")
        if moment.tzinfo is None or self.start.tzinfo is None:
            return (moment - self.start).total_seconds()
        # in UTC: the difference of two stamps of one zone is that of their clocks, which may have changed in between
        return (moment.astimezone(UTC) - self.start.astimezone(UTC)).total_seconds()


def stamp(moment: datetime, sep: str = " ") -> str:
    """A moment as text by ISO 8601, but for sep, which is there "T"; milliseconds where they are not 0."""
    return moment.isoformat(sep=sep, timespec="milliseconds" if moment.microsecond else "seconds")


def within(t: NDArray[np.float64], between: str, clock: Clock, option: str = "--healthy") -> NDArray[np.bool_]:
    """Which times (K,) s are between those of FROM..TO, seconds or of the clock; a missing one is the log's first or last.

    ValueError for another form, and where no time is between them.
    """
    start, dots, end = (part.strip() for part in between.partition(".."))
    if not dots:
        raise ValueError(
            f"{option} is {shown(between)}; expected FROM..TO, such as 0..3600 (s) or 2026-03-01T06:00..2026-03-01T14:20"
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
