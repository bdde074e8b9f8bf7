"""Lines of text, CSV with a header or JSON, as the readings and inputs of a plant."""

from __future__ import annotations

import csv
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.common.clock import Clock
from fusion_sfdia.live.address_tables import units_of
from fusion_sfdia.live.live_readings import Reader, json_value
from fusion_sfdia.logs.columns import find_sources, require_columns_of
from fusion_sfdia.logs.epochs import unix
from fusion_sfdia.logs.loaded_log import MISREAD
from fusion_sfdia.logs.log_map import MASK, PLAIN_MAP, SPREAD, LogMap
from fusion_sfdia.logs.mask import COMPARISONS, mask_titles
from fusion_sfdia.logs.numbers import Numbers, good_codes
from fusion_sfdia.logs.overview import suspected_times
from fusion_sfdia.logs.problems import Problems
from fusion_sfdia.logs.ragged import RECENT, is_cut
from fusion_sfdia.logs.single_rows import RowReader
from fusion_sfdia.logs.time_order import HOUR, places_changing
from fusion_sfdia.logs.times import Expected, Times
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

ROWS = 20  # at the beginning, by which times are judged


def lines(stream: BinaryIO, longest: int) -> Iterator[bytes | None]:
    """Each line of a stream; None in the place of one of more than `longest` bytes, of which nothing is kept."""
    while line := stream.readline(longest + 1):
        if len(line) <= longest or line.endswith(b"\n"):
            yield line
            continue
        while line and not line.endswith(b"\n"):
            line = stream.readline(longest)
        yield None


class TextRows:
    """Reads one line after another; the first tells which form they have.

    CSV: the first line, after the map's preamble, is the header, with titles as `load_log` takes them. JSON: each line is an
    object with the titles as keys, the first with all of them; null, or no key, is a missing value. Titles, numbers, times and
    units are as the LogMap states, by default the names of the plant; in a row that its mask covers all readings are missing.
    A cell that is no number is a missing value; the first of each column is said to `refused`, and at the end, see `end`, how
    many there were. Its hold, inputs and duplicates are for the Watch; order is that of a Watch, whatever the map has.
    ValueError for a map of a long format.
    absent_sensors, other_columns, nominal_inputs: as in `load_log`. The attribute `last` is the time of the row before, which a
    watch that goes on sets: of an hour that the zone of the map has twice, the one nearer to it is meant. Times of the first
    ROWS rows that are almost surely misread are said to `refused`; `now` is the present, None by the computer's clock.
    """

    def __init__(
        self,
        plant: Plant,
        log_map: LogMap = PLAIN_MAP,
        *,
        absent_sensors: bool = False,
        other_columns: bool = False,
        nominal_inputs: bool = False,
        refused: Callable[[str], None] = warnings.warn,
    ) -> None:
        require_columns_of(plant, log_map)
        if log_map.tag:
            raise ValueError("the map has a long format, which a watch cannot take: write one row for each time")
        if log_map.step or log_map.duplicates == SPREAD or any(c.time for c in log_map.columns.values()):
            raise ValueError(
                'the map states step, duplicates = "spread" or times of a column, which need the rows after: a watch takes '
                "rows as they come; write one row for each time"
            )
        self.plant, self.log_map, self.refused = plant, log_map, refused
        self.allowed = {"absent": absent_sensors, "other": other_columns, "nominal": nominal_inputs}
        self.reader: RowReader | None = None
        self.absent: tuple[str, ...] = ()  # sensors without a column
        self.lines = 0
        self.header: list[str] | None = None
        self.cells: dict[str, Reader] = {}  # how each column that feeds something is read
        self.unusable: Counter[str] = Counter()  # values of each column
        self.last: datetime | None = None  # of the rows
        self.now: datetime | None = None
        self.times: list[tuple[float, datetime | None, Any]] = []  # of the first rows: seconds, stamp, cell
        self.last_cells: deque[str] = deque(maxlen=RECENT)  # of the rows, by which a line that ends early is known
        self.compared: dict[str, float] = {}  # the last value of what each comparison of the mask compares

    def row(self, line: str, *, ended: bool = True) -> tuple[float | datetime, Array, Array] | None:
        """The time, y (N,) and u (m,) of a line, NaN where missing; None of an empty line and of a header.

        ended: whether it has its line end, without which the last line of a stream may be cut off. ValueError for a first line
        that does not fit the plant, for a line that is not like it, and for one that is cut off.
        """
        self.lines += 1
        line = line.lstrip("\ufeff")
        if self.lines <= self.log_map.preamble or not line.strip():
            return None
        if self.log_map.comment and line.lstrip().startswith(self.log_map.comment):
            return None
        if self.reader is None and self.header is None and line.lstrip().startswith("{"):
            self.reader = self._reader(list(_object(line)))
        if self.header is None and self.reader is not None:
            return self._numbers(_object(line))
        cells = self._cells(line)
        if self.header is None:
            self.header = cells
            if not self.log_map.unit_row:
                self.reader = self._reader(cells)
            return None
        if self.reader is None:
            self.reader = self._reader(self.header, cells)
            return None
        if cells == self.header:  # of a writer that began again
            return None
        if len(cells) != len(self.header):
            raise ValueError(f"{len(cells)} cells under a header of {len(self.header)}; leave a missing value's cell empty")
        if not ended and is_cut(cells[-1].strip(), list(self.last_cells)):
            raise ValueError(f"the last line, without a line end, is cut off in {shown(cells[-1])}")
        self.last_cells.append(cells[-1])
        return self._numbers(dict(zip(self.header, cells, strict=True)))

    def _reader(self, titles: Sequence[str], units: Sequence[str] = ()) -> RowReader:
        given = units or [""] * len(titles)
        problems = Problems("the first line")
        sources = find_sources(problems, titles, given, self.plant, self.log_map, **self.allowed)
        with problems.collecting("mask"):
            mask_titles("the first line", titles, sources, self.log_map)  # refuses what is no column
        problems.require_none()
        wanted, read = units_of(self.plant), {c.name for c in sources.columns}
        self.absent = tuple(name for name in self.plant.sensor_names if name not in read)
        self.cells = {c.title: Reader(wanted[c.name], c.conversion, c.numbers, c.scale) for c in sources.columns}
        return RowReader(self.plant, self.log_map, sources)

    def _numbers(self, row: dict[str, Any]) -> tuple[float | datetime, Array, Array]:
        assert self.reader is not None
        near = None if self.last is None else self.last.astimezone(UTC) + timedelta(seconds=self.plant.dt)
        try:
            seconds, stamp = self.reader.time(row, near)
        except KeyError as error:
            raise ValueError(f"no {error} among {shown(list(row))}") from error
        if stamp is not None and self.last is not None and not self.log_map.tz:
            self._summer_time_ends(stamp, self.last)
        self.last = stamp or self.last
        if len(self.times) < ROWS:
            self.times.append((seconds, stamp, row[self.reader.sources.times[0]]))
            if len(self.times) == ROWS:
                self._judge_times(self.reader)
        y, u = self._values(self.reader, row)
        if self.log_map.mask and self._is_masked(self.reader, row):
            y = np.full_like(y, np.nan)
        return seconds if stamp is None else stamp, y, u

    def _summer_time_ends(self, stamp: datetime, last: datetime) -> None:
        """Say so where stamps without a zone, which are taken as UTC, go back by an hour as local ones do."""
        back = last.timestamp() - stamp.timestamp() + self.plant.dt
        if stamp.tzinfo is UTC and abs(back - HOUR) <= min(0.6 * self.plant.dt + 1.0, 0.1 * HOUR):
            if places := places_changing(stamp.replace(tzinfo=None), back=True):
                which = f"as where summer time ends ({', '.join(places)})"
                cure = f'state the zone of the logger in a map: tz = "{places[0]}"'
                self.refused(f"line {self.lines}: an hour comes twice, {which}: {cure}")

    def _judge_times(self, reader: RowReader) -> None:
        """Say of the times of the first rows what is said of a log's."""
        seconds = np.sort([one for one, _, _ in self.times])
        stamps = [stamp for _, stamp, _ in self.times if stamp is not None]
        stated, taken, numbers = bool(self.log_map.format or reader.sources.time_unit), "s", None
        with suppress(ValueError, TypeError, OverflowError):
            plain = Numbers(self.log_map.decimal, self.log_map.thousands)
            numbers = np.array([plain.cell(cell) for _, _, cell in self.times])
            if not stated and (count := unix(numbers)) is not None:
                taken = count.name
        t = seconds - seconds[0] if stamps else seconds
        times = Times(t, Clock(min(stamps) if stamps else None), taken, numbers, taken, stated)
        for finding in suspected_times(self.plant, t, times, Expected(self.plant.dt, self.now)):
            if finding.kind in MISREAD:
                self.refused(f"the first {ROWS} rows: {finding.text}")

    def _values(self, reader: RowReader, row: dict[str, Any]) -> tuple[Array, Array]:
        """Readings (N,) and inputs (m,) of a row, NaN where a cell is missing, no number, or not of good quality."""
        y, u = np.full(len(self.plant.sensors), np.nan), np.full(len(self.plant.inputs), np.nan)
        for c in reader.sources.columns:
            number, fault = self.cells[c.title](row.get(c.title))
            if fault:
                self._unusable(c.title, row.get(c.title), fault)
            if c.quality:
                try:
                    if not good_codes([row.get(c.quality)], self.log_map.good)[0]:
                        continue
                except (ValueError, TypeError, OverflowError):
                    self._unusable(c.quality, row.get(c.quality), "no quality that `good` of the map states")
                    continue
            (u if c.is_input else y)[c.position] = number
        return y, u

    def _unusable(self, title: str, cell: Any, fault: str) -> None:
        self.unusable[title] += 1
        if self.unusable[title] == 1:
            self.refused(f"line {self.lines}, column {title}: {shown(cell)}: {fault}; its value is missing")

    def end(self) -> None:
        """Say how many values of a column could not be used, at the end of the input, where it was more than one."""
        for title, count in self.unusable.items():
            if count > 1:
                self.refused(f"column {title}: {count} values could not be used and are missing, the first one as said")

    def _is_masked(self, reader: RowReader, row: dict[str, Any]) -> bool:
        """Whether a comparison holds, in the units of the rows; a missing value compares as the one before it."""
        masked = False
        for text in self.log_map.mask:
            name, comparison, limit = MASK.fullmatch(text.strip()).groups()  # type: ignore[union-attr]
            try:
                value = reader.compared(row, name)
            except (ValueError, TypeError, OverflowError):  # missing
                value = np.nan
            if not np.isnan(value):
                self.compared[text] = value
            masked |= text in self.compared and COMPARISONS[comparison](self.compared[text], float(limit))
        return masked

    def _cells(self, line: str) -> list[str]:
        try:
            return next(csv.reader([line.rstrip("\r\n")], delimiter=self.log_map.separator, strict=True))
        except csv.Error as error:
            raise ValueError(f"not CSV ({error}): {shown(line.strip())}") from error


def _object(line: str) -> dict[str, Any]:
    try:
        found = json_value(line)
    except ValueError as error:
        raise ValueError(f"not JSON ({str(error)[:80]}): {shown(line.strip())}") from error
    if not isinstance(found, dict):
        raise ValueError(f"{shown(found)} is no JSON object; expected names and values")
    return found
