"""CSV files of plain numbers, such as `simulate` writes: read a block at a time, without a copy of all cells as text.

Numbers between commas are, in brackets, an array in JSON, with null for an empty cell: compiled code of orjson reads and
writes it, each number as the shortest text that is read back to the same bits.
"""

from __future__ import annotations

import csv
import io
import math
from typing import IO, Any

import numpy as np
import orjson
from numpy.typing import NDArray

Array = NDArray[Any]

BLOCK = 1 << 18  # bytes, of which the numbers take twenty times as much memory while they are read
TAIL = 1 << 15  # bytes that show how the last cells are written
LONGEST = 1_000_000  # bytes of a line
ALLOWED = b"0123456789+-.eE,\n"
TENS = np.array([float(f"1e{k}") for k in range(23)])  # all powers of ten that are floating-point numbers


def plain_table(file: IO[bytes]) -> tuple[list[str], Array] | None:
    """Return titles and numbers (K, columns), NaN in empty cells, each column of them in one piece; None for a file that needs
    a closer look.

    That is one with other characters below the header than those of numbers, a row of another length than the header, an empty
    row, or a cell that is no finite number: `tables` names what is wrong.
    """
    try:
        header = next(csv.reader([file.readline(LONGEST).decode("utf-8-sig")], strict=True))
    except (UnicodeError, csv.Error, StopIteration):
        return None
    titles, rest, count = [title.strip() for title in header], b"", 0
    if len(titles) < 2 or not all(titles):
        return None
    columns = np.empty((len(titles), _lines_below(file)))
    while block := file.read(BLOCK) or (rest and b"\n"):  # the last line may lack its end
        text = rest + block
        whole, end, rest = (text.replace(b"\r\n", b"\n") if b"\r" in text else text).rpartition(b"\n")
        if end:
            if (rows := _rows(whole, len(titles))) is None:
                return None
            columns[:, count : count + len(rows)] = rows.T
            count += len(rows)
        elif len(rest) > LONGEST:
            return None
    return (titles, columns[:, :count].T) if count and not _some_are_short(columns[-1, :count]) else None


def last_rows(file: IO[bytes]) -> list[str]:
    """The last lines below the header of such a file, the last of them "" where it has its end."""
    size = file.seek(0, io.SEEK_END)
    file.seek(max(size - TAIL, 0))
    return file.read().decode("ascii", "replace").replace("\r\n", "\n").split("\n")[1:]


def plain_lines(values: Array) -> list[str]:
    """The rows (K, columns) of numbers as lines, NaN as empty cells."""
    if np.isinf(values).any():  # not in JSON
        return [",".join(map(repr, row)).replace("nan", "") for row in values.tolist()]
    text = orjson.dumps(np.ascontiguousarray(values), option=orjson.OPT_SERIALIZE_NUMPY).decode()
    if np.isnan(values).any():
        text = text.replace("null", "")
    return text[2:-2].split("],[") if len(values) else []


def shortened(values: Array, digits: int) -> Array:
    """The values to so many significant digits, at most 22 of them behind the point.

    A whole number times or over a power of ten, both exact, is the nearest to its decimal, so that it is written in few digits.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        exponent = np.floor(np.log10(np.abs(values)))
    places = digits - 1 - np.where(np.isfinite(exponent), exponent, 0.0).astype(int)
    power = TENS[np.minimum(np.abs(places), TENS.size - 1)]
    found: Array = np.where(places < 0, np.rint(values / power) * power, np.rint(values * power) / power)
    return found


def _lines_below(file: IO[bytes]) -> int:
    """The number of lines from where a file is open on, at most one too many."""
    here, count = file.tell(), 1
    while block := file.read(BLOCK):
        count += block.count(b"\n")
    file.seek(here)
    return count


def _rows(lines: bytes, width: int) -> Array | None:
    """The numbers (K, width) of whole lines; None where they are anything else."""
    if lines.translate(None, ALLOWED) or not _of_width(lines, width):
        return None
    try:
        values = np.array(_cells(lines.replace(b"\n", b",")), dtype=float).reshape(-1, width)
    except ValueError:
        return None
    return None if np.isinf(values).any() or np.isnan(values).all(axis=1).any() else values


def _of_width(lines: bytes, width: int) -> bool:
    """Whether each line has so many cells, the last with as many decimals: each width-th mark between cells ends a line."""
    text = np.frombuffer(lines, np.uint8)
    newline = text == ord("\n")
    ends = newline[(text == ord(",")) | newline]
    rows = (ends.size + 1) // width
    if rows * width != ends.size + 1 or not ends[width - 1 :: width].all() or int(ends.sum()) != rows - 1:
        return False
    last = lines.partition(b"\n")[0].rpartition(b",")[2].rpartition(b".")
    # a few with fewer decimals than the first may be cut off
    at = np.append(np.flatnonzero(newline), text.size) - len(last[2]) - 1
    odd = np.count_nonzero(text[at] != ord(".")) if last[1] else 0
    return not 0 < odd <= few_of(rows)


def few_of(rows: int) -> int:
    """The most rows that are taken as damaged where all others are alike; 0 where these are too few to tell."""
    return max(3, rows // 1000) if rows >= 20 else 0


def _some_are_short(column: Array) -> bool:
    """Whether a few of the last numbers have at most 6 decimals while all others have more: they may be cut off."""
    short = int(np.count_nonzero(np.round(column, 6) == column))
    return 0 < short <= few_of(column.size) and column.size > short


def _cells(text: bytes) -> list[float | None]:
    """The numbers between commas, None or NaN in empty cells; ValueError where a cell is no number."""
    array = b"[" + text + b"]"
    # of three commas in a row, the first pass sees two: hence a second
    if b",," in array or array.startswith(b"[,") or array.endswith(b",]"):
        array = array.replace(b",,", b",null,").replace(b",,", b",null,").replace(b"[,", b"[null,").replace(b",]", b",null]")
    try:
        found: list[float | None] = orjson.loads(array)
        return found
    except orjson.JSONDecodeError:  # numbers such as +1, .5 and 007 are not in JSON
        return [float(cell) if cell else math.nan for cell in text.decode().split(",")]
