"""The cells of a column as numbers in one unit, those of good quality; and what to state in a map of cells that are none."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown, some
from fusion_sfdia.logs.cell_tables import Table
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.logs.loaded_log import Finding, counted
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.numbers import TRUTH, NotANumberError, Numbers, Quantities, good_codes
from fusion_sfdia.logs.problems import CountedError
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

MOST_UNITS = 4  # in an error

MARKS = ((",", ""), (",", "."), (",", " "), (",", "'"), (".", ","), (".", " "), (".", "'"))  # decimal and thousands
ON = ("on", "true", "open", "opened", "yes", "running", "run", "enabled", "active", "high", "ein", "auf", "an", "marche")
OFF = ("off", "false", "closed", "close", "no", "stopped", "stop", "disabled", "inactive", "low", "aus", "zu", "arret")
QUALITIES = ("bad", "good", "uncertain", "ok", "questionable", "invalid", "valid", "fail", "failed", "error")
WORDS = 6  # that a message shows


def values_of(table: Table, c: Source, plant: Plant, findings: list[Finding]) -> tuple[Array, Source]:
    """The numbers (K,) of the column of a sensor or an input, and the source with the unit that they are in.

    The unit behind the numbers of the cells counts before that of title and map. Cells in several units of one dimension are
    converted to the most frequent one. CountedError for cells that are no numbers, and for a unit that does not fit the plant.
    """
    try:
        found = c.numbers.quantities(table.column(c.title))
    except NotANumberError as error:
        raise _refused(table, c.title, c.numbers, error, c, plant) from error
    _note_bad(c.title, found, findings)
    by_unit = {unit: positions for unit, positions in found.units.items() if np.isfinite(found.values[positions]).any()}
    if not by_unit:
        return found.values, c
    conversions = {}
    for unit, positions in by_unit.items():
        try:
            conversions[unit] = c.in_unit(unit)
        except ValueError as error:
            k = int(positions[0])
            cell = shown(list(table.column(c.title))[k])
            text = f"{table.text(k)}, column {c.title}: {cell}; expected a finite number, alone or with its unit: {error}"
            raise CountedError(text, positions.size) from error
    bare = _without_unit(found)
    if bare.any() and not c.unit:
        raise _mixed(table, c.title, found, bare)
    main = max(by_unit, key=lambda unit: by_unit[unit].size)
    own, values = conversions[main], found.values
    for unit, positions in [*by_unit.items(), *([(c.unit, np.flatnonzero(bare))] if bare.any() else [])]:
        given = conversions.get(unit, c.conversion)
        if given != own:
            values[positions] = (given(values[positions]) - own.offset) / own.factor
    kinds = [f"{unit} ({positions.size})" for unit, positions in by_unit.items()]
    kinds += [f"none, so {c.unit} ({int(bare.sum())})"] if bare.any() else []
    kinds += [f"{c.unit} by title or map"] if c.unit and c.conversion != own and not bare.any() else []
    if len(kinds) > 1:
        text = f"{c.title}: units behind the numbers are {', '.join(kinds)}; each cell counts in its own"
        findings.append(Finding("mixed units", c.name, int(values.size - by_unit[main].size), text))
    return values, c._replace(unit=main, conversion=own)


def cell_units(before: Sequence[Source], after: Sequence[Source]) -> list[Finding]:
    """The finding on columns whose cells state a unit that title and map do not, by unit; none without such a column."""
    units = {c.name: c.unit for c in before}
    stated = [c for c in after if c.unit != units[c.name]]
    if not stated:
        return []
    by_unit = {unit: [c.name for c in stated if c.unit == unit] for unit in dict.fromkeys(c.unit for c in stated)}
    listed = ", ".join(f"{unit} of {some(names)}" for unit, names in by_unit.items())
    return [Finding("cell unit", "", len(stated), f"units as the cells state them: {listed}")]


def compared_values(table: Table, title: str, log_map: LogMap, findings: list[Finding]) -> Array:
    """The numbers (K,) of a column that a mask compares and that feeds nothing; truth values are 1 and 0, units pass."""
    numbers = Numbers.of(log_map, TRUTH)
    try:
        found = numbers.quantities(table.column(title))
    except NotANumberError as error:
        raise _refused(table, title, numbers, error) from error
    bare = _without_unit(found)
    if len(found.units) > 1 or (found.units and bare.any()):
        raise _mixed(table, title, found, bare)
    _note_bad(title, found, findings)
    return found.values


def _without_unit(found: Quantities) -> Array:
    """Where a number states no unit (K,)."""
    bare = np.isfinite(found.values)
    for positions in found.units.values():
        bare[positions] = False
    return bare


def _mixed(table: Table, title: str, found: Quantities, bare: Array) -> CountedError:
    """The error on numbers with and without a unit, or in several, in one column, at the first of the rarest kind."""
    kinds = {unit: positions for unit, positions in found.units.items()} | {"": np.flatnonzero(bare)}
    rare = min((unit for unit, positions in kinds.items() if positions.size), key=lambda unit: kinds[unit].size)
    k, others = int(kinds[rare][0]), [unit or "none" for unit, positions in kinds.items() if unit != rare and positions.size]
    listed = ", ".join(others[:MOST_UNITS]) + (f" and {len(others) - MOST_UNITS} more" if len(others) > MOST_UNITS else "")
    stated = f"{shown(list(table.column(title))[k])} states {rare or 'no unit'}"
    return CountedError(
        f"{table.text(k)}, column {title}: {stated}, where other cells state {listed}; expected one unit: give that "
        "of numbers without one as unit in a map",
        kinds[rare].size,
    )


def _note_bad(title: str, found: Quantities, findings: list[Finding]) -> None:
    if count := int(found.bad.sum()):
        findings.append(Finding("bad", title, count, f"{title}: {counted(count, 'value')} marked as bad"))


class Quality(NamedTuple):
    """The quality of the values of a log, column by column: whether any was good, and how often which code occurred."""

    log_map: LogMap
    codes: Counter[str]
    good: list[bool]

    def apply(self, table: Table, title: str, of: str, values: Array, findings: list[Finding]) -> None:
        """Make the values missing whose quality is not good."""
        try:
            good = good_codes(table.column(title), self.log_map.good)
        except NotANumberError as error:
            raise ValueError(
                f"{table.text(error.position)}, column {title}: {shown(error.cell)} as quality; state which codes are good: "
                f'good = "opc-da", "opc-ua" or a list, in the map; the column has {_listed(_texts(table.column(title)))}'
            ) from error
        self.good.append(bool(good.any()))
        if not self.good[-1]:
            self.codes.update(_texts(table.column(title)))
        poor = ~good
        if count := int(np.sum(poor & np.isfinite(values))):
            about = f"{of}: " if of else ""
            findings.append(
                Finding("quality", of, count, f"{about}{counted(count, 'value')} not of good quality, taken as missing")
            )
        values[poor] = np.nan

    def require_good(self, where: str) -> None:
        """Raise ValueError where no value of any sensor or input with a quality was good."""
        if self.good and not any(self.good):
            good = self.log_map.good if isinstance(self.log_map.good, str) else [*self.log_map.good]
            stated = f"good = {json.dumps(good)}" if good else "texts that begin with Good"
            raise CountedError(
                f"{where}: no value is of good quality by {stated}, the quality columns have {_listed(self.codes)}; state the "
                "codes of good values as good in the map",
                sum(self.codes.values()),
            )


def _refused(
    table: Table, title: str, numbers: Numbers, error: NotANumberError, c: Source | None = None, plant: Plant | None = None
) -> CountedError:
    """The error on cells that are no numbers, with what occurs and what to state of it in a map."""
    cells = list(table.column(title))
    odd = [cell for cell in cells if not _is_number(numbers, cell)]
    texts = _texts(odd)
    expected = "a finite number, or nothing where the reading is missing"
    cure = ""
    if numbers.states and c is not None:
        expected = f"a number or a state that states has, {some([str(s) for s in numbers.states])}"
        cure = "add its number to states, or it to bad where it marks a missing value"
    elif marks := _other_marks(numbers, [cell for cell in odd if re.search(r"\d", str(cell))]):
        words = sorted(text for text in texts if not re.search(r"\d", text))
        bad = f", and bad = {json.dumps(words, ensure_ascii=False)} where such texts mark missing readings" if words else ""
        cure = f"state in a map {' or '.join(marks)}{bad}"
    elif all(isinstance(cell, bool | np.bool_) or not re.search(r"\d", str(cell)) for cell in odd):
        bad = f"bad = {json.dumps(sorted(texts), ensure_ascii=False)}"
        alone = len(odd) == sum(str(cell).strip() != "" for cell in cells if cell is not None and cell == cell)
        if alone and all(text.casefold() in QUALITIES for text in texts):
            cure = (
                f"this is a status, not numbers: state {bad} in a map if such texts stand where readings are missing; name the "
                "column of the values if this is that of their quality; or leave the column out"
            )
        elif c is None or plant is None or not (c.is_input or alone):
            cure = f"state {bad} in a map where such a text marks a missing reading"
        else:
            line = _states_line(c, plant, texts)
            cure = f"state numbers for its states in a map, as in {line} with yours in {c.unit or c.wanted}"
            cure += "" if alone else f", or {bad} and hold where they mark a missing value"
    occurring = f"; of such cells there are {_listed(texts)}" if len(odd) > 1 else ""
    return CountedError(
        f"{table.text(error.position)}, column {title}: {shown(error.cell)}; expected {expected}{occurring}"
        f"{'; ' if cure else ''}{cure}",
        len(odd),
    )


def _is_number(numbers: Numbers, cell: Any) -> bool:
    try:
        numbers.quantity(cell)
    except (ValueError, TypeError, OverflowError):
        return False
    return True


def _other_marks(numbers: Numbers, odd: Sequence[Any]) -> list[str]:
    """The marks of decimals and thousands with which all cells are numbers that are none as the map has it."""
    found: list[str] = []
    used: set[tuple[float, ...]] = set()
    for decimal, thousands in MARKS:
        other = Numbers(decimal, thousands, numbers.bad)
        if (decimal, thousands) == (numbers.decimal, numbers.thousands) or not (
            odd and all(isinstance(cell, str) for cell in odd)
        ):
            continue
        if all(_is_number(other, cell) for cell in odd):
            reading = tuple(other.quantity(cell)[0] for cell in odd[:100])
            if reading not in used:  # 1,5 is the same with any thousands
                used.add(reading)
                marks = [f'decimal = "{decimal}"'] * (decimal != numbers.decimal)
                marks += [f'thousands = "{thousands}"'] * bool(thousands and thousands != numbers.thousands)
                found.append(f"{' and '.join(marks)} ({odd[0]} is {reading[0]!r})")
    return found


def _states_line(c: Source, plant: Plant, texts: Iterable[str]) -> str:
    """A line of a map with the states of a column: of two that are on and off the input's nominal value and 0."""
    full = 1.0
    if c.is_input and (nominal := plant.inputs[c.position].nominal):
        full = (nominal - c.conversion.offset) / c.conversion.factor
    words = sorted(dict.fromkeys(texts), key=lambda word: (word.casefold() not in ON, word))
    numbers = {word: float(k) for k, word in enumerate(words)}
    if all(word.casefold() in (*ON, *OFF) for word in words):
        numbers = {word: full if word.casefold() in ON else 0.0 for word in words}
    states = ", ".join(f"{_key(word)} = {number:g}" for word, number in numbers.items())
    unit = f', unit = "{c.unit}"' if c.unit and c.unit != c.wanted else ""
    return f'{_key(c.title)} = {{ {"input" if c.is_input else "sensor"} = "{c.name}"{unit}, states = {{ {states} }} }}'


def _key(text: str) -> str:
    """A text as a key in TOML."""
    return text if re.fullmatch(r"[A-Za-z0-9_-]+", text) else json.dumps(text, ensure_ascii=False)


def _texts(cells: Iterable[Any]) -> Counter[str]:
    """How often which text occurs among the cells, empty ones left out."""
    return Counter(text for cell in cells if cell is not None and cell == cell and (text := str(cell).strip()))


def _listed(texts: Counter[str]) -> str:
    shown_ones = [f"{shown(text)} ({count})" for text, count in texts.most_common(WORDS)]
    return ", ".join(shown_ones) + (f" and {len(texts) - WORDS} more" if len(texts) > WORDS else "") or "nothing"
