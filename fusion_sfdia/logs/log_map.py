"""How the columns of a log become readings and inputs of a plant, as a file map.toml or a LogMap states it."""

from __future__ import annotations

import codecs
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import timedelta, timezone, tzinfo
from difflib import get_close_matches
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from fusion_sfdia.common.arguments import number, shown, whole
from fusion_sfdia.common.numerals import code
from fusion_sfdia.logs.epochs import NAMES, SECONDS, count_of
from fusion_sfdia.logs.physics import StatedPhysics
from fusion_sfdia.logs.problems import Problems

AT_THE_SAMPLE, UNTIL_THE_SAMPLE = "at the sample", "until the sample"
SPREAD = "spread"
OPC_DA, OPC_UA = "opc-da", "opc-ua"
TOGETHER = ({"decimal", "thousands"}, {"tag", "value", "quality"})  # keys that are right only beside each other
MASK = re.compile(r"(.+?)\s*(<=|>=|==|!=|<|>)\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)", re.ASCII)
CHOICES = {
    "duplicates": ("refuse", "first", "last", "mean", SPREAD),
    "order": ("refuse", "sort"),
    "inputs": (AT_THE_SAMPLE, UNTIL_THE_SAMPLE),
    "decimal": (".", ","),
    "thousands": ("", ".", ",", " ", "'"),
}


@dataclass(frozen=True)
class Column:
    """What a column of a log holds: readings of a sensor or values of an input.

    Parameters
    ----------
    sensor : str, default ""
        The name of the sensor in the plant.
    input : str, default ""
        Or that of the input.
    unit : str, default ""
        Of the column; it is converted to that of the plant. "" means the unit in the column's title, otherwise the plant's.
    scale : float, default 1
        Value in that unit over the number in the log.
    quality : str, default ""
        The title of the column with its quality codes.
    time : str, default ""
        The title of the column with its times, where it has its own.
    states : mapping of str to float, default {}
        The numbers of a column of texts or truth values, {"On": 2000.0, "Off": 0.0}, before the scale and in that unit; upper
        and lower case are the same, and so are true, "TRUE" and 1.

    Examples
    --------
    >>> from fusion_sfdia.logs import Column
    >>> Column(sensor="l1", unit="cm").name
    'l1'
    """

    sensor: str = ""
    input: str = ""
    unit: str = ""
    scale: float = 1.0
    quality: str = ""
    time: str = ""
    states: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _require_texts("the column", self, ("sensor", "input", "unit", "quality", "time"))
        if bool(self.sensor) == bool(self.input):
            raise ValueError(
                f'sensor is {self.sensor!r} and input {self.input!r}; expected one of them, as in {{ sensor = "TT101" }}'
            )
        if not 0 < abs(number("scale", self.scale)) < math.inf:
            raise ValueError(f"scale is {self.scale}; expected a finite number other than 0")
        if not isinstance(self.states, Mapping):
            raise ValueError(f"states is {shown(self.states)}; expected a number for each text, as in {{ On = 1, Off = 0 }}")
        taken: dict[str, Any] = {}
        for state, value in self.states.items():
            if not isinstance(state, str | int | float) or not str(state).strip():
                raise ValueError(f"states has {shown(state)}; expected the text of a state")
            if not math.isfinite(number(f"the number of state {shown(state)}", value)):
                raise ValueError(f"the number of state {shown(state)} is {value}; expected a finite one")
            if (same := code(state)) in taken:
                raise ValueError(f"the states {taken[same]!r} and {state!r} are the same; keep one")
            taken[same] = state

    @property
    def name(self) -> str:
        """The name of the sensor or input in the plant."""
        return self.sensor or self.input


@dataclass(frozen=True)
class LogMap:
    """How a log is written, and which column holds which sensor or input.

    Parameters
    ----------
    time : tuple of str, default ("time",)
        Title of the column of times, or of two that are joined, date and time.
    format : str, default ""
        As strptime takes it; or the unit of numbers ("s", "ms", "us", "ns", "min", "h", "d"), with a date where they count from
        one ("s since 1904-01-01"), or "excel", "labview", "matlab", "julian", "filetime", "ticks"; "" recognises ISO 8601,
        seconds, and numbers that are seconds, milli-, micro- or nanoseconds since 1970, days, or digits of the calendar.
    tz : str, default ""
        Time zone of stamps that state none, and in which results are shown: a name, or an offset from UTC such as "+01:00" of a
        logger without summer time.
    separator : str, default ","
        Of a text file.
    decimal : str, default "."
        Of a text file.
    thousands : str, default ""
        Of a text file.
    encoding : str, default "utf-8-sig"
        Of a text file.
    preamble : int, default 0
        Of a text file: lines before the header.
    unit_row : bool, default False
        Of a text file: whether the row below the header holds units.
    skip_rows : int, default 0
        Of a text file: rows below these that are no readings.
    footer : int, default 0
        Of a text file: such rows at the end.
    comment : str, default ""
        Of a text file: what a line begins with that is a comment.
    sheet : str, default ""
        Of a workbook that has several.
    bad : tuple of str or float, default ()
        Texts or numbers that stand for a missing reading.
    quality : str, default ""
        Pattern of the titles of quality columns, as in "{column}.Q"; of a long format the title of its one.
    good : str or tuple, default ()
        The codes that make a value count, "opc-da" or "opc-ua" for theirs, or texts, numbers and true.
    duplicates : str, default "refuse"
        Which of several values at one time counts.
    order : str, default "refuse"
        What is done with rows that are not in order.
    inputs : str, default "at the sample"
        Whether the input in a row acts from that row on ("at the sample", what historians give), or acted until then ("until
        the sample", what `simulate` writes).
    hold : float, default 0
        For how long a missing input keeps its last value, s.
    step : float, default 0
        Seconds between the rows that the values are put in, of each column or tag the nearest in time; 0: as they are, or the
        plant's step where tags have times of their own that fall between those of others.
    mask : tuple of str, default ()
        Comparisons such as "feed < 5", in the log's unit, of rows in which the plant is not in operation.
    tag, value : str, default ""
        Titles of a long format, with one value a row.
    columns : mapping of str to Column, default {}
        What each column is, by title; for columns that are not among them, their own title.
    physics : StatedPhysics, default StatedPhysics()
        What `monitor` is to know of the columns, by their names.

    Raises
    ------
    ValueError
        For anything else.

    Examples
    --------
    >>> import pandas as pd
    >>> from fusion_sfdia import load_log
    >>> from fusion_sfdia.logs import Column, LogMap
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> frame = pd.DataFrame({"stamp": ["2026-03-01 10:00:00", "2026-03-01 10:00:05"], "LT01": [100.0, 101.0]})
    >>> log_map = LogMap(time=("stamp",), columns={"LT01": Column(sensor="l1", unit="cm")})
    >>> load_log(frame, plant, log_map, absent_sensors=True, nominal_inputs=True).log.y[:, 0]
    array([1.  , 1.01])
    """

    time: tuple[str, ...] = ("time",)
    format: str = ""
    tz: str = ""
    separator: str = ","
    decimal: str = "."
    thousands: str = ""
    encoding: str = "utf-8-sig"
    preamble: int = 0
    unit_row: bool = False
    skip_rows: int = 0
    footer: int = 0
    comment: str = ""
    sheet: str = ""
    bad: tuple[str | float, ...] = ()
    quality: str = ""
    good: str | tuple[str | float, ...] = ()
    duplicates: str = "refuse"
    order: str = "refuse"
    inputs: str = AT_THE_SAMPLE
    hold: float = 0.0
    step: float = 0.0
    mask: tuple[str, ...] = ()
    tag: str = ""
    value: str = ""
    columns: Mapping[str, Column] = field(default_factory=dict)
    physics: StatedPhysics = field(default_factory=StatedPhysics)

    def __post_init__(self) -> None:
        for what in ("time", "mask", "bad"):
            object.__setattr__(self, what, _listed(what, getattr(self, what)))
        if not isinstance(self.good, str):
            object.__setattr__(self, "good", _listed("good", self.good, truth=True))
        _require_texts(
            "the map", self, ("format", "tz", "separator", "encoding", "comment", "sheet", "quality", "tag", "value", *CHOICES)
        )
        for what in ("time", "mask"):
            if not all(isinstance(text, str) and text for text in getattr(self, what)):
                raise ValueError(f"{what} is {shown(getattr(self, what))}; expected a text or several")
        for text in self.mask:
            if not MASK.fullmatch(text.strip()):
                raise ValueError(f'mask is {shown(text)}; expected a comparison of a column with a number, as in "feed < 5"')
        for what, known in CHOICES.items():
            if (given := getattr(self, what)) not in known:
                raise ValueError(f"{what} is {given!r}; expected {_or(known)}")
        if isinstance(self.good, str) and self.good not in (OPC_DA, OPC_UA):
            raise ValueError(f'good is {self.good!r}; expected "opc-da", "opc-ua", or a list of the codes of good values')
        if self.format and count_of(self.format) is None and ("%" not in self.format or "%Z" in self.format):
            raise ValueError(
                f'format is {self.format!r}; expected one as strptime takes it, as in "%d-%m-%Y %H:%M:%S", the unit of '
                f'numbers, {", ".join(SECONDS)}, a unit with the date from which it counts, as in "s since 1904-01-01", or one '
                f"of {', '.join([*NAMES, 'matlab', 'julian'])}"
            )
        if not 1 <= len(self.time) <= 2:
            raise ValueError(f"time names {len(self.time)} columns; expected one, or two that are joined, date and time")
        if len(self.separator) != 1 or self.separator in '"\r\n':
            raise ValueError(f'separator is {self.separator!r}; expected one character, as in ";" or "\\t"')
        if self.decimal == self.thousands:
            raise ValueError(f"decimal and thousands are both {self.decimal!r}; give each its own")
        for what in ("preamble", "skip_rows", "footer"):
            whole(what, getattr(self, what), 0)
        if not isinstance(self.unit_row, bool):
            raise ValueError(f"unit_row is {shown(self.unit_row)}; expected true or false")
        object.__setattr__(self, "hold", _seconds_of("hold", self.hold))
        if not 0 <= number("step", self.step) < math.inf:
            raise ValueError(f"step is {self.step}; expected seconds between rows, or 0 for the rows as they are")
        _require_encoding(self.encoding)
        zone(self.tz)
        if bool(self.tag) != bool(self.value):
            raise ValueError(f"tag is {self.tag!r} and value {self.value!r}; a long format needs both titles")
        if self.quality and not self.tag and "{column}" not in self.quality:
            raise ValueError(
                f'quality is {self.quality!r}; expected a pattern of titles, as in "{{column}}.Q", or give it by column'
            )
        self._require_columns()

    @property
    def has_pattern(self) -> bool:
        """Whether the format is one of stamps in text."""
        return "%" in self.format

    def _require_columns(self) -> None:
        if not isinstance(self.columns, Mapping) or not all(isinstance(c, Column) for c in self.columns.values()):
            raise ValueError(f"columns is {shown(self.columns)}; expected a Column for each title")
        taken: dict[str, str] = {}
        for title, column in self.columns.items():
            if column.name in taken:
                raise ValueError(f"the columns {taken[column.name]!r} and {title!r} are both {column.name!r}; keep one")
            taken[column.name] = title


def load_map(path: str | Path) -> LogMap:
    r"""Return the LogMap of a file in TOML, with the tables [log], [columns] and [physics].

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    LogMap
        As `load_log` takes it.

    Raises
    ------
    ValueError
        A LogError that names the file and all keys that LogMap and Column do not take.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from fusion_sfdia.logs import load_map
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder, "map.toml")
    ...     size = path.write_text('[log]\ntz = "Europe/Berlin"\n[columns]\nLT01 = {sensor = "l1", unit = "cm"}\n')
    ...     log_map = load_map(path)
    >>> log_map.tz, log_map.columns["LT01"].unit
    ('Europe/Berlin', 'cm')
    """
    try:
        found = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not TOML ({error}); expected the tables [log], [columns] and [physics]") from error
    problems = Problems(str(path))
    tables = _known(problems, "", found, ("log", "columns", "physics"), tables=True)
    physics = StatedPhysics()
    try:
        physics = StatedPhysics(
            **_known(problems, "[physics] ", tables.get("physics", {}), [f.name for f in fields(StatedPhysics)])
        )
    except ValueError as error:
        problems.add("map", f"[physics] {error}")
    columns = {}
    for title, what in tables.get("columns", {}).items():
        where = f"column {title!r}: "
        if not isinstance(what, dict):
            problems.add("map", f'{where}{shown(what)}; expected a table, as in {{ sensor = "TT101", unit = "degC" }}')
            continue
        given = _known(problems, where, what, [f.name for f in fields(Column)])
        try:
            columns[title] = Column(**given)
        except ValueError as error:
            problems.add("map", f"{where}{error}")
    given = _known(
        problems, "[log] ", tables.get("log", {}), [f.name for f in fields(LogMap) if f.name not in ("columns", "physics")]
    )
    try:
        made = LogMap(**given, columns=columns, physics=physics)
    except ValueError as error:
        groups = [{key} for key in given if not any(key in together for together in TOGETHER)]
        alone = [text for keys in (*TOGETHER, *groups) if (text := _refusal({k: given[k] for k in given if k in keys}))]
        for text in alone or [str(error)]:
            problems.add("map", text)
    problems.require_none()
    return made


def _refusal(given: Mapping[str, Any]) -> str:
    """What is wrong with some keys of [log], "" for nothing."""
    try:
        LogMap(**given)
    except ValueError as error:
        return str(error)
    return ""


def zone(name: str) -> tzinfo | None:
    """Return the time zone of that name, or of an offset such as "+01:00", None for ""; ValueError for an unknown one."""
    if match := re.fullmatch(r"(?:UTC|GMT)?([+-])(\d\d):?([0-5]\d)", name):
        away = timedelta(hours=int(match[2]), minutes=int(match[3]))
        if away < timedelta(days=1):
            return timezone(-away if match[1] == "-" else away)
    try:
        return ZoneInfo(name) if name else None
    except (ValueError, OSError, LookupError) as error:
        raise ValueError(
            f'tz is {shown(name)}; expected a time zone by its place, as in "Europe/Amsterdam" or "UTC"'
        ) from error


def _known(
    problems: Problems, where: str, found: Mapping[str, Any], known: Sequence[str], *, tables: bool = False
) -> dict[str, Any]:
    """The known keys of a table; others are added to problems, and with `tables` those that are none."""
    kept = {}
    for key, value in found.items():
        if key not in known:
            near = get_close_matches(key, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"
            problems.add("map", f"{where}unknown key {shown(key)}; {hint}")
        elif tables and not isinstance(value, dict):
            problems.add("map", f"{key} is {shown(value)}; expected a table [{key}]")
        else:
            kept[key] = value
    return kept


def _require_texts(where: str, owner: object, names: tuple[str, ...]) -> None:
    for name in names:
        if not isinstance(value := getattr(owner, name), str):
            raise ValueError(f"{name} of {where} is {shown(value)}; expected a text")


def _require_encoding(encoding: str) -> None:
    try:
        if not codecs.lookup(encoding)._is_text_encoding:  # as str.encode asks, too: hex and others are no texts
            raise LookupError(encoding)
    except (LookupError, ValueError) as error:
        raise ValueError(f'encoding is {shown(encoding)}; expected one such as "utf-8", "cp1252" or "utf-16"') from error


def _listed(what: str, value: Any, *, truth: bool = False) -> tuple[Any, ...]:
    """One text or number, or a list of them, as a tuple; ValueError for anything else. truth: whether also true and false."""
    items = tuple(value) if isinstance(value, list | tuple) else (value,)
    if any((isinstance(i, bool) and not truth) or not isinstance(i, str | int | float) for i in items):
        raise ValueError(f"{what} is {shown(value)}; expected texts or numbers")
    return items


def _seconds_of(what: str, value: Any) -> float:
    """A time span (s): true for any length, false for none."""
    if isinstance(value, bool):
        return math.inf if value else 0.0
    if not number(what, value) >= 0:
        raise ValueError(f"{what} is {value}; expected seconds of at least 0, or true for any length")
    return float(value)


def _or(known: tuple[str, ...]) -> str:
    texts = [f'"{k}"' for k in known]
    return f"{', '.join(texts[:-1])} or {texts[-1]}"


PLAIN_MAP = LogMap(inputs=UNTIL_THE_SAMPLE)  # as `simulate` writes a log
