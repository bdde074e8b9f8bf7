"""Single rows of a log, as they come from a plant, to readings and inputs: the same map, without a whole log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.logs.columns import Sources, find_sources, require_columns_of
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.numbers import TRUTH, Numbers, good_codes
from fusion_sfdia.logs.problems import Problems
from fusion_sfdia.logs.times import instant
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


class RowReader(NamedTuple):
    """Rows {title: cell} of a log to times, readings and inputs in the units of a plant; made by `row_reader`.

    What needs more than one row is left to the caller: order, duplicates, hold and whether inputs act from their row on
    (log_map.inputs), as well as the mask.
    """

    plant: Plant
    log_map: LogMap
    sources: Sources

    def time(self, row: Mapping[str, Any], near: datetime | None = None) -> tuple[float, datetime | None]:
        """Return the time of a row in seconds, of a stamp since 1970, and the stamp; ValueError for what is no time.

        near: the time that is expected: a stamp of an hour that its zone has twice is the one nearer to it, or else the first.
        """
        cells = [row[title] for title in self.sources.times]
        cell = cells[0] if len(cells) == 1 else " ".join(str(c).strip() for c in cells)
        try:
            return instant(cell, self.log_map, self.sources.time_unit, near=near)
        except ValueError as error:
            raise ValueError(f"column {' '.join(self.sources.times)}: {error}") from error

    def values(self, row: Mapping[str, Any]) -> tuple[Array, Array]:
        """Return readings (N,) and inputs (m,) of a row, NaN where a cell is missing, absent, bad or not of good quality.

        ValueError that names the column for a cell that is neither a number nor missing.
        """
        y, u = np.full(len(self.plant.sensors), np.nan), np.full(len(self.plant.inputs), np.nan)
        for c in self.sources.columns:
            try:
                value = c.value(row.get(c.title))
                if c.quality and not good_codes([row.get(c.quality)], self.log_map.good)[0]:
                    continue
            except (ValueError, TypeError, OverflowError) as error:
                expected = f"a state of {list(c.numbers.states)}, a number" if c.numbers.states else "a finite number"
                raise ValueError(f"column {c.title}: {shown(row.get(c.title))}; expected {expected}, or nothing") from error
            (u if c.is_input else y)[c.position] = value
        return y, u

    def compared(self, row: Mapping[str, Any], name: str) -> float:
        """The number that a mask compares, of a sensor, an input or a column by name, in the unit of its column; NaN: missing.

        Truth values of a column that feeds nothing are 1 and 0. ValueError for a cell that is no number.
        """
        of = next((c for c in self.sources.columns if name in (c.name, c.title)), None)
        return of.logged(row.get(of.title)) if of else Numbers.of(self.log_map, TRUTH).quantity(row.get(name))[0]


def row_reader(plant: Plant, log_map: LogMap, titles: Sequence[str], *, absent_sensors: bool = False) -> RowReader:
    """Return the reader of rows with these titles; other columns are not used. ValueError where they do not fit the plant."""
    require_columns_of(plant, log_map)
    problems = Problems("the rows")
    sources = find_sources(
        problems, titles, [""] * len(titles), plant, log_map, absent=absent_sensors, other=True, nominal=False
    )
    problems.require_none()
    return RowReader(plant, log_map, sources)
