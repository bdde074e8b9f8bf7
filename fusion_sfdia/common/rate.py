"""Rates of false alarms as people state them: "1/day", "2/hour", "1e-3"."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fusion_sfdia.common.arguments import number, shown
from fusion_sfdia.common.numerals import decimal

PERIODS = {"second": 1.0, "minute": 60.0, "hour": 3600.0, "day": 86400.0, "week": 7 * 86400.0, "year": 365.25 * 86400.0}  # s
SHORT = {"s": "second", "min": "minute", "h": "hour", "d": "day"}  # other ways to write them
SAMPLE = "sample"


@dataclass(frozen=True)
class Rate:
    """So many false alarms in each sample or period; an alarm that lasts for ten samples counts ten times.

    ValueError for a count that is not positive and for an unknown period.
    """

    count: float
    per: str = SAMPLE

    def __post_init__(self) -> None:
        if not 0 < number("a rate of false alarms", self.count) < np.inf:
            raise ValueError(f"a rate of false alarms is {self.count}; expected a positive number, such as 1/day")
        if self.per not in (SAMPLE, *PERIODS):
            raise ValueError(f"a rate per {shown(self.per)}; expected one of {', '.join((SAMPLE, *PERIODS))}")

    @classmethod
    def of(cls, given: str | float | Rate) -> Rate:
        """The rate that a text ("1/day", "2/h", "1e-3") or a number (per sample) states; ValueError for anything else."""
        if isinstance(given, Rate):
            return given
        if not isinstance(given, str):
            return cls(number("a rate of false alarms", given))
        count, _, per = (part.strip() for part in given.partition("/"))
        try:
            return cls(decimal(count), SHORT.get(per, per) or SAMPLE)
        except ValueError as error:
            raise ValueError(f"the rate of false alarms is {shown(given)}; expected such as 1/day, 2/hour or 1e-3") from error

    def per_sample(self, dt: float) -> float:
        """The rate per sample where samples are dt (s) apart; ValueError for a rate of one or more in each sample."""
        found = self.count * (1.0 if self.per == SAMPLE else dt / PERIODS[self.per])
        if found >= 1:
            raise ValueError(
                f"a rate of {self} is {found:.4g} in each sample of {dt:g} s; expected less than one: choose a lower rate"
            )
        return found

    def samples(self, dt: float) -> float:
        """The number of samples of dt (s) in which one false alarm is expected."""
        return 1.0 / self.per_sample(dt)

    def same(self, per_sample: float, dt: float) -> Rate:
        """Another rate per sample in the period of this one."""
        return Rate(per_sample if self.per == SAMPLE else per_sample * PERIODS[self.per] / dt, self.per)

    def __str__(self) -> str:
        return f"{self.count:.4g}" if self.per == SAMPLE else f"{self.count:.4g}/{self.per}"


def lasting(seconds: float) -> str:
    """A duration in words: "45 s", "64 minutes", "3.0 hours", "2.1 days"."""
    for name in ("day", "hour", "minute"):
        if seconds >= 2 * PERIODS[name]:
            count = seconds / PERIODS[name]
            return f"{count:.{int(count < 10)}f} {name}s"
    return f"{seconds:.3g} s"
