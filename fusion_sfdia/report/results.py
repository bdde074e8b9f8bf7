"""One number a row: metrics.csv, and the same rows as JSON."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.common.plain_text import cell, plain, uncell
from fusion_sfdia.common.run_statistics import Estimate

COLUMNS = (
    "scenario", "plant", "detector", "fault", "quantity", "condition", "metric",
    "value", "low", "high", "n", "published", "source",
)  # fmt: skip
NAMES = COLUMNS[: COLUMNS.index("value")]
NUMBERS = ("value", "low", "high", "published")


AT_MOST, MORE_THAN = ", at most", ", more than"  # end the source of a published upper or lower bound


@dataclass(frozen=True)
class Published:
    """A number as its authors state it, in the unit of the row that it is compared with; source names paper, table and page,
    and ends with `AT_MOST` or `MORE_THAN` where they state a bound.
    """

    value: float
    source: str

    def __post_init__(self) -> None:
        if not self.source.strip():
            raise ValueError(f"published value {self.value} has no source; name the paper, the table and the page")


@dataclass(frozen=True)
class Row:
    """One measured number: its 95 % interval [low, high] (NaN where none is stated) and the n runs or trials behind it.

    quantity: what is measured (a sensor, module, area, or "all"). condition: under which circumstances, where a scenario
    compares several (a noise level, a mismatch case, a variant of the detector); empty where there is one only.
    published, source: the number that a paper states for the same thing, in the same unit, and where; both or neither.
    """

    scenario: str
    plant: str
    detector: str
    fault: str
    quantity: str
    metric: str
    value: float
    low: float = math.nan
    high: float = math.nan
    n: int = 0
    published: float | None = None
    source: str = ""
    condition: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        if (self.published is None) != (not self.source.strip()):
            raise ValueError(
                f"row {self.scenario}, {self.metric}: published {self.published}, source {self.source!r}; give both or neither"
            )

    @property
    def columns(self) -> dict[str, str | float | int | None]:
        """The columns of metrics.csv; a number that is not stated or undefined is None."""
        named = {c: str(getattr(self, c)) for c in NAMES}
        numbers = {
            "value": _number(self.value),
            "low": _number(self.low),
            "high": _number(self.high),
            "n": int(self.n),
            "published": None if self.published is None else _number(self.published),
        }
        return {**named, **numbers, "source": self.source}

    @property
    def agrees(self) -> bool | None:
        """Whether the published value is within the interval, or, as a bound, not shown to be exceeded; None where there is no
        published value or no interval.
        """
        if self.published is None or not (math.isfinite(self.low) and math.isfinite(self.high)):
            return None
        if self.source.endswith(AT_MOST):
            return self.low <= self.published
        if self.source.endswith(MORE_THAN):
            return self.high > self.published
        return self.low <= self.published <= self.high


def row_of(
    plant: str,
    scenario: str,
    detector: str,
    fault: str,
    quantity: str,
    metric: str,
    estimate: Estimate,
    published: Published | None = None,
    *,
    condition: str = "",
) -> Row:
    """Return the row of an estimate with the published value of the same quantity, if there is one."""
    value, source = (None, "") if published is None else (published.value, published.source)
    names = (scenario, plant, detector, fault, quantity, metric)
    return Row(*names, *estimate, published=value, source=source, condition=condition)


def _number(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def rounded(row: Row, digits: int) -> Row:
    """The row with its value and interval to so many significant digits, as results are committed."""
    value, low, high = (float(f"{number:.{digits}g}") for number in (row.value, row.low, row.high))
    return replace(row, value=value, low=low, high=high)


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Write metrics.csv: numbers by their shortest exact text, an empty cell for what is not stated or undefined."""
    with atomic_write(path) as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for row in rows:
            cells = [row.columns[c] for c in COLUMNS]
            table.writerow(["" if v is None else cell(plain(v)) if isinstance(v, str) else repr(v) for v in cells])


def read_rows(path: Path) -> list[Row]:
    """Read a metrics.csv; ValueError with file and row where it is none, or where an earlier version wrote it."""
    with path.open(encoding="utf-8", newline="") as file:
        lines = list(csv.reader(file))
    header = tuple(lines[0]) if lines else ()
    if header == tuple(c for c in COLUMNS if c != "condition"):
        raise ValueError(f"{path} was written by an earlier version: it has no column condition; run the scenarios again")
    if header != COLUMNS:
        raise ValueError(f"{path} is no metrics file; expected the columns {', '.join(COLUMNS)}")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            cells = dict(zip(COLUMNS, line, strict=True))
            names: dict[str, Any] = {c: uncell(cells[c]) for c in NAMES}
            value, low, high = (float(cells[c] or "nan") for c in ("value", "low", "high"))
            published = float(cells["published"]) if cells["published"] else None
            numbers: dict[str, Any] = {"value": value, "low": low, "high": high, "n": int(cells["n"]), "published": published}
            rows.append(Row(**names, **numbers, source=uncell(cells["source"])))
        except ValueError as error:
            raise ValueError(f"{path}, row {number}: {error}; write it with write_rows") from error
    return rows


def as_json(rows: Sequence[Row]) -> str:
    """Return the rows as a JSON array of objects; null for what is not stated or undefined, "inf" and "-inf" as text."""
    table = [{c: str(v) if isinstance(v, float) and math.isinf(v) else v for c, v in row.columns.items()} for row in rows]
    return json.dumps(table, indent=2, allow_nan=False)
