"""Wall-clock times of a log, whose detectors count seconds."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import NamedTuple


class Clock(NamedTuple):
    """Where the seconds t of a log begin: start, with its time zone, or None where the log has seconds alone."""

    start: datetime | None = None

    def at(self, t: float) -> str:
        """A time t (s) in words: "2026-03-01 14:20:05+01:00", or "1205 s" without a start."""
        if self.start is None:
            return f"{t:.10g} s"
        moment = self.start + timedelta(seconds=t)
        if self.start.tzinfo is not None:  # on the clock of the zone, which may have changed in between
            moment = (self.start.astimezone(UTC) + timedelta(seconds=t)).astimezone(self.start.tzinfo)
        return moment.isoformat(sep=" ", timespec="milliseconds" if moment.microsecond else "seconds")

    def seconds(self, moment: datetime) -> float:
        """Seconds from the start to a moment, which need not be in the same zone; both state one, or neither does."""
        if self.start is None:
            raise ValueError("a clock without a start; expected seconds in place of a time stamp")
        if moment.tzinfo is None or self.start.tzinfo is None:
            return (moment - self.start).total_seconds()
        # in UTC: the difference of two stamps of one zone is that of their clocks, which may have changed in between
        return (moment.astimezone(UTC) - self.start.astimezone(UTC)).total_seconds()
