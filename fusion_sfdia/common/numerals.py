"""Numbers in logs, settings and options: as people write and spreadsheets export them, not all that Python accepts.

float and int also take 1_0, which is a typing error or a name in a table of data, and the digits of other scripts.
"""

from __future__ import annotations

import math
import re
from decimal import Decimal
from numbers import Real
from typing import Any

TRUTH = {"true": "1", "false": "0"}


def decimal(text: str) -> float:
    """Return the number that a text states; ValueError unless it is written with the digits 0 to 9, or is infinity or NaN."""
    return float(_plain(text))


def integer(text: str) -> int:
    """Return the whole number that a text states; ValueError as for `decimal`."""
    return int(_plain(text))


def real(cell: Any) -> float:
    """A number, also NumPy's and Decimal; ValueError for truth values, dates and others that float would take, too."""
    if isinstance(cell, Real | Decimal) and not _is_truth(cell):
        return float(cell)
    raise ValueError("no number")


def code(cell: Any) -> str:
    """A state or a code of quality as a text that all its forms share: true, "True" and 1; 4, 4.0, "4" and "0x4"."""
    if _is_truth(cell):
        return "1" if cell else "0"
    text = cell.strip().casefold() if isinstance(cell, str) else cell
    if isinstance(text, str) and text in TRUTH:
        return TRUTH[text]
    number = number_of(text)
    if math.isnan(number):
        return str(text)
    return str(int(number)) if number == int(number) else repr(number)


def number_of(cell: Any) -> float:
    """The finite number that a code is, NaN for another one."""
    if isinstance(cell, str) and re.fullmatch(r"\s*0x[0-9a-fA-F]+\s*", cell):
        return float(int(cell, 16))
    try:
        value = decimal(cell.strip()) if isinstance(cell, str) else real(cell)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def for_json(value: Any) -> Any:
    """A value for JSON, in which infinities and NaN are null, and NumPy's scalars Python's; of dicts and lists every value."""
    if isinstance(value, dict):
        return {name: for_json(v) for name, v in value.items()}
    if isinstance(value, list | tuple):
        return [for_json(v) for v in value]
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _is_truth(cell: Any) -> bool:
    """Whether it is a truth value, Python's or NumPy's, whose class is called the same."""
    return type(cell).__name__ == "bool"


def _plain(text: str) -> str:
    if not text.isascii() or "_" in text:
        raise ValueError("expected only digits from 0 to 9")
    return text
