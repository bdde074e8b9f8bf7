"""The numbers in a log: decimal comma, thousands, texts for missing readings, and codes of quality."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.numerals import code, decimal, number_of, real
from fusion_sfdia.logs.log_map import OPC_DA, LogMap

Array = NDArray[Any]

SPACES = dict.fromkeys((0xA0, 0x2009, 0x202F), " ")  # no-break, thin: thousands in French and in ISO 31-0
APOSTROPHE = {0x2019: "'"}
MINUS = {0x2212: "-"}  # the minus sign, for the hyphen that keyboards have
UNIT_BEHIND = r"\s*((?:[^\W\d_]|[°%‰\[(]|1/).*)"
TRUTH = {"true": 1.0, "false": 0.0}  # states of what a mask compares
PLAIN = set("0123456789+-.eE")


class Quantities(NamedTuple):
    """The numbers (K,) of a column, where a bad one stands (K,), and of each unit that cells state the positions of these."""

    values: Array
    bad: Array
    units: dict[str, Array]


class NotANumberError(ValueError):
    """A cell that is neither a number nor missing: `position` in the column and the `cell`."""

    def __init__(self, position: int, cell: object) -> None:
        super().__init__(f"{cell!r} is no number")
        self.position, self.cell = position, cell


@dataclass(frozen=True)
class Numbers:
    """How the numbers of a log are written, see LogMap; `bad` are the texts and numbers of missing readings.

    states: numbers of texts and truth values, in upper and lower case alike, see Column. Truth values that none of them states
    are no numbers; a number that none of them states is one, unless they state numbers for other numbers.
    """

    decimal: str = "."
    thousands: str = ""
    bad: tuple[str | float, ...] = ()
    states: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, log_map: LogMap, states: Mapping[str, float] | None = None) -> Numbers:
        return cls(log_map.decimal, log_map.thousands, log_map.bad, states or {})

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
    def _by_code(self) -> dict[str, float]:
        return {code(state): float(number) for state, number in self.states.items()}

    @cached_property
    def _states_all(self) -> bool:
        """Whether the states are those of numbers, of which no other may occur then."""
        return any(not math.isnan(number_of(state)) for state in self.states)

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
            if self.states and (state := self._by_code.get(code(text))) is not None:
                return state, ""
            text = text.translate(MINUS)
            try:
                value = decimal(self._plain(text))
            except ValueError:
                if (match := self._with_unit.fullmatch(text)) is None:
                    raise
                value, unit = decimal(self._plain(match[1])), match[2].strip()
        elif _is_missing(cell):
            return math.nan, ""
        else:
            if self.states and (state := self._by_code.get(code(cell))) is not None:
                return state, ""
            value = real(cell)
        if math.isinf(value):
            raise ValueError("infinite")
        if value in self.bad_numbers:
            return math.nan, ""
        if self.states and self._states_all and not math.isnan(value):
            raise ValueError("no state")
        return value, unit

    def column(self, cells: Any) -> tuple[Array, Array]:
        """Return a pandas column or a sequence of cells as numbers (K,) and where a bad one stands (K,).

        NotANumberError for a cell that is neither a number nor missing, also for one with a unit.
        """
        values, bad, units = self.quantities(cells)
        if units:
            k = min(int(positions[0]) for positions in units.values())
            raise NotANumberError(k, list(cells)[k])
        return values, bad

    def quantities(self, cells: Any) -> Quantities:
        """Return a pandas column or a sequence of cells as numbers, with the units behind them; NotANumberError."""
        kind = getattr(getattr(cells, "dtype", None), "kind", "O")
        if kind == "b" or self.states:
            return self._cell_by_cell(list(cells))
        units: dict[str, Array] = {}
        if kind in "iuf":
            to_numpy = getattr(cells, "to_numpy", None)
            # a frame keeps its own; an array has been read for this
            values = np.array(to_numpy(dtype=float, na_value=np.nan)) if to_numpy else np.asarray(cells, dtype=float)
            if (infinite := np.isinf(values)).any():
                raise NotANumberError(int(np.argmax(infinite)), float(values[np.argmax(infinite)]))
        else:
            cells = list(cells)
            unit, plain = "", _as_floats(cells, self.decimal)
            if plain is None:
                unit, plain = self._in_one_unit(cells)
            if plain is None:
                return self._cell_by_cell(cells)
            values = plain
            if unit:
                units = {unit: np.flatnonzero(~np.isnan(values))}
        bad = np.isin(values, list(self.bad_numbers)) if self.bad_numbers else np.zeros(values.shape, dtype=bool)
        values[bad] = np.nan
        return Quantities(values, bad, units)

    def _in_one_unit(self, cells: Sequence[Any]) -> tuple[str, Array | None]:
        """The one unit behind all cells that are not empty, and their numbers (K,); None where they need a closer look."""
        first = next((c for c in cells if c), "")
        try:
            unit = self.quantity(first)[1] if isinstance(first, str) else ""
        except ValueError:
            return "", None
        if not unit or (match := self._with_unit.fullmatch(first.strip().translate(MINUS))) is None:
            return "", None
        behind = first.lstrip()[match.end(1) :]
        if not all(isinstance(c, str) and (not c or (c.endswith(behind) and len(c) > len(behind))) for c in cells):
            return "", None
        return unit, _as_floats([c.removesuffix(behind) for c in cells], self.decimal)

    def _cell_by_cell(self, cells: Sequence[Any]) -> Quantities:
        values = np.empty(len(cells))
        bad = np.zeros(len(cells), dtype=bool)
        units: dict[str, list[int]] = {}
        known: dict[str, tuple[float, str, bool]] = {}  # texts often repeat
        for k, c in enumerate(cells):
            found = known.get(c) if isinstance(c, str) else None
            if found is None:
                try:
                    value, unit = self.quantity(c)
                except (ValueError, TypeError, OverflowError) as error:
                    raise NotANumberError(k, c) from error
                found = value, unit, math.isnan(value) and not _is_missing(c)
                if isinstance(c, str):
                    known[c] = found
            values[k], unit, bad[k] = found
            if unit:
                units.setdefault(unit, []).append(k)
        return Quantities(values, bad, {unit: np.array(positions) for unit, positions in units.items()})

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


def good_codes(codes: Any, good: str | tuple[str | float, ...]) -> Array:
    """Whether each quality code (K,) marks a good value.

    Of "opc-da" the bits 7 and 6 of a code are both set, of "opc-ua" the bits 31 and 30 are both 0 (OPC DA 3.00, 6.8; OPC UA
    Part 4, 7.39); their texts begin with "Good". A list states the codes themselves, in any form, see `code`. NotANumberError
    for a code that is neither.
    """
    cells = list(codes)
    verdicts: dict[Any, bool] = {}
    stated = frozenset(code(g) for g in good) if not isinstance(good, str) else frozenset()
    for k, c in enumerate(cells):
        key = c.strip().casefold() if isinstance(c, str) else (type(c) is bool or isinstance(c, np.bool_), c)
        if key not in verdicts:
            try:
                verdicts[key] = code(c) in stated and not _is_missing(c) if stated else _is_good(c, good)
            except (ValueError, TypeError, OverflowError) as error:
                raise NotANumberError(k, c) from error
        cells[k] = verdicts[key]
    return np.array(cells, dtype=bool)


def _is_good(cell: Any, good: str | tuple[str | float, ...]) -> bool:
    """Whether a code is good as OPC has it; ValueError for one that it does not have."""
    if _is_missing(cell):
        return False
    text = str(cell).strip().casefold()
    if text.startswith(("good", "bad", "uncertain")):
        return text.startswith("good")
    value = number_of(cell)
    if not good or not value == int(value) or (value < 0 and good == OPC_DA):
        raise ValueError("no quality")
    return int(value) & 0xC0 == 0xC0 if good == OPC_DA else int(value) >> 30 & 0b11 == 0  # "opc-ua"
