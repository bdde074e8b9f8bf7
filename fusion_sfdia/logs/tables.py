"""Tables of cells as they stand in a CSV file, a Parquet file or a pandas frame."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fusion_sfdia.core.arguments import shown, some
from fusion_sfdia.core.detector import MissingPackageError
from fusion_sfdia.logs.findings import Finding
from fusion_sfdia.logs.log_map import PLAIN_MAP, LogMap
from fusion_sfdia.logs.plain import plain_table

PARQUET = (".parquet", ".pq")


class Table(NamedTuple):
    """Cells of a log, before they are numbers: where they are from, titles, columns by position, and the number of each row.

    units: of the columns, from a row below the header, or "". findings: on how the file was read, and what was left out.
    """

    where: str
    titles: list[str]
    columns: list[Any]
    rows: Sequence[int]
    units: list[str]
    findings: tuple[Finding, ...] = ()

    def column(self, title: str) -> Any:
        return self.columns[self.titles.index(title)]

    def require_rows(self) -> None:
        """Raise ValueError for a header alone."""
        if not len(self.rows):
            raise ValueError(f"{self.where} has a header and no rows; expected at least one reading")

    def text(self, position: int) -> str:
        """A row for an error: "log.csv, row 3"."""
        return f"{self.where}, row {self.rows[position]}"


def is_frame(data: object) -> bool:
    """Whether data is a pandas frame, without importing pandas."""
    return type(data).__module__.split(".")[0] == "pandas" and hasattr(data, "columns")


def read_table(source: Any, log_map: LogMap) -> Table:
    """Return the table of a pandas frame, or of a file: Parquet by its suffix, otherwise CSV. ValueError naming the file."""
    if is_frame(source):
        return _of_frame("the frame", source, log_map)
    path = Path(source)
    if path.suffix.casefold() in PARQUET:
        return _of_frame(str(path), _parquet(path), log_map)
    plain = plain_numbers(path) if log_map == PLAIN_MAP else None
    return _of_text(path, log_map) if plain is None else plain


def plain_numbers(path: Path) -> Table | None:
    """The table of a CSV file that has nothing but plain numbers below its header, see `plain_table`; else None."""
    if (found := plain_table(path)) is None:
        return None
    titles, values = found
    return Table(str(path), _titles(str(path), titles), list(values.T), range(2, len(values) + 2), [""] * len(titles))


def _of_text(path: Path, log_map: LogMap) -> Table:
    """The rows of a CSV file; lines without any cell are left out.

    The standard reader splits them, since pandas fills short rows without a word and joins what follows a closing quote.
    """
    try:
        with path.open(encoding=log_map.encoding, newline="") as file:
            lines = io.StringIO(file.read(), newline="")
    except UnicodeError as error:
        cure = "give the encoding in a map, or export as UTF-8"
        if path.suffix.casefold() in (".xls", ".xlsx", ".gz", ".zip"):
            cure = "save a workbook as CSV, and unpack an archive"
        raise ValueError(f"{path} is not a CSV text file in {log_map.encoding} ({error}); {cure}") from error
    for _ in range(log_map.preamble):
        lines.readline()
    reader = csv.reader(lines, strict=True, delimiter=log_map.separator)
    try:
        rows = [(n, row) for n, row in enumerate(reader, start=log_map.preamble + 1) if any(c.strip() for c in row)]
    except csv.Error as error:
        raise ValueError(
            f"{path} is not a CSV text file ({error}, line {log_map.preamble + reader.line_num}); expected text as `simulate` "
            "writes it"
        ) from error
    rows = rows[: max(len(rows) - log_map.footer, 1)]
    if not rows:
        raise ValueError(f"{path} is empty; expected a header: the time and the sensors of the plant")
    if not rows[0][1][-1].strip() and not any(row[-1].strip() for _, row in rows if len(row) == len(rows[0][1])):
        width = len(rows[0][1])  # lines that end in a separator
        rows = [(n, row[:-1] if len(row) == width else row) for n, row in rows]
    titles = _titles(str(path), [c.strip() for c in rows[0][1]])
    width, below = len(titles), rows[1:]
    for i, (n, row) in enumerate(below):
        if len(row) != width:
            cure = _cure_of_width(rows[: i + 2], log_map)
            raise ValueError(f"{path}, row {n}: {len(row)} cells under a header of {width}; {cure}")
    units = [""] * width
    if log_map.unit_row and below:
        units, below = [c.strip().strip("[]") for c in below[0][1]], below[1:]
        if any(re.fullmatch(r"[+-]?\d+[.,]\d*", unit) for unit in units):
            raise ValueError(f"{path}: the row below the header holds numbers, no units; leave unit_row out of the map")
    return Table(str(path), titles, [[row[i] for _, row in below] for i in range(width)], [n for n, _ in below], units)


def _cure_of_width(rows: list[tuple[int, list[str]]], log_map: LogMap) -> str:
    """What fits rows of which the last is not as wide as the first: another separator, or lines before the header."""
    empty, (begin, header), (n, last) = "leave a missing reading's cell empty", rows[0], rows[-1]
    if len(header) > 2 or len(last) < len(header):
        return empty
    counts = [
        (log_map.separator.join(row).count(mark), -k, mark) for k, row in rows for mark in ";\t|," if mark != log_map.separator
    ]
    count, k, mark = max(counts)  # of the first row with the most of them, the header
    found = [f'separator = "{mark}"'.replace("\t", "\\t")] if count > 1 else []
    lines = (-k if found else n) - 1
    if lines >= begin:
        found.append(f"preamble = {lines}, the lines before the header")
    return f"state in a map {' and '.join(found)}, or {empty}" if found else empty


def _parquet(path: Path) -> Any:
    import pandas

    with path.open("rb"):
        pass  # an OSError that names the file
    try:
        return pandas.read_parquet(path, engine="pyarrow")
    except ImportError as error:
        raise MissingPackageError(
            "a Parquet log needs pyarrow, which is not installed; install fusion-sfdia[parquet], or export the log as CSV"
        ) from error
    except Exception as error:  # pyarrow raises errors of many kinds for files that are none
        raise ValueError(
            f"{path} is not a Parquet file ({shown(str(error))}); expected one, or name a CSV file .csv"
        ) from error


def _of_frame(where: str, frame: Any, log_map: LogMap) -> Table:
    """The columns of a frame, with its index where that holds the times."""
    titles = [str(title).strip() for title in frame.columns]
    columns = [frame.iloc[:, i] for i in range(len(titles))]
    named = {title for title in titles for title in (title, title.partition("[")[0].strip())}
    index = frame.index
    if not set(log_map.time) <= named and (index.dtype.kind in "mM" or index.name in log_map.time):
        titles, columns = [*titles, log_map.time[0]], [*columns, index]
    elif not set(log_map.time) & named:
        raise ValueError(
            f"{where}: no column {log_map.time[0]!r} among {some(titles)}, and its index has the name {index.name!r}; give the "
            "column of the times (s) that name, or the index: frame.rename_axis('time')"
        )
    return Table(where, _titles(where, titles), columns, range(1, len(frame) + 1), [""] * len(titles))


def _titles(where: str, titles: list[str]) -> list[str]:
    for i, title in enumerate(titles):
        if title and title in titles[:i]:
            raise ValueError(f"{where}: the column {shown(title)} occurs twice; keep one")
    return titles
