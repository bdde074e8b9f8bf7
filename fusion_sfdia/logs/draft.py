"""A first map of a log: what its file shows, each statement that may be wrong marked as unsure, with the alternatives."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import some
from fusion_sfdia.common.unit_texts import is_unknown
from fusion_sfdia.logs.cell_tables import Table, read_table
from fusion_sfdia.logs.columns import split_title
from fusion_sfdia.logs.delimited import decoded, find_header, is_reading, lines_of
from fusion_sfdia.logs.kinds import PARQUET, TEXT, kind_of
from fusion_sfdia.logs.log_map import OPC_DA, OPC_UA, Column, LogMap
from fusion_sfdia.logs.matching import matched
from fusion_sfdia.logs.numbers import Numbers
from fusion_sfdia.logs.problems import LogError, Problem
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.logs.time_columns import STAMP, TIME_TITLE, time_columns
from fusion_sfdia.logs.times import Times
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

TAG_TITLE = re.compile(r"tag|name|sensor|variable|signal|point|channel|item|metric|series|parameter|kanal|topic", re.I)
VALUE_TITLE = re.compile(r"val|wert|waarde|reading|\bpv\b", re.I)
QUALITY = re.compile(r"(.+?)([ ._:-]*(?:q|qual|quality|status|st|good|valid))", re.I)
MISSING = re.compile(
    r"bad|nan|null|none|n/?a|#n/?a|-+|\?+|.*(?:error|err|fail|fault|invalid|time-?out|no data|offline|comm).*", re.I
)
SENTINEL = re.compile(r"-?(?:9{3,}|32767|32768|1e\+?30)(?:\.[09]*)?", re.I)
SUFFIX = re.compile(
    r"(.+)[_ ](mm|cm|m|degC|degF|C|K|bar|barg|mbar|kPa|MPa|Pa|psi|kW|MW|rpm|Hz|kg/s|kg/h|m3/h|m3/s|l/min|V|A|%)"
)
NUMBER = re.compile(r"[+-]?(?:\d[\d.,' \u00a0\u202f\u2019]*|[.,]\d+)(?:[eE][+-]?\d+)?")
BLANK = "[ \u00a0\u2009\u202f]"
SHOWN = 1000  # rows by which the form of numbers is decided
STILL = 0.9  # share of the rows without a change, of a tag that is no sensor's
OFF = re.compile(r"off|0|false|no|closed|stop(?:ped)?|aus|zu|idle|inactive|disabled", re.I)  # the state that comes first, as 0
STATES = 6  # texts of a column of states, at most
KINDS_BAD = 12  # texts among the numbers of a column, at most
MOST_BAD = 0.5  # share of a column's cells that are no numbers, above which it is a column of texts


class Tag(NamedTuple):
    """A column, or tag of a long table, of numbers: its title, name, unit, and readings (K,) in the order of the rows.

    in_cells: whether the unit stands behind each number, so that a map need not state it.
    """

    title: str
    name: str
    unit: str
    values: Array
    in_cells: bool = False


@dataclass
class Draft:
    """A map as far as a log shows it.

    settings: the keys of [log]. notes: why one is as it is, by key or title; "unsure: ..." where others fit, too. options: keys
    that are left out, as they would stand, with the reason. columns: what feeds the plant; inputs: what may act on it, as
    comments; unused: the other titles, and why.
    """

    settings: dict[str, Any] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    options: dict[str, str] = field(default_factory=dict)
    columns: dict[str, Column] = field(default_factory=dict)
    inputs: dict[str, Column] = field(default_factory=dict)
    unused: dict[str, str] = field(default_factory=dict)
    tags: list[Tag] = field(default_factory=list)
    times: Times | None = None
    problems: tuple[Problem, ...] = ()

    @property
    def log_map(self) -> LogMap:
        return LogMap(**self.settings, columns=self.columns)

    @property
    def unsure(self) -> list[str]:
        """The keys and columns of which another statement fits as well."""
        return [name for name, note in self.notes.items() if note.startswith("unsure")]

    def text(self, source: str) -> str:
        """The map as TOML."""
        lines = [f"# Drafted from {source}. What is marked unsure fits the log in other ways, too: check it.", "", "[log]"]
        lines += [_line(f"{key} = {_toml(value)}", self.notes.get(key, "")) for key, value in self.settings.items()]
        lines += [_line(f"# {option}", why) for option, why in self.options.items()]
        lines += ["", "[columns]"]
        for title, column in (self.columns | self.inputs).items():
            given: dict[str, Any] = {"input" if column.input else "sensor": column.name} | (
                {"unit": column.unit} if column.unit else {}
            )
            given |= {"states": dict(column.states)} if column.states else {}
            table = ", ".join(f"{k} = {_toml(v)}" for k, v in given.items())
            comment = "# " if title in self.inputs else ""
            lines.append(_line(f"{comment}{_toml(title)} = {{ {table} }}", self.notes.get(title, "")))
        lines += [_line(f'# {_toml(title)} = {{ sensor = "..." }}', why) for title, why in self.unused.items()]
        if self.problems:
            lines += ["", "# Still to be settled:", *(f"# - {' '.join(p.at('').split())}" for p in self.problems)]
        return "".join(re.sub(r"[\x00-\x1f\x7f]", " ", line) + "\n" for line in lines)


def draft_map(source: str | Path, plant: Plant | None = None) -> Draft:
    """Return a draft of the map of a log of a plant; without one each column of numbers is taken for a sensor.

    ValueError for a file in which no header with rows of readings, or no column of times, is found.
    """
    path, draft = Path(source), Draft()
    table = _table(path, draft)
    form = {key: draft.settings[key] for key in ("decimal", "thousands") if key in draft.settings}
    times = _add_times(table, draft, LogMap(**form))
    _add_layout(path, draft)
    others = [title for title in table.titles if title and title not in times]
    if not _add_long(table, draft, Numbers(**form), others):
        _add_wide(table, draft, Numbers(**form), others)
    if plant is None:
        _add_all(draft)
        return draft
    for tag, match in zip(draft.tags, matched(draft.tags, plant), strict=True):
        if match.column is None:
            draft.unused[tag.title] = match.note
        else:
            draft.columns[tag.title] = replace(match.column, unit="") if tag.in_cells else match.column
            draft.notes |= {tag.title: match.note} if match.note else {}
    return draft


def _add_all(draft: Draft) -> None:
    """Each tag as a sensor of its own name; one that hardly ever changes as an input, which is a comment."""
    names: list[str] = []
    still = {tag.title: why for tag in draft.tags if (why := _is_still(tag.values))}
    for tag in draft.tags:
        names.append(_unique(re.sub(r"\W+", "_", tag.name).strip("_") or "sensor", [*names, "time"]))
        if tag.title in still and len(still) < len(draft.tags):
            draft.inputs[tag.title] = Column(input=names[-1], unit="" if tag.in_cells else tag.unit)
            draft.notes[tag.title] = f"unsure: {still[tag.title]}; an input, or a sensor after all"
        else:
            draft.columns[tag.title] = Column(names[-1], unit="" if tag.in_cells else tag.unit)


def _is_still(values: Array) -> str:
    """How seldom a tag changes, in words; "" of one that moves as readings do."""
    known = values[np.isfinite(values)]
    if known.size < 5 or float(np.mean(np.diff(known) == 0)) < STILL:
        return ""
    return "changes in few rows" if np.ptp(known) > 0 else f"is {known[0]:g} in all rows"


def settle(draft: Draft, source: str | Path, plant: Plant) -> None:
    """Read the log by the draft: what is refused becomes a key where the map has one for it, otherwise one of its problems."""
    while True:
        try:
            load_log(source, plant, draft.log_map)
        except LogError as error:
            draft.problems = error.problems
        else:
            draft.problems = ()
        if not any([_settled(draft, p) for p in draft.problems]):
            return


def _settled(draft: Draft, problem: Problem) -> bool:
    """Whether a key of the map, which is added, allows what is refused."""
    for key, value, why in (
        ("order", "sort", "unsure: rows are not in the order of their times; or correct the times in the log"),
        ("duplicates", "first", 'unsure: several values of one time; or "last", "mean"'),
        ("hold", True, "unsure: inputs are missing in some rows, and keep their last value; or for how long, in seconds"),
    ):
        if key not in draft.settings and re.search(rf"state {key}\b", problem.cure):
            draft.settings[key], draft.notes[key] = value, why
            return True
    return False


def _table(path: Path, draft: Draft) -> Table:
    """The table of a file as reading recognises it, and how its numbers are written."""
    with path.open("rb") as file:
        kind = kind_of(file, path.suffix.casefold()).name
    if kind == PARQUET:
        from pyarrow.parquet import read_schema  # as pandas reads the file

        titles = [str(title) for title in read_schema(path).names]
        return read_table(path, LogMap(time=(next((t for t in titles if TIME_TITLE.search(t)), titles[0]),)))
    if kind == TEXT and not _is_utf(path.read_bytes()):
        draft.settings["encoding"] = "cp1252"
        draft.notes["encoding"] = 'unsure: no UTF-8; where letters look wrong "cp1250", "cp850" or another'
    table = read_table(path, LogMap(**draft.settings))
    if is_reading(table.titles):
        raise ValueError(f"{table.where}: {some(table.titles)} are no titles; write a header: the names of the columns")
    _add_number_form(table, draft)
    return table


def _is_utf(data: bytes) -> bool:
    """Whether bytes are of UTF-8, or of an encoding that reading finds by its mark or its zeros."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\x00" in data[:100]:
        return True
    try:
        data.decode()
    except UnicodeDecodeError as error:
        return error.start >= len(data) - 3  # a file may end within a character
    return True


def _add_number_form(table: Table, draft: Draft) -> None:
    """The decimal mark and the mark of thousands of the cells that are numbers."""
    cells = [c for column in table.columns for c in list(column)[:SHOWN] if isinstance(c, str) and NUMBER.fullmatch(c.strip())]
    for thousands, decimal in ((".", ","), (" ", ","), ("'", "."), (",", "."), (" ", ".")):
        mark, point = BLANK if thousands == " " else re.escape(thousands), re.escape(decimal)
        grouped = rf"[+-]?\d{{1,3}}(?:{mark}\d{{3}})+{point}\d+|[+-]?\d{{1,3}}(?:{mark}\d{{3}}){{2,}}"
        if any(re.fullmatch(grouped, c.strip()) for c in cells):
            draft.settings |= {"thousands": thousands} | ({"decimal": decimal} if decimal != "." else {})
            return
    commas = [c for c in cells if re.fullmatch(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?", c.strip())]
    if commas and not any("." in c and not STAMP.match(c.strip()) for c in cells):
        draft.settings["decimal"] = ","
        if all(re.fullmatch(r"[+-]?\d{1,3},\d{3}", c.strip()) for c in commas):
            draft.notes["decimal"] = 'unsure: three digits behind each comma; or decimal = "." and thousands = ","'


def _add_layout(path: Path, draft: Draft) -> None:
    """The separator and the lines before the header of a text file, which reading recognises, too, as statements of the map."""
    with path.open("rb") as file:
        if kind_of(file, path.suffix.casefold()).name != TEXT:
            return
        file.seek(0)
        lines = lines_of(str(path), decoded(str(path), file.read(), draft.log_map.encoding, []))
    header = find_header(lines, draft.log_map)
    if header.separator != ",":
        draft.settings["separator"] = header.separator
    if header.comment:
        draft.settings["comment"] = header.comment
    elif header.position:
        draft.settings["preamble"] = header.position


def _add_times(table: Table, draft: Draft, log_map: LogMap) -> tuple[str, ...]:
    """The columns of the times, and how they are written; ValueError where no column holds times."""
    found = time_columns(table, log_map)
    if found is None:
        raise ValueError(
            f"{table.where}: no column of times among {some(table.titles)}; expected one of stamps, or of seconds that increase"
        )
    form, draft.times = found.ways[0]
    draft.settings = {"time": list(found.names)} | draft.settings
    if form:
        draft.settings["format"] = form
    if len(found.ways) > 1:
        draft.notes["format"] = f"unsure: or {', '.join(_toml(other) for other, _ in found.ways[1:])}"
    start = draft.times.clock.start
    if start is not None and start.tzinfo is None:
        draft.options['tz = "Europe/Amsterdam"'] = (
            "unsure: the stamps state no time zone; name the place, so that the hour is right where clocks change"
        )
    return found.titles


def _add_long(table: Table, draft: Draft, numbers: Numbers, others: Sequence[str]) -> bool:
    """The tags of a long table, and whether the table is one: a column of tags, one of values and perhaps one of quality."""
    if not 2 <= len(others) <= 4:
        return False
    columns = {title: _numbers(table.column(title), numbers) for title in others}
    values = [title for title, read in columns.items() if read.bad is not None]
    texts = [title for title in others if title not in values and not QUALITY.fullmatch(f"x {title}")]
    value = next((title for title in values if VALUE_TITLE.search(title)), values[0] if len(values) == 1 else "")
    tag = next((title for title in texts if TAG_TITLE.search(title)), texts[0] if len(texts) == 1 else "")
    if not value or not tag:
        return False
    tags = np.array([str(cell).strip() for cell in table.column(tag)])
    if not TAG_TITLE.search(tag) and not 1 < len({*tags}) <= len(tags) / 3:
        return False
    draft.settings |= {"tag": tag, "value": value}
    found, bad, unit_in_cells = columns[value]
    _add_bad(draft, bad or Counter())
    for name in dict.fromkeys(tags):
        if len(of_tag := found[tags == name]):
            plain, unit = _name_and_unit(name, "")
            draft.tags.append(Tag(name, plain, unit or unit_in_cells, of_tag, not unit and bool(unit_in_cells)))
    for title in others:
        if title not in (tag, value) and (good := _good_of(table.column(title))) is not None:
            draft.settings["quality"] = title
            _add_good(draft, good)
            break
    return True


def _add_wide(table: Table, draft: Draft, numbers: Numbers, others: Sequence[str]) -> None:
    """The tags of a table with a column for each, texts that stand for missing readings, and columns of quality."""
    by_name = {split_title(title)[0]: title for title in others}
    qualities = {}
    for title in others:
        match = QUALITY.fullmatch(title)
        if match and match[1] in by_name and (good := _good_of(table.column(title))) is not None:
            qualities[title] = (match[2], good)
    if qualities:
        suffix, good = next(iter(qualities.values()))
        draft.settings["quality"] = f"{{column}}{suffix}"
        _add_good(draft, good)
    units = dict(zip(table.titles, table.units, strict=True))
    for title in others:
        if title in qualities:
            continue
        values, bad, in_cells = _numbers(table.column(title), numbers)
        if bad is not None:
            _add_bad(draft, bad + _sentinels(values))
            name, unit = _name_and_unit(title, units[title])
            draft.tags.append(Tag(title, name, unit or in_cells, _without(values, draft), not unit and bool(in_cells)))
        else:
            _add_states(draft, title, list(table.column(title)))


def _add_states(draft: Draft, title: str, cells: Sequence[Any]) -> None:
    """A column of texts: where these are few, an input with a number for each, as a comment."""
    texts = sorted({text for cell in cells if (text := str(cell).strip())}, key=lambda text: (not OFF.fullmatch(text), text))
    if not 2 <= len(texts) <= STATES:
        draft.unused[title] = f"texts {some(texts)}" if texts else "no values"
        return
    name = re.sub(r"\W+", "_", split_title(title)[0]).strip("_") or "input"
    draft.inputs[title] = Column(input=name, states={text: float(k) for k, text in enumerate(texts)})
    draft.notes[title] = "unsure: texts; where it is an input, with a number for each"


class _Read(NamedTuple):
    """A column as numbers (K,), NaN for other cells, which `bad` counts, None where too many; and the unit in cells."""

    values: Array
    bad: Counter[str] | None
    unit: str = ""


def _numbers(cells: Any, numbers: Numbers) -> _Read:
    """A column as numbers, as far as it is one."""
    units = Counter[str]()
    try:
        values, _, found = numbers.quantities(cells)
        units.update({unit: len(positions) for unit, positions in found.items()})
        bad = Counter[str]()
    except ValueError:
        values, bad = np.full(len(cells), np.nan), Counter()
        for k, cell in enumerate(cells):
            try:
                values[k], unit = numbers.quantity(cell)
                units.update([unit] if unit else [])
            except (ValueError, TypeError, OverflowError):
                bad[str(cell).strip()] += 1
    few = bad.total() <= MOST_BAD * len(values) and len(bad) <= KINDS_BAD and np.isfinite(values).any()
    return _Read(values, bad if few else None, units.most_common(1)[0][0] if units else "")


def _sentinels(values: Array) -> Counter[str]:
    """Numbers such as -9999 that occur several times, far from all others."""
    found, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    likely = [k for k in range(found.size) if counts[k] > 1 and SENTINEL.fullmatch(f"{found[k]:.15g}")]
    others = np.delete(found, likely)
    spread = float(np.max(np.abs(others))) if others.size else 0.0
    return Counter({f"{found[k]:.15g}": int(counts[k]) for k in likely if abs(found[k]) > 5.0 * spread and others.size})


def _without(values: Array, draft: Draft) -> Array:
    """Values without those that stand for missing ones."""
    bad = [b for b in draft.settings.get("bad", ()) if not isinstance(b, str)]
    return np.where(np.isin(values, bad), np.nan, values)


def _add_bad(draft: Draft, bad: Counter[str]) -> None:
    """Add texts and numbers that stand for missing readings."""
    for text in bad:
        stated: Any = float(text) if SENTINEL.fullmatch(text) else text
        if isinstance(stated, float) and stated == int(stated):
            stated = int(stated)
        if stated not in draft.settings.setdefault("bad", []):
            draft.settings["bad"].append(stated)
        if not MISSING.fullmatch(text):
            draft.notes["bad"] = "unsure: taken as missing readings; take out what is a reading, or a state"


def _good_of(cells: Any) -> Any:
    """The codes of quality that are good: a name or a list, "" for texts that state it; None for a column of other things."""
    found = Counter(str(cell).strip().casefold() for cell in cells if str(cell).strip())
    if not found or len(found) > 20:
        return None
    if all(text.startswith(("good", "bad", "uncertain")) for text in found):
        return ""
    if all(re.fullmatch(r"\d+|0x[0-9a-f]+", text) for text in found):
        most = found.most_common(1)[0][0]
        return OPC_DA if most == "192" else OPC_UA if most == "0" and max(map(len, found)) > 3 else [int(most, 0)]
    if all(re.fullmatch(r"[a-z]{1,12}", text) for text in found):
        return [next(str(cell).strip() for cell in cells if str(cell).strip().casefold() == found.most_common(1)[0][0])]
    return None


def _add_good(draft: Draft, good: Any) -> None:
    if good:
        draft.settings["good"] = good
    if isinstance(good, list):
        draft.notes["good"] = "unsure: the code that occurs most"


def _name_and_unit(title: str, row_unit: str) -> tuple[str, str]:
    """The name of a tag and its unit, as in "level [m]", "level (m)" or "level_m"; "" where there is none."""
    name, unit = split_title(title)
    if unit or row_unit:
        return name, unit or row_unit
    match = re.fullmatch(r"(.+?)\s*\(([^()]+)\)", name) or SUFFIX.fullmatch(name)
    return (match[1], match[2]) if match and not is_unknown(match[2]) else (name, "")


def _unique(name: str, taken: Sequence[str]) -> str:
    k = 1
    while (found := name if k == 1 else f"{name}_{k}") in taken:
        k += 1
    return found


def _line(statement: str, note: str) -> str:
    return f"{statement}  # {' '.join(note.split())}" if note else statement


def _toml(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, list):
        return _toml(value[0]) if len(value) == 1 else f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{_toml(k)} = {_toml(v)}' for k, v in value.items())} }}"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value)
