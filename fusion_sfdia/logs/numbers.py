"""The numbers in a log: decimal comma, thousands, texts for missing readings, and codes of quality."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.numerals import decimal
from fusion_sfdia.logs.log_map import OPC_DA, LogMap

Array = NDArray[Any]

SPACES = dict.fromkeys((0xA0, 0x2009, 0x202F), " ")  # no-break, thin: thousands in French and in ISO 31-0
APOSTROPHE = {0x2019: "'"}
MINUS = {0x2212: "-"}  # the minus sign, for the hyphen that keyboards have
UNIT_BEHIND = r"\s*((?:[^\W\d_]|[°%‰\[(]|1/).*)"
PLAIN = set("0123456789+-.eE")


class NotANumberError(ValueError):
    """A cell that is neither a number nor missing: `position` in the column and the `cell`."""

    def __init__(self, position: int, cell: object) -> None:
        super().__init__(f"{cell!r} is no number")
        self.position, self.cell = position, cell


@dataclass(frozen=True)
class Numbers:
    """How the numbers of a log are written, see LogMap; `bad` are the texts and numbers of missing readings."""

    decimal: str = "."
    thousands: str = ""
    bad: tuple[str | float, ...] = ()

    @classmethod
    def of(cls, log_map: LogMap) -> Numbers:
        return cls(log_map.decimal, log_map.thousands, log_map.bad)

    @cached_property
    def bad_texts(self) -> frozenset[str]:
        return frozenset(b.strip().casefold() for b in self.bad if isinstance(b, str))

    @cached_property
    def bad_numbers(self) -> frozenset[float]:
        found = set()
        for b in self.bad:
            with suppress(ValueError):
                found.add(decimal(b) if isinstance(b, str) else float(b))
        return frozenset(found)

    @cached_property
    def _with_unit(self) -> re.Pattern[str]:
        spaces = "".join(map(chr, SPACES)) if self.thousands == " " else ""
        marks = re.escape(f"{self.decimal}{self.thousands}{spaces}")
        return re.compile(rf"([+-]?[{marks}]?\d(?:[\d{marks}]*\d)?\.?(?:[eE][+-]?\d+)?){UNIT_BEHIND}", re.DOTALL)

    def cell(self, cell: Any) -> float:
        """The number of a cell, NaN where it is missing; ValueError for anything else, also for infinity and with a unit."""
        value, unit = self.quantity(cell)
        if unit:
            raise ValueError(f"a number with a unit, {unit!r}")
        return value

    def quantity(self, cell: Any) -> tuple[float, str]:
        """The number of a cell and the text of the unit behind it, "" without one, as in "23.5 degC" and "12%".

        NaN where the cell is missing. ValueError for anything else, also for infinity. Whether the text is a unit, is for
        `conversion` to say.
        """
        unit = ""
        if isinstance(cell, str):
            text = cell.strip()
            if not text or text.casefold() in self.bad_texts:
                return math.nan, ""
            text = text.translate(MINUS)
            try:
                value = decimal(self._plain(text))
            except ValueError:
                if (match := self._with_unit.fullmatch(text)) is None:
                    raise
                value, unit = decimal(self._plain(match[1])), match[2]
        elif _is_missing(cell):
            return math.nan, ""
        else:
            value = _real(cell)
        if math.isinf(value):
            raise ValueError("infinite")
        return (math.nan, "") if value in self.bad_numbers else (value, unit)

    def column(self, cells: Any) -> tuple[Array, Array]:
        """Return a pandas column or a sequence of cells as numbers (K,) and where a bad one stands (K,); NotANumberError."""
        kind = getattr(getattr(cells, "dtype", None), "kind", "O")
        if kind in "biuf":
            to_numpy = getattr(cells, "to_numpy", None)
            # a frame keeps its own; an array has been read for this
            values = np.array(to_numpy(dtype=float, na_value=np.nan)) if to_numpy else np.asarray(cells, dtype=float)
            if (infinite := np.isinf(values)).any():
                raise NotANumberError(int(np.argmax(infinite)), float(values[np.argmax(infinite)]))
        else:
            cells = list(cells)
            plain = _as_floats(cells, self.decimal)
            if plain is None:
                return self._cell_by_cell(cells)
            values = plain
        bad = np.isin(values, list(self.bad_numbers)) if self.bad_numbers else np.zeros(values.shape, dtype=bool)
        values[bad] = np.nan
        return values, bad

    def _cell_by_cell(self, cells: Sequence[Any]) -> tuple[Array, Array]:
        values = np.empty(len(cells))
        bad = np.zeros(len(cells), dtype=bool)
        for k, c in enumerate(cells):
            try:
                values[k] = self.cell(c)
            except (ValueError, TypeError, OverflowError) as error:
                raise NotANumberError(k, c) from error
            bad[k] = values[k] != values[k] and not _is_missing(c)
        return values, bad

    def _plain(self, text: str) -> str:
        """The text with a decimal point and without thousands; ValueError where either stands in the wrong place."""
        if self.decimal == "." and not self.thousands:
            return text
        if self.thousands:
            text = text.translate(SPACES if self.thousands == " " else APOSTROPHE if self.thousands == "'" else {})
            whole, mark, rest = text.partition(self.decimal)
            if self.thousands in text:
                mark_, t = mark + rest, re.escape(self.thousands)
                if not re.fullmatch(rf"[+-]?\d{{1,3}}({t}\d{{3}})+", whole) or self.thousands in mark_:
                    raise ValueError("thousands stand in the wrong place")
                text = whole.replace(self.thousands, "") + mark_
        if self.decimal == ",":
            if "." in text:
                raise ValueError("a decimal point beside decimal commas")
            text = text.replace(",", ".")
        return text


def _as_floats(cells: Sequence[Any], mark: str) -> Array | None:
    """The cells (K,) at once where all are texts of plain numbers or empty; None where one of them needs a closer look."""
    try:
        if not {*"".join(cells)} <= (PLAIN if mark == "." else PLAIN - {"."} | {","}):
            return None
        values = np.array([float(c.replace(",", ".")) if c else math.nan for c in cells])
    except (TypeError, ValueError):
        return None
    return None if np.isinf(values).any() else values


def _is_missing(cell: Any) -> bool:
    if isinstance(cell, str):
        return cell.strip().casefold() in ("", "nan", "+nan", "-nan")
    return cell is None or cell != cell or type(cell).__name__ in ("NAType", "NaTType")


def _real(cell: Any) -> float:
    """A number, also NumPy's and Decimal; ValueError for dates and others that float would take, too."""
    if isinstance(cell, int | float | np.integer | np.floating | np.bool_) or type(cell).__name__ == "Decimal":
        return float(cell)
    raise ValueError("no number")


def good_codes(codes: Any, good: str | tuple[str | float, ...]) -> Array:
    """Whether each quality code (K,) marks a good value.

    Of "opc-da" the bits 7 and 6 of a code are both set, of "opc-ua" the bits 31 and 30 are both 0 (OPC DA 3.00, 6.8; OPC UA
    Part 4, 7.39); their texts begin with "Good". A list states the codes themselves. NotANumberError for a code that is
    neither.
    """
    cells = list(codes)
    verdicts: dict[Any, bool] = {}
    for k, c in enumerate(cells):
        key = c.strip().casefold() if isinstance(c, str) else c
        if key not in verdicts:
            try:
                verdicts[key] = _is_good(key, good)
            except (ValueError, TypeError, OverflowError) as error:
                raise NotANumberError(k, c) from error
        cells[k] = verdicts[key]
    return np.array(cells, dtype=bool)


def _is_good(code: Any, good: str | tuple[str | float, ...]) -> bool:
    if _is_missing(code):
        return False
    value = _integer(code)
    if good and not isinstance(good, str):
        texts = {g.strip().casefold() for g in good if isinstance(g, str)}
        return code in texts or (value is not None and value in {_integer(g) for g in good})
    if value is None:
        if not str(code).startswith(("good", "bad", "uncertain")):
            raise ValueError("no quality")
        return str(code).startswith("good")
    if not good or (value < 0 and good == OPC_DA):
        raise ValueError("no quality")
    return value & 0xC0 == 0xC0 if good == OPC_DA else value >> 30 & 0b11 == 0  # "opc-ua"


def _integer(code: Any) -> int | None:
    if isinstance(code, str):
        if re.fullmatch(r"0x[0-9a-f]+", code):
            return int(code, 16)
        return int(code) if re.fullmatch(r"\d+", code, re.ASCII) else None
    return int(_real(code)) if float(code) == int(code) else None
