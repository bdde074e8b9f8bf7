"""Rows of cells brought to the width of their header: rows of units, headers again, rows too short, too wide or cut off."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

from fusion_sfdia.common.arguments import some
from fusion_sfdia.common.unit_texts import is_unknown
from fusion_sfdia.logs.delimited import Cells, Row, bare, is_reading, listed, too_many
from fusion_sfdia.logs.loaded_log import Finding
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.plain import few_of

NUMBER = re.compile(r"[+-]?(\d*)(?:[.,](\d*))?(?:[eE]([+-]?\d*))?")
PROCESSING = {"Avg", "Max", "Med", "Min", "Smp", "Std", "Tot"}  # of a TOA5 header; pint takes Min for mega-inches
MOST_TEXT_ROWS = 5
FULL_DIGITS = 10  # decimals of numbers in full
RECENT = 200  # rows with which a last cell is compared
SAMPLED = 500  # rows that show what is usual in a column


class Rectangle(NamedTuple):
    """Titles and units of the columns, the rows of that width, and how many cells each row had that ended early, by number."""

    titles: list[str]
    units: list[str]
    rows: list[Row]
    short: dict[int, int]


def rectangle(where: str, cells: Cells, log_map: LogMap, findings: list[Finding]) -> Rectangle:
    """Bring the rows below a header, the first of them, to its width; what is left out is counted among the findings.

    What stood before the header is left out below it, too: a logger may write it again. ValueError where too many do not fit.
    """
    rows = cells.rows[: max(len(cells.rows) - log_map.footer, 1)]
    rows = _without_last_separator(rows)
    titles, below = [_text(c) for c in rows[0][1]], rows[1:]
    width = len(titles)
    times = [i for i, title in enumerate(titles) if title in log_map.time or bare(title) in log_map.time]
    time = times[0] if times else 0
    units, below, extra = _units(where, titles, time, cells.above, below, log_map, findings)
    below = _without_headers(where, titles, [*cells.above, *extra], below, log_map, findings)
    if cells.unfinished and below and not log_map.footer:
        below = _without_cut(below, width, findings)
    odd = [k for k, (_, row) in enumerate(below) if len(row) != width]
    short: dict[int, int] = {}
    if odd:
        below, short = _of_width(where, rows[0], titles, below, odd, findings, cells.separator)
    if cells.separator and (cut := _cut_numbers([row[-1] for _, row in below])):
        for k in cut:
            n, row = below[k]
            below[k], short[n] = (n, [*row[:-1], ""]), width - 1
        text = f"{listed([below[k][0] for k in cut])} with a last number that is not finished, taken as missing"
        findings.append(Finding("short rows", "", len(cut), text))
    return Rectangle(titles, units, below, short)


def is_cut(cell: str, column: Sequence[str], *, strict: bool = False) -> bool:
    """Whether the last cell of a line that may be cut off is shorter than those before it in its column.

    strict: also where that is uncertain, as of a whole number.
    """
    others = [c for c in (_text(o) for o in column[-RECENT:]) if c]
    if not cell:
        return bool(others) and len(others) == len(column[-RECENT:])
    number = NUMBER.fullmatch(cell)
    if number is None or not (number[1] or number[2]):
        return (
            bool(others)
            and cell not in others
            and (len(cell) < min(map(len, others)) or any(o.startswith(cell) for o in others))
        )
    if number[3] is not None and not number[3].strip("+-"):
        return True
    numbers = [m for m in map(NUMBER.fullmatch, others) if m and (m[1] or m[2])]
    if number[2] == "" and not any(m[2] == "" for m in numbers):
        return True
    if not numbers or len(numbers) < 3:
        return strict or (not numbers and bool(others))
    exponents = [len(m[3].strip("+-")) for m in numbers if m[3] is not None]
    if exponents and (len(number[3].strip("+-")) < min(exponents) if number[3] is not None else len(exponents) == len(numbers)):
        return True
    if number[3] is None and exponents and _value(cell) > 10 * max(_value(m[0]) for m in numbers):
        return True
    decimals = [len(m[2] or "") for m in numbers if m[3] is None] or [0]
    if len(number[2] or "") != min(decimals):
        return len(number[2] or "") < min(decimals)
    if number[2]:
        return False
    recent = [m[0] for m in numbers[-20:]]
    return strict or (cell not in recent and (len(cell) < min(map(len, recent)) or any(o.startswith(cell) for o in recent)))


def _text(cell: Any) -> str:
    return cell.strip() if isinstance(cell, str) else str(cell)


def _value(cell: str) -> float:
    try:
        return abs(float(cell.replace(",", ".")))
    except ValueError:
        return 0.0


def _without_last_separator(rows: list[Row]) -> list[Row]:
    """Lines that end in a separator have a last column without title and cells."""
    header = rows[0][1]
    if _text(header[-1]) or any(_text(row[-1]) for _, row in rows if len(row) == len(header)):
        return rows
    return [(n, row[:-1] if len(row) == len(header) else row) for n, row in rows]


def _units(
    where: str,
    titles: list[str],
    time: int,
    above: Sequence[Sequence[str]],
    below: list[Row],
    log_map: LogMap,
    findings: list[Finding],
) -> tuple[list[str], list[Row], list[list[str]]]:
    """The units of the columns, the rows below them, and the other lines of the header, which hold no readings."""
    units = [""] * len(titles)
    extra: list[list[str]] = []
    toa5 = bool(above) and [*above[-1][:1]] == ["TOA5"]
    if log_map.unit_row and below:
        extra.append([_text(c) for c in below[0][1]])
        units, below = [c.strip("[]") for c in extra[0]], below[1:]
        if any(re.fullmatch(r"[+-]?\d+[.,]\d*", unit) for unit in units):
            raise ValueError(f"{where}: the row below the header holds numbers, no units; leave unit_row out of the map")
    if log_map.skip_rows:
        extra += [[_text(c) for c in row] for _, row in below[: log_map.skip_rows]]
        below = below[log_map.skip_rows :]
    elif not log_map.tag:
        found = 0
        while found < min(MOST_TEXT_ROWS, len(below) - 1) and _is_text(below[found][1], time, titles):
            found += 1
        if found and found < len(below) and is_reading([_text(c) for c in below[found][1]]):
            texts = [[_text(c) for c in row] for _, row in below[:found]]
            if not extra and (toa5 or _are_units(texts[0], time)):
                units = [c.strip("[]") for c in texts[0]]
                if time < len(units):
                    units[time] = ""
                findings.append(Finding("file", "", 1, f"row {below[0][0]} read as the units of the columns"))
                numbers = [n for n, _ in below[1:found]]
            else:
                numbers = [n for n, _ in below[:found]]
            if numbers:
                text = f"{listed(numbers)} below the header, which holds no reading, left out"
                findings.append(Finding("file", "", len(numbers), text))
            extra, below = [*extra, *texts], below[found:]
    units = [*units, *[""] * (len(titles) - len(units))][: len(titles)]
    return units, below, extra


def _is_text(row: Sequence[Any], time: int, titles: Sequence[str]) -> bool:
    """Whether a row below the header is one of words or units: no time, no reading, and not the header again."""
    cells = [_text(c) for c in row]
    at = cells[time] if time < len(cells) else ""
    if any(c.isdigit() for c in at) or len(cells) != len(titles) or cells == [*titles]:
        return False
    others = [c for i, c in enumerate(cells) if c and i != time]
    return any(not c[0].isdigit() for c in others) and not any(re.fullmatch(r"[+-]?\d*[.,]?\d+", c) for c in others if c != "1")


def _are_units(cells: Sequence[str], time: int) -> bool:
    """Whether at least half of the cells are units that pint knows."""
    present = [c.strip("[]") for i, c in enumerate(cells) if c and i != time]
    known = [c for c in present if c in ("1", "-", "%") or (c not in PROCESSING and not is_unknown(c))]
    return 2 * len(known) >= len(present) and any(c not in ("1", "-") for c in known)


def _without_headers(
    where: str,
    titles: Sequence[str],
    others: Sequence[Sequence[str]],
    below: list[Row],
    log_map: LogMap,
    findings: list[Finding],
) -> list[Row]:
    """The rows without those of a header that a logger wrote again; ValueError for one with other columns."""
    marks = {cells[0] for cells in (titles, *others) if cells and cells[0] and not cells[0][0].isdigit()}
    known = {tuple(cells) for cells in others}
    looked_for = {"", *marks, *(f"{mark} " for mark in marks)}
    again: list[int] = []
    for k, (n, row) in enumerate(below):
        if row[0] not in looked_for:
            continue
        cells = [_text(c) for c in row]
        if cells == [*titles] or tuple(cells) in known or (cells[0] in marks and not _holds_times(cells, log_map)):
            again.append(k)
        elif _holds_times(cells, log_map) and not is_reading(cells):
            raise ValueError(
                f"{where}, row {n}: a second header with other columns, {some(cells)} after {some(titles)}; make a file of "
                "each part, and join them by time"
            )
    if again:
        text = f"the header again in {listed([below[k][0] for k in again])}, left out"
        findings.append(Finding("rows left out", "", len(again), text))
        gone = {*again}
        below = [row for k, row in enumerate(below) if k not in gone]
    return below


def _holds_times(cells: Sequence[str], log_map: LogMap) -> bool:
    return {*log_map.time} <= {*cells, *map(bare, cells)}


def _without_cut(below: list[Row], width: int, findings: list[Finding]) -> list[Row]:
    """The rows without a last one that is cut off: with fewer cells than the row before, or a last number that looks cut."""
    n, last = below[-1]
    before = below[-1 - RECENT : -1]
    same = [row[len(last) - 1] for _, row in before if len(row) >= len(last)]
    usual = len(before[-1][1]) if before else width
    if len(last) < usual or is_cut(_text(last[-1]), [str(c) for c in same]):
        findings.append(cut_row(n))
        return below[:-1]
    return below


def _cut_numbers(column: list[str]) -> list[int]:
    """The positions in a last column of numbers that a line end has cut off: a few with fewer digits than all others have.

    That is certain where all have as many decimals, or about sixteen digits, or as many digits and no decimals, and the shorter
    number begins one within their range, and where only a few end before or at the point; not of a column that has few values,
    as of a switch.
    """
    few = few_of(len(column))
    if not few or 2 * len({*column}) <= len(column):
        return []
    if any("," in c for c in column[:20]):
        column = [c.replace(",", ".") for c in column]
    ends = [len(c) - 1 - c.rfind(".") if "." in c else -len(c.lstrip("+-")) for c in column]
    usual, count = Counter(ends).most_common(1)[0]
    if len(column) - count > few:  # numbers without the zeros at their end, or in full
        digits = 2 * sorted(ends)[len(ends) // 2] // 3
        usual = digits if digits >= FULL_DIGITS else 1
    found = [k for k, digits in enumerate(ends) if column[k] and (digits < usual if usual > 0 else 0 > digits > usual)]
    if not 0 < len(found) <= few:
        return []
    found = [k for k in found if _is_number(column[k]) and "e" not in column[k].casefold()]
    if usual < 0:
        others = [_value(c) for c in column if len(c.lstrip("+-")) == -usual]
        margin = 0.5 * (max(others) - min(others))
        tens = {k: 10.0 ** (-usual - len(column[k].lstrip("+-"))) for k in found}
        found = [
            k
            for k in found
            if _value(column[k]) * tens[k] <= max(others) + margin and (_value(column[k]) + 1) * tens[k] > min(others) - margin
        ]
    return found


def _of_width(
    where: str,
    header: Row,
    titles: list[str],
    below: list[Row],
    odd: list[int],
    findings: list[Finding],
    separator: str,
) -> tuple[list[Row], dict[int, int]]:
    """The rows with as many cells as the header: of a shorter one the last are missing, of a wider one empty ones are dropped.

    A row of another width than most is kept only where its cells fit their columns and fit no others: a cell that got lost
    or was added within the row moves those behind it. ValueError where so many rows do not fit that the map must be wrong.
    """
    width = len(titles)
    usual = Counter(len(row) for _, row in below).most_common(1)[0][0]
    if usual > width and not all(_is_wide_by_empty(row, width) for _, row in below if len(row) == usual):
        usual = width
    columns = _Columns([row for _, row in below if len(row) in (width, usual)], width)
    short: dict[int, int] = {}
    unfit: list[int] = []
    for k in odd:
        n, row = below[k]
        if len(row) != usual and not columns.fit(row):
            if 0 < k < len(below) - 1 and k - 1 not in unfit and _goes_on(below[k - 1][1], row, usual):
                unfit.append(k - 1)
            unfit.append(k)
            continue
        if len(row) < width:
            short[n] = len(row)
            last = _text(row[-1])
            if len(row) != usual and is_cut(last, columns.texts[len(row) - 1], strict=True):
                row, short[n] = row[:-1], len(row) - 1
        below[k] = (n, [*row, *[""] * (width - len(row))][:width])
    if unfit:
        n, row = below[unfit[0]]
        if too_many(len(unfit), len(below)):
            more = f" (as {len(unfit) - 1} more rows)" if len(unfit) > 1 else ""
            cure = _cure_of_width([header, *below[: unfit[0] + 1]], width, separator)
            raise ValueError(f"{where}, row {n}: {len(row)} cells under a header of {width}{more}; {cure}")
        text = f"{listed([below[k][0] for k in unfit])} left out, whose cells do not fit the {width} columns"
        findings.append(Finding("rows left out", "", len(unfit), text))
        gone = {*unfit}
        below = [row for k, row in enumerate(below) if k not in gone]
    if short:
        ends = sorted({*short.values()})
        lacking = some([title or "''" for title in titles[ends[0] :]])
        text = f"{listed([*short])} end early: no cells of {lacking} there, taken as missing"
        if len(short) == 1:
            text = text.replace(" end early", " ends early", 1)
        findings.append(Finding("short rows", "", len(short), text))
    return below, short


def _goes_on(row: Sequence[Any], after: Sequence[Any], width: int) -> bool:
    """Whether a row was cut in two within a number: the next one begins with digits, and both together have the width."""
    return len(row) + len(after) - 1 == width and bool(re.fullmatch(r"\d+[.,]?\d*", _text(after[0])))


def cut_row(number: int) -> Finding:
    """The finding on a last row that is cut off."""
    return Finding("rows left out", "", 1, f"the last row ({number}), which is cut off, left out")


def _cure_of_width(rows: list[Row], width: int, separator: str) -> str:
    """What fits rows of which the last is not as wide as the first: another separator, or lines before the header."""
    empty, (begin, header), (n, last) = "leave a missing reading's cell empty", rows[0], rows[-1]
    if len(last) > width > 2:
        if separator == ",":
            cure = "where these are decimal commas, export with another separator or with decimal points"
            return f"{cure}; else give each column a title"
        return "give each column a title, or put texts that hold the separator in quotes"
    if len(header) > 2 or len(last) < len(header) or not separator:
        return empty
    counts = [(separator.join(row).count(mark), -k, mark) for k, row in rows for mark in ";\t|," if mark != separator]
    count, k, mark = max(counts)  # of the first row with the most of them, the header
    found = [f'separator = "{mark}"'.replace("\t", "\\t")] if count > 1 else []
    lines = (-k if found else n) - 1
    if lines >= begin:
        found.append(f"preamble = {lines}, the lines before the header")
    return f"state in a map {' and '.join(found)}, or {empty}" if found else empty


def _is_wide_by_empty(row: Sequence[Any], width: int) -> bool:
    return not any(_text(c) for c in row[width:])


class _Columns:
    """What is usual in each column: shapes of its texts, range of its numbers."""

    def __init__(self, rows: Sequence[Sequence[Any]], width: int) -> None:
        self.width = width
        self.rows = rows[:: max(1, len(rows) // SAMPLED)]

    @cached_property
    def texts(self) -> list[list[str]]:
        return [[_text(row[i]) for row in self.rows if len(row) > i] for i in range(self.width)]

    @cached_property
    def ranges(self) -> list[tuple[float, float] | None]:
        found: list[tuple[float, float] | None] = []
        for column in self.texts:
            numbers = sorted(float(c.replace(",", ".")) for c in column if _is_number(c))
            if not numbers:
                found.append(None)
                continue
            low, high = numbers[0], numbers[-1]
            margin = 0.5 * (high - low) or 0.1 * abs(high) or 1e-3
            found.append((low - margin, high + margin))
        return found

    @cached_property
    def shapes(self) -> list[set[str]]:
        return [{_shape(c) for c in column if c} for column in self.texts]

    def fit(self, row: Sequence[Any]) -> bool:
        """Whether the cells of a row that is too short or wide fit the columns from the first on, and in no other place."""
        cells = [_text(c) for c in row]
        here = (cells + [""] * self.width)[: self.width]
        if len(cells) < 2 or not _is_wide_by_empty(cells, self.width) or not self._are_in_place(here):
            return False
        return not any(other != here and self._are_in_place(other) for other in self._others(cells))

    def _others(self, cells: list[str]) -> Iterator[list[str]]:
        """The rows of the right width that would have become these cells by losing, or gaining, empty ones in a place."""
        off = self.width - len(cells)
        for p in range(len(cells) + min(off, 0)):
            if off > 0:
                yield [*cells[:p], *[""] * off, *cells[p:]]
            elif not any(cells[p : p - off]):
                yield [*cells[:p], *cells[p - off :]]

    def _are_in_place(self, cells: Sequence[str]) -> bool:
        for cell, limits, shapes in zip(cells, self.ranges, self.shapes, strict=True):
            if not cell:
                continue
            if _is_number(cell):
                if limits is None or not limits[0] <= float(cell.replace(",", ".")) <= limits[1]:
                    return False
            elif _shape(cell) not in shapes:
                return False
        return True


def _is_number(cell: str) -> bool:
    return bool((match := NUMBER.fullmatch(cell)) and (match[1] or match[2]) and (match[3] is None or match[3].strip("+-")))


def _shape(cell: str) -> str:
    return re.sub(r"\d+", "9", cell)
