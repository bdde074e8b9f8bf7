"""What reading a log found and did, as data and in words."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.plant.log import Log

# what changes or questions the readings; the other kinds describe the log
REMARKABLE = (
    "bad", "dates", "duplicates", "future", "grid", "held", "hour missing", "input unit suspected", "inputs shifted",
    "left out", "masked", "mixed units", "no date", "nominal inputs", "order", "period", "quality", "repeat", "resolution",
    "rows left out", "short rows", "time unit suspected", "unit suspected", "zone",
)  # fmt: skip
MISREAD = (  # the times, or the values of a column, are not those of the plant
    "dates", "future", "hour missing", "input unit suspected", "time unit suspected", "unit suspected",
)  # fmt: skip
MOST_OF_A_KIND = 2


@dataclass(frozen=True)
class Finding:
    """One finding: its kind, the sensor or input ("" for the whole log), how many rows or values, and a sentence."""

    kind: str
    name: str
    count: int
    text: str

    def __str__(self) -> str:
        return self.text


class LoadedLog(NamedTuple):
    """A log as it was read: times, readings and inputs of the plant, its wall-clock start, and what was found and done.

    absent: the sensors without a column. columns: what was read of each sensor and input, with its title and unit. checked:
    whether units and regularities are among the findings, see `check_log`.
    """

    log: Log
    clock: Clock
    findings: tuple[Finding, ...]
    absent: tuple[str, ...] = ()
    columns: tuple[Source, ...] = ()
    checked: bool = False

    @property
    def suspects(self) -> tuple[str, ...]:
        """The sensors whose unit is suspected wrong."""
        return tuple(f.name for f in self.findings if f.kind == "unit suspected" and f.name)

    @property
    def misread(self) -> bool:
        """Whether times or a unit are almost surely not what they were taken for: the log cannot be used as it was read."""
        return any(f.kind in MISREAD for f in self.findings)

    @property
    def remarks(self) -> tuple[str, ...]:
        """The findings that a reader of results has to know, in words."""
        return tuple(f.text for f in self.findings if f.kind in REMARKABLE)

    @property
    def brief(self) -> tuple[str, ...]:
        """The remarks, of those on missing values of each sensor or input the first ones and the number of the others."""
        return briefly(f for f in self.findings if f.kind in REMARKABLE)

    def __str__(self) -> str:
        return "\n".join(f.text for f in self.findings)


def briefly(findings: Iterable[Finding]) -> tuple[str, ...]:
    """The texts of findings by kind, of those that many sensors may have the first ones and the number of the others."""
    texts: dict[str, list[str]] = {}
    for f in findings:
        texts.setdefault(f.kind, []).append(f.text)
    lines: list[str] = []
    for kind, every in texts.items():
        more = len(every) - MOST_OF_A_KIND if kind in ("bad", "held", "quality", "repeat", "resolution") else 0
        lines += every if more < 2 else [*every[:-more], f"and {more} more such remarks, which check-log lists"]
    return tuple(lines)


def counted(count: int, what: str) -> str:
    """A number of things, as in 1 row, 3 rows."""
    return f"{count} {what}{'s' * (count != 1)}"


def others(count: int) -> str:
    """Behind the first of so many: in how many other rows it is."""
    return f" (and in {counted(count - 1, 'other row')})" if count > 1 else ""
