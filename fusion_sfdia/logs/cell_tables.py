"""Tables of cells as they stand in a CSV file, a Parquet file or a pandas frame."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, NamedTuple

from fusion_sfdia.common.arguments import shown, some
from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.logs.columns import TIME, split_title, usual_time
from fusion_sfdia.logs.delimited import Cells, listed, read_text
from fusion_sfdia.logs.frames import as_pandas, is_frame
from fusion_sfdia.logs.kinds import ARROW, MDF, PACKED, PARQUET, TDMS, TEXT, WORKBOOK, kind_of, unpacked
from fusion_sfdia.logs.loaded_log import Finding
from fusion_sfdia.logs.log_map import PLAIN_MAP, LogMap
from fusion_sfdia.logs.plain import last_rows, plain_table
from fusion_sfdia.logs.ragged import cut_row, is_cut, rectangle
from fusion_sfdia.logs.recordings import by_time, read_channels
from fusion_sfdia.logs.workbooks import sheet_rows

AGAIN = re.compile(r"(.+?)(?: \(\d+\)|\.\d+)")  # a title that occurs once more, as `again` or pandas writes it


class Table(NamedTuple):
    """Cells of a log, before they are numbers: where they are from, titles, columns by position, and the number of each row.

    units: of the columns, from a row below the header, or "". findings: on how the file was read, and what was left out.
    short: how many cells each row had, by number, that ended before its last column.
    """

    where: str
    titles: list[str]
    columns: list[Any]
    rows: Sequence[int]
    units: list[str]
    findings: tuple[Finding, ...] = ()
    short: Mapping[int, int] = MappingProxyType({})

    def column(self, title: str) -> Any:
        return self.columns[self.titles.index(title)]

    def require_rows(self) -> None:
        """Raise ValueError for a header alone."""
        if not len(self.rows):
            gone = [f.text for f in self.findings if f.kind == "rows left out"]
            why = f" that can be used ({'; '.join(gone)})" if gone else ""
            raise ValueError(f"{self.where} has a header and no rows{why}; expected at least one reading")

    def with_cells_of(self, titles: Iterable[str]) -> Table:
        """The table without the rows that ended before one of these columns, which it cannot do without."""
        last = max((self.titles.index(title) for title in titles), default=-1)
        kept = [k for k, n in enumerate(self.rows) if self.short.get(n, last + 1) > last] if self.short else None
        if kept is None or len(kept) == len(self.rows):
            return self
        gone = [n for n in self.rows if self.short.get(n, last + 1) <= last]
        text = f"{listed(gone)} left out, which end before the column {shown(self.titles[last])}"
        columns = [[column[k] for k in kept] for column in self.columns]
        findings = (*self.findings, Finding("rows left out", "", len(gone), text))
        return self._replace(columns=columns, rows=[self.rows[k] for k in kept], findings=findings)

    def text(self, position: int) -> str:
        """A row for an error: "log.csv, row 3"."""
        return f"{self.where}, row {self.rows[position]}"


def read_table(source: Any, log_map: LogMap) -> Table:
    """Return the table of a frame or of a file, whose kind its first bytes show. ValueError naming the file.

    A file is CSV or other delimited text, Parquet, Arrow, an Excel workbook, TDMS or MDF, and may be compressed.
    """
    if is_frame(source):
        return _of_frame("the frame", as_pandas(source), log_map)
    path = Path(source)
    where, suffix = str(path), path.suffix.casefold()
    with path.open("rb") as opened:
        file: IO[bytes] = opened if opened.seekable() else io.BytesIO(opened.read())  # a pipe is read once
        kind = kind_of(file, suffix)
        if kind.name in (*PACKED, "zip"):
            file = unpacked(where, file, kind)
            kind = kind_of(file, suffix)
        if kind.name == PARQUET or suffix in (".parquet", ".pq"):
            return _of_frame(where, _parquet(where, file), log_map)
        if kind.name == ARROW:
            return _of_frame(where, _parquet(where, file, "feather"), log_map)
        if kind.name in (TDMS, MDF):
            return _of_recording(where, file, kind.name, log_map)
        if kind.name == WORKBOOK:
            return _of_rows(where, sheet_rows(where, file, log_map), log_map)
        if kind.name != TEXT:
            raise ValueError(f"{where} is {kind.name}; {kind.cure or 'unpack it'}")
        plain = plain_numbers(where, file) if log_map == PLAIN_MAP else None
        if plain is not None:
            return plain
        file.seek(0)
        return _of_rows(where, read_text(where, file.read(), log_map), log_map)


def plain_numbers(where: str, file: IO[bytes]) -> Table | None:
    """The table of a CSV file that has nothing but plain numbers below its header, see `plain_table`; else None."""
    if (found := plain_table(file)) is None:
        return None
    titles, values = found
    findings: list[Finding] = []
    if (end := last_rows(file)) and end[-1]:  # without a line end: a row that may be cut off
        last = end.pop().split(",")
        if is_cut(last[-1], [line.rpartition(",")[2] for line in end]):
            findings.append(cut_row(len(values) + 1))
            values = values[:-1]
    rows = range(2, len(values) + 2)
    return Table(where, _titles(where, titles, PLAIN_MAP), list(values.T), rows, [""] * len(titles), tuple(findings))


def _of_rows(where: str, cells: Cells, log_map: LogMap) -> Table:
    """The table of rows of a text file or sheet, the first of which is the header."""
    if not cells.rows:
        raise ValueError(f"{where} is empty; expected a header: the time and the sensors of the plant")
    findings = [*cells.findings]
    found = rectangle(where, cells, log_map, findings)
    columns = [[row[i] for _, row in found.rows] for i in range(len(found.titles))]
    rows = [n for n, _ in found.rows]
    return Table(where, _titles(where, found.titles, log_map), columns, rows, found.units, tuple(findings), found.short)


def _of_recording(where: str, file: IO[bytes], kind: str, log_map: LogMap) -> Table:
    """The channels of a TDMS or MDF file, with a row for each of their times."""
    import pandas

    titles, columns, units, findings = by_time(where, read_channels(where, file, kind, log_map), log_map)
    stamps = columns[0].dtype.kind == "M"
    times = pandas.Series(columns[0]).dt.tz_localize("UTC") if stamps else columns[0]
    rows = range(1, len(times) + 1)
    return Table(where, _titles(where, titles, log_map), [times, *columns[1:]], rows, units, tuple(findings))


def _parquet(where: str, file: IO[bytes], form: str = "parquet") -> Any:
    import pandas

    try:
        return pandas.read_feather(file) if form == "feather" else pandas.read_parquet(file, engine="pyarrow")
    except ImportError as error:
        raise MissingPackageError(
            "a Parquet log needs pyarrow, which is not installed; install fusion-sfdia[parquet], or export the log as CSV"
        ) from error
    except Exception as error:  # pyarrow raises errors of many kinds for files that are none
        raise ValueError(
            f"{where} is not a Parquet file ({shown(str(error))}); expected one, or name a CSV file .csv"
        ) from error


def _of_frame(where: str, frame: Any, log_map: LogMap) -> Table:
    """The columns of a frame, with its index where that holds the times."""
    titles = [str(title).strip() for title in frame.columns]
    columns = [frame.iloc[:, i] for i in range(len(titles))]
    named = {title for title in titles for title in (title, title.partition("[")[0].strip())}
    index = frame.index
    if not set(log_map.time) <= named and (index.dtype.kind in "mM" or index.name in log_map.time):
        titles, columns = [*titles, log_map.time[0]], [*columns, index]
    elif (
        not set(log_map.time) & named
        and usual_time(titles, log_map) is None
        and sum(bool(re.search(rf"\b{TIME}\b", t, re.I)) for t in titles) < 2
    ):
        raise ValueError(
            f"{where}: no column {log_map.time[0]!r} among {some(titles)}, and its index has the name {index.name!r}; give the "
            "column of the times (s) that name, or the index: frame.rename_axis('time')"
        )
    return Table(where, _titles(where, titles, log_map), columns, range(1, len(frame) + 1), [""] * len(titles))


def again(titles: Sequence[str], log_map: LogMap) -> list[str]:
    """Titles of which those of times that occur again are numbered: Timestamp, Timestamp (2)."""
    found: list[str] = []
    for title in titles:
        name, count = split_title(title)[0], titles.count(title)
        is_time = count > 1 and (name in log_map.time or re.fullmatch(TIME, name, re.I))
        number = sum(split_title(AGAIN.sub(r"\1", t))[0] == name for t in found) + 1 if is_time else 1
        found.append(f"{title} ({number})" if number > 1 else title)
    return found


def _titles(where: str, titles: list[str], log_map: LogMap) -> list[str]:
    titles = again(titles, log_map)
    for i, title in enumerate(titles):
        if title and title in titles[:i]:
            raise ValueError(f"{where}: the column {shown(title)} occurs twice; keep one")
    return titles
