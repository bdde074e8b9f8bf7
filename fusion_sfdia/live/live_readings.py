"""One value of a live source, a cell, a payload or a node, as a reading in the unit of the plant."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.logs.conversion import Conversion, conversion
from fusion_sfdia.logs.numbers import Numbers

MISSING = {
    "", "-", "--", "n/a", "na", "nan", "+nan", "-nan", "<na>", "nat", "nil", "none", "null", "no data", "unavailable",
    "undefined", "unknown", "offline", "disconnected", "missing",
}  # fmt: skip
COMMA = re.compile(r"[+-]?\d+,\d+(?![\d,.])")
GROUPS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}(?![\d,])")  # thousands, or three decimals
POWERS = re.compile(r"\d\d|(\^|\*\*).*(\^|\*\*)", re.DOTALL)  # of no unit that is written behind a number
INFINITE = re.compile(r"[+-]?inf(inity)?", re.I)
DIGITS = re.compile(r"[+-]?\d+", re.ASCII)
LONGEST_UNIT = 24
LARGEST = 2**64  # whole numbers from here on are none that a device measures, but a code or an overflow


PLAIN, NUMBERS = Conversion(), Numbers()


class _AmbiguousError(ValueError):
    """A comma of two meanings."""


class LiveReading(NamedTuple):
    """A number in the unit of the plant, NaN where it is missing; fault: why it cannot be used, "" where it says so itself."""

    number: float
    fault: str = ""


@dataclass(frozen=True)
class Reader:
    """How the values of a sensor or an input are read.

    unit: of the plant, None where it is not known: a unit behind a number is then passed over. conversion: of numbers without
    a unit. numbers: how they are written, and the numbers of states; a decimal comma is read in any case where it can be
    nothing else. scale: of numbers with a unit, as in a map.
    """

    unit: str | None = None
    conversion: Conversion = PLAIN
    numbers: Numbers = NUMBERS
    scale: float = 1.0

    def __call__(self, cell: Any) -> LiveReading:
        """The reading that a cell states: a number, or its text, with or without a unit. Nothing makes it raise."""
        if isinstance(cell, str):
            cell = cell.strip()
        try:
            value, unit = self._quantity(cell)
            if abs(value) >= LARGEST and (
                isinstance(cell, int | np.integer) or (isinstance(cell, str) and DIGITS.fullmatch(cell))
            ):
                raise ValueError("too large")
        except _AmbiguousError:
            return LiveReading(
                math.nan, "a comma that is a decimal mark or separates thousands; write a point, or state decimal"
            )
        except (ValueError, TypeError, ArithmeticError):
            if isinstance(cell, str) and cell.casefold() in MISSING:
                return LiveReading(math.nan)
            return LiveReading(math.nan, self._why(cell))
        if not unit or self.unit is None:
            return LiveReading(self._finite(self.conversion(value)))
        try:
            if len(unit) > LONGEST_UNIT or POWERS.search(unit):
                raise ValueError(f"{shown(unit)} is no unit")
            return LiveReading(self._finite(conversion(unit, self.unit, self.scale)(value)))
        except ValueError as error:
            return LiveReading(math.nan, str(error))

    def _quantity(self, cell: Any) -> tuple[float, str]:
        """Number and unit of a cell, as the numbers are written or, where that is a point, with a comma that is clearly one."""
        try:
            return self.numbers.quantity(cell)
        except ValueError:
            if self.numbers.decimal != "." or self.numbers.thousands or not isinstance(cell, str) or not COMMA.match(cell):
                raise
        if GROUPS.match(cell):
            raise _AmbiguousError
        return self.numbers.quantity(cell.replace(",", ".", 1))

    @staticmethod
    def _why(cell: Any) -> str:
        if isinstance(cell, bool | np.bool_):
            return "a truth value; expected a number: give the numbers of true and false as states"
        if isinstance(cell, str) and cell.isprintable() and not (any(map(str.isdigit, cell)) or INFINITE.fullmatch(cell)):
            return "no finite number; give the numbers of such texts as states"
        return f"no finite number{', but an array' if isinstance(cell, list | tuple | np.ndarray) else ''}"

    @staticmethod
    def _finite(value: float) -> float:
        return value if math.isfinite(value) else math.nan


def json_value(text: str) -> Any:
    """What a text in JSON states; ValueError for any other text, DoubleKeyError where one value of a key would be lost."""
    try:
        return json.loads(text, object_pairs_hook=_object)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        raise DoubleKeyError(f"the key {shown(next(k for k in keys if keys.count(k) > 1))} occurs twice")
    return found


class DoubleKeyError(ValueError):
    """An object of JSON with a key twice."""
