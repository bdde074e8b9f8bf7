"""CSV files of plain numbers, such as `simulate` writes: read a block at a time, without a copy of all cells as text."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

BLOCK = 1 << 20  # bytes
COMMA, LINE = b",\n"
ALLOWED = np.isin(np.arange(256), [*b"0123456789+-.eE,\n"])


def plain_table(path: Path) -> tuple[list[str], Array] | None:
    """Return titles and numbers (K, columns), NaN in empty cells; None for a file that needs a closer look.

    That is one with other characters below the header than those of numbers, a row of another length than the header, an empty
    row, or a cell that is no finite number: `tables` names what is wrong.
    """
    with path.open("rb") as file:
        try:
            header = next(csv.reader([file.readline().decode("utf-8-sig")], strict=True))
        except (UnicodeError, csv.Error, StopIteration):
            return None
        titles, parts, rest = [title.strip() for title in header], [], b""
        if len(titles) < 2 or not all(titles):
            return None
        while block := file.read(BLOCK) or (rest and b"\n"):  # the last line may lack its end
            whole, end, rest = (rest + block).replace(b"\r\n", b"\n").rpartition(b"\n")
            if end:
                if (rows := _rows(whole + end, len(titles))) is None:
                    return None
                parts.append(rows)
    return (titles, np.concatenate(parts)) if parts else None


def _rows(text: bytes, width: int) -> Array | None:
    """The numbers (K, width) of whole lines; None where they are anything else."""
    found = np.frombuffer(text, np.uint8)
    if not ALLOWED[found].all():
        return None
    commas = np.searchsorted(np.flatnonzero(found == COMMA), np.flatnonzero(found == LINE))
    if np.any(np.diff(commas, prepend=0) != width - 1):
        return None
    try:
        cells = [float(cell) if cell else math.nan for cell in text.decode().replace("\n", ",").split(",")[:-1]]
    except ValueError:
        return None
    values = np.array(cells).reshape(-1, width)
    return None if np.isinf(values).any() or np.isnan(values).all(axis=1).any() else values
