"""Which columns of a log feed which sensors and inputs of a plant, and in what unit."""

from __future__ import annotations

import re
from collections.abc import Container, Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import Any, NamedTuple

from fusion_sfdia.common.arguments import require_unique, shown, some
from fusion_sfdia.common.plain_text import uncell
from fusion_sfdia.logs.conversion import Conversion, conversion
from fusion_sfdia.logs.epochs import SECONDS, count_of
from fusion_sfdia.logs.log_map import PLAIN_MAP, Column, LogMap
from fusion_sfdia.logs.numbers import Numbers
from fusion_sfdia.logs.problems import Problems
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

TIME = r"(?:date[ /_-]?time|time[ _-]?stamp|time[ _-]?string|date|time|zeitstempel|zeit)"  # titles of times
BRACKET = re.compile(r"(.*?)(\s*)\[([^\[\]]*)\]", re.DOTALL)
INDEX = re.compile(r"\s*\d+(?:\s*,\s*\d+)*\s*")


class Source(NamedTuple):
    """A column of a log, by title, that feeds a sensor or an input, by name and position in y or u.

    unit: that its numbers are in once multiplied by the scale of the map. quality: title of its quality codes, or "".
    numbers: how its cells are written. wanted: the unit of the plant.
    """

    title: str
    name: str
    position: int
    is_input: bool
    unit: str
    conversion: Conversion
    quality: str = ""
    numbers: Numbers = Numbers()
    wanted: str = ""
    scale: float = 1.0

    def value(self, cell: Any) -> float:
        """The value of one cell in the unit of the plant, NaN where it is missing; ValueError for anything else."""
        value, unit = self.numbers.quantity(cell)
        return float((self.in_unit(unit) if unit else self.conversion)(value))

    def logged(self, cell: Any) -> float:
        """The number of one cell in the unit of the column, NaN where it is missing; ValueError for anything else."""
        number, unit = self.numbers.quantity(cell)
        return (self.in_unit(unit)(number) - self.conversion.offset) / self.conversion.factor if unit else number

    def in_unit(self, unit: str) -> Conversion:
        """The conversion of cells that state another unit themselves; ValueError where it does not fit the plant."""
        return conversion(unit, self.wanted, self.scale)


class Sources(NamedTuple):
    """The columns of the times with the unit in their title, the sources of readings and inputs, and what is not used.

    refused: titles of columns that feed something or may be meant, and that do not fit: by their unit, name or map.
    """

    times: tuple[str, ...]
    time_unit: str
    columns: tuple[Source, ...]
    ignored: tuple[str, ...]
    refused: tuple[str, ...] = ()

    def without_column(self, plant: Plant) -> list[str]:
        """The inputs of the plant that no column feeds."""
        fed = {c.name for c in self.columns if c.is_input}
        return [s.name for s in plant.inputs if s.name not in fed]


def find_sources(
    problems: Problems,
    header: Sequence[str],
    units: Sequence[str],
    plant: Plant,
    log_map: LogMap,
    *,
    absent: bool = False,
    other: bool = False,
    nominal: bool = False,
) -> Sources:
    """Return what each column of a header is, as far as it fits the plant and the map; all that does not is added to problems.

    units: of the columns, "" where their titles state them. absent, other, nominal: whether sensors without a column, columns
    of nothing and inputs without a column are accepted. With columns in the map, others than its own and the plant's are not
    used. What follows from another problem is no problem of its own: a column of a wrong unit is no missing sensor.
    """
    long = bool(log_map.tag)
    if not long and (usual := usual_time(header, log_map)):
        log_map = replace(log_map, time=(usual,))
    if not long:
        with problems.collecting("columns"):
            require_unique(
                f"{problems.where}: columns of a log of plant {plant.name!r}",
                [*log_map.time, *plant.sensor_names, *(s.name for s in plant.inputs)],
            )
        if len(header) == 1 and (mark := re.search(r"[;\t|,]", header[0])):
            problems.add("separator", _of_separator(mark[0], log_map))
            return Sources((), "", (), ())
    similar: dict[str, str] = {}
    if lacking := _lacking_titles(header, log_map):
        taken = {*log_map.columns, *log_map.time}
        free = [title for title in header if not {title, split_title(title, log_map.columns)[0]} & taken]
        similar = _similar(lacking, free)
        problems.add("columns", _of_lacking(header, log_map, lacking, similar))
    times, time_unit = ((), "") if long else _times(problems, header, log_map)
    own: dict[str, tuple[int, bool, Sensor | Signal]] = {}
    own.update({s.name: (i, True, s) for i, s in enumerate(plant.inputs)})
    own.update({s.name: (i, False, s) for i, s in enumerate(plant.sensors)})
    found: dict[str, Source] = {}
    named = {log_map.columns[title].name for title in lacking}  # what problems have named already
    unknown: list[str] = []
    refused = [*similar.values()]
    wrong: dict[tuple[str, str, str], list[str]] = {}
    qualities = {_quality(log_map, title, log_map.columns.get(title)) for title in header} - {""}
    known, with_bracket = {*own, *log_map.columns}, {name for name in own if "[" in name}
    for title, row_unit in zip(header, units, strict=True):
        name, bracket = split_title(title, known)
        if title in log_map.columns:  # which may be named with its unit
            bracket = split_title(title, with_bracket)[1]
        column = log_map.columns.get(title) or log_map.columns.get(name)
        if title in times or title in qualities:
            continue
        if column is None and name not in own:
            unknown.append(name)
            continue
        target = name if column is None else column.name
        if target not in own:  # a problem of the map
            refused.append(title)
            continue
        position, is_input, signal = own[target]
        if target in found or target in named:
            problems.add("columns", f"the column {name!r} occurs twice; keep one")
            continue
        unit = (column.unit if column else "") or bracket or row_unit
        try:
            converted = conversion(unit, signal.unit, column.scale if column else 1.0)
        except ValueError as error:
            wrong.setdefault((shown(unit), signal.unit, str(error)), []).append(name)
            refused.append(title)
            named.add(target)
            continue
        quality = _quality(log_map, title, column)
        if quality and quality not in header:
            problems.add("quality", f"no column {shown(quality)} with the quality of {shown(title)}; correct the map")
            quality = ""
        numbers = Numbers.of(log_map, column.states if column else None)
        scale = column.scale if column else 1.0
        found[target] = Source(title, target, position, is_input, unit, converted, quality, numbers, signal.unit, scale)
    if not times and not long:
        problems.add("time", _of_times(header, log_map))
        if not (found or named):
            there = f"no column is a sensor or an input of plant {plant.name!r}, either"
            problems.add("columns", f"{there}; state in a map which is which: `fusion-sfdia init` drafts one")
            return Sources((), "", (), tuple(unknown))
    for why, names in wrong.items():
        problems.add("unit", _of_wrong_unit(plant, *why, names), count=len(names))
    _add_missing(problems, plant, {*found, *named}, unknown, absent, nominal)
    if not log_map.columns:
        by_name = {split_title(title, known)[0]: title for title in header}
        meant = _similar([name for name in own if name not in {*found, *named}], unknown)
        refused += [by_name[name] for name in meant.values()]
    needs_time = not times and not long and len(unknown) == 1  # the unknown one is that of the times
    if unknown and not other and not log_map.columns and not needs_time:
        problems.add(
            "columns",
            f"the columns {some(unknown)} are no sensors or inputs of plant {plant.name!r}; rename or remove them, or ignore "
            "them with --other-columns (other_columns=True)",
            count=len(unknown),
        )
    return Sources(times, time_unit, tuple(found.values()), tuple(unknown), tuple(refused))


def _of_wrong_unit(plant: Plant, unit: str, wanted: str, error: str, names: list[str]) -> str:
    which, are, them = (f"column {names[0]!r}", "is", "it") if len(names) == 1 else (f"columns {some(names)}", "are", "them")
    return f"{which} {are} in {unit}, plant {plant.name!r} has {them} in {wanted!r}: {error}"


def require_columns_of(plant: Plant, log_map: LogMap) -> None:
    """Raise LogError for columns of the map that are no sensors or inputs of the plant."""
    problems = Problems("")
    inputs = tuple(s.name for s in plant.inputs)
    for title, c in log_map.columns.items():
        kind, names = ("input", inputs) if c.input else ("sensor", plant.sensor_names)
        if c.name not in names:
            other = "a sensor" if c.input else "an input"
            it_is = f"; there it is {other}" if c.name in (plant.sensor_names if c.input else inputs) else ""
            problems.add(
                "map",
                f"the map has the {kind} {shown(c.name)} for column {shown(title)}; {kind}s of plant {plant.name!r}: "
                f"{some(names)}{it_is}",
            )
    problems.require_none()


def split_title(title: str, names: Container[str] = ()) -> tuple[str, str]:
    """Return name and unit of "name [unit]"; the unit is "" where there is none.

    A title that is one of the names has no unit, and neither has an element of an array, T[1] or T[2,3]: a bracket with
    numbers right behind a name is a unit, one, only where what is before it is one of the names and the whole is not.
    """
    title = uncell(title.strip())
    match = BRACKET.fullmatch(title)
    if title in names or match is None:
        return title, ""
    name, gap, unit = match.groups()
    if not gap and INDEX.fullmatch(unit) and name not in names:
        return title, ""
    return name, unit.strip()


def _lacking_titles(header: Sequence[str], log_map: LogMap) -> list[str]:
    """The columns that the map names and the header lacks."""
    names = {*header, *(split_title(title, log_map.columns)[0] for title in header)}
    return [title for title in log_map.columns if title not in names]


def _similar(names: Sequence[str], titles: Sequence[str]) -> dict[str, str]:
    """For each of the names that has one the title that is most similar."""
    return {name: match for name in names for match in get_close_matches(name, titles, n=1, cutoff=0.75)}


def usual_time(titles: Sequence[str], log_map: LogMap) -> str | None:
    """The one column with a usual title of times, where the map states none and none is called "time"."""
    names = [split_title(t)[0] for t in titles]
    usual = [n for n in names if re.fullmatch(TIME, n, re.I) and n not in log_map.columns]
    stated = log_map.time != PLAIN_MAP.time or log_map.time[0] in (*titles, *names)
    return None if stated or len(usual) != 1 else usual[0]


def _of_lacking(header: Sequence[str], log_map: LogMap, lacking: Sequence[str], near: dict[str, str]) -> str:
    """The problem of columns that the map names and the header lacks; near: similar ones that are there."""
    hint = f"; did you mean {some(list(near.values()))} for {some(list(near))}?" if near else ";"
    kinds = {bool(log_map.columns[title].input) for title in lacking if title not in near}
    options = [("--absent-sensors (absent_sensors=True)", False), ("--nominal-inputs (nominal_inputs=True)", True)]
    given = " and ".join(option for option, is_input in options if is_input in kinds)
    cure = f", or leave out of it what is not logged and give {given}" if given else ""
    kind = "tags" if log_map.tag else "columns"
    return f"no {kind} {some(lacking)}, which the map names, among {some(header)}{hint} correct the map{cure}"


def _of_separator(mark: str, log_map: LogMap) -> str:
    expected = f"{log_map.separator!r}, as the map states"
    if log_map.separator == ",":
        expected = "commas, and decimal points; or state separator in a map"
    return f"cells are separated by {mark!r}; expected {expected}"


def _times(problems: Problems, header: Sequence[str], log_map: LogMap) -> tuple[tuple[str, ...], str]:
    """The titles of the columns of times, none where one is lacking, and the unit that the title of a single one states."""
    by_name = {split_title(title, log_map.time)[0]: title for title in reversed(header)}
    titles = [name if name in header else by_name.get(name, "") for name in log_map.time]
    if not all(titles):
        return (), ""
    unit = split_title(titles[0], log_map.time)[1] if len(titles) == 1 else ""
    if unit and count_of(unit) is None and not log_map.format:
        problems.add("time", f"column {log_map.time[0]!r} is in {shown(unit)}; expected one of {', '.join(SECONDS)}")
        unit = ""
    return tuple(titles), "" if log_map.format else unit


def _of_times(header: Sequence[str], log_map: LogMap) -> str:
    """The problem of columns of times that the header lacks."""
    lacking = [
        name for name in log_map.time if name not in {*header, *(split_title(title, log_map.time)[0] for title in header)}
    ]
    return (
        f"no column {some(lacking)} among {some(header)}; give the column of the times (s) that name, or state `time` in a map"
    )


def _quality(log_map: LogMap, title: str, column: Column | None) -> str:
    if column is not None and column.quality:
        return column.quality
    return "" if log_map.tag else log_map.quality.replace("{column}", split_title(title, log_map.columns)[0])


def _add_missing(
    problems: Problems, plant: Plant, named: set[str], unknown: Sequence[str], absent: bool, nominal: bool
) -> None:
    """Add the sensors and the inputs without a column, unless that is accepted, and a log of no sensor at all; unknown: titles
    that are none of them.
    """
    lacking = [n for n in plant.sensor_names if n not in named]
    if lacking and not absent:
        near = _similar(lacking, unknown)
        meant = f"did you mean {some(list(near.values()))} for {some(list(near))}? " if near else ""
        other = ""
        if len(lacking) == len(plant.sensors):
            other = "name another plant with --plant if it is not this one (`init` drafts one, `monitor` needs none); "
        problems.add(
            "sensors",
            f"no column for the sensors {some(lacking)} of plant {plant.name!r}; {other}{meant}add them (empty where not "
            "read), or take them as missing with --absent-sensors (absent_sensors=True)",
            count=len(lacking),
        )
    elif len(lacking) == len(plant.sensors):
        problems.add("sensors", f"no column of any sensor of plant {plant.name!r}; sensors: {some(plant.sensor_names)}")
    if (unset := [s.name for s in plant.inputs if s.name not in named]) and not nominal:
        problems.add(
            "inputs",
            f"no column for the inputs {some(unset)} of plant {plant.name!r}; add them, or assume the plant's usual inputs "
            "with --nominal-inputs (nominal_inputs=True)",
            count=len(unset),
        )
