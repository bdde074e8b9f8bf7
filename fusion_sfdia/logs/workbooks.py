"""Excel workbooks (.xlsx, .xlsm) as rows of cells; with openpyxl, the extra `excel`."""

from __future__ import annotations

from datetime import time
from typing import IO, Any

from fusion_sfdia.common.arguments import shown, some
from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.logs.delimited import SEARCHED, Cells, has_times, is_reading
from fusion_sfdia.logs.loaded_log import Finding, counted
from fusion_sfdia.logs.log_map import LogMap

ERRORS = {"#N/A", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#NULL!"}


def sheet_rows(where: str, file: IO[bytes], log_map: LogMap) -> Cells:
    """Return the rows of a sheet from its header on: the sheet of the map, or the only one with cells, or with such a header.

    Numbers and dates are as they are, formulas as last computed. MissingPackageError without openpyxl, ValueError for a
    workbook that it does not read, and for several sheets of which the map states none.
    """
    try:
        import openpyxl
    except ImportError as error:
        raise MissingPackageError(
            "an Excel workbook needs openpyxl, which is not installed; install fusion-sfdia[excel], or save the sheet as CSV"
        ) from error
    try:
        book = openpyxl.load_workbook(file, read_only=True, data_only=True)
        sheets = {sheet.title: _cells(sheet) for sheet in book.worksheets if log_map.sheet in ("", sheet.title)}
    except Exception as error:  # openpyxl raises errors of many kinds for files that are none
        raise ValueError(
            f"{where} is an Excel workbook that is damaged ({shown(str(error))}); save it again, or the sheet as CSV"
        ) from error
    if log_map.sheet and log_map.sheet not in sheets:
        raise ValueError(f"{where} has no sheet {shown(log_map.sheet)}; its sheets are {some(book.sheetnames)}")
    filled = {title: rows for title, rows in sheets.items() if rows}
    starts = {title: _header(rows, log_map) for title, rows in filled.items()}
    if len(filled) > 1:
        with_times = [title for title, (_, found) in starts.items() if found]
        if len(with_times) != 1:
            names = [*filled]
            raise ValueError(f"{where} has the sheets {some(names)}; state the one in a map, as in sheet = {shown(names[0])}")
        filled = {title: filled[title] for title in with_times}
    if not filled:
        return Cells([], [], [])
    ((title, rows),) = filled.items()
    start, findings = starts[title][0], []
    findings.append(Finding("file", "", 0, f"read from the sheet {title!r}"))
    if start and rows[start][0] - 1 != log_map.preamble:
        text = f"the header is row {rows[start][0]}; {counted(start, 'row')} before it left out"
        findings.append(Finding("file", "", start, text))
    wrong = 0
    for _, row in rows[start:]:
        for i, cell in enumerate(row):
            if isinstance(cell, str) and cell in ERRORS:
                row[i], wrong = "", wrong + 1
    if wrong:
        findings.append(
            Finding("bad", "", wrong, f"{counted(wrong, 'cell')} with an error of Excel (#N/A and the like) taken as missing")
        )
    above = [[str(c).strip() for c in row] for _, row in rows[:start]]
    return Cells(_of_one_width(rows[start:]), above, findings)


def _cells(sheet: Any) -> list[tuple[int, list[Any]]]:
    """The rows of a sheet that have any cell, with their numbers."""
    sheet.reset_dimensions()  # some programs write wrong ones
    found = []
    for n, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        cells = ["" if c is None else c.isoformat() if isinstance(c, time) else c for c in row]
        if any(str(c).strip() for c in cells):
            found.append((n, cells))
    return found


def _header(rows: list[tuple[int, list[Any]]], log_map: LogMap) -> tuple[int, bool]:
    """The position of the header among the rows, and whether it has the titles of the times."""
    first = next((k for k, (n, _) in enumerate(rows) if n > log_map.preamble), 0)
    texts = [[str(c).strip() for c in row] for _, row in rows[first : first + SEARCHED]]
    for k, cells in enumerate(texts):
        if has_times(cells, log_map.time):
            return first + k, True
    reading = next((k for k, cells in enumerate(texts) if k and is_reading(cells) and sum(map(bool, cells)) > 1), 0)
    return first + max(reading - 1, 0), False


def _of_one_width(rows: list[tuple[int, list[Any]]]) -> list[tuple[int, list[Any]]]:
    """The rows from the first to the last titled column; a sheet has no rows that end early."""
    header = rows[0][1]
    filled = [i for i, c in enumerate(header) if str(c).strip()]
    low, high = filled[0], filled[-1] + 1
    return [(n, [*row[low:high], *[""] * (high - max(len(row), low))]) for n, row in rows]
