"""The times of a log: seconds, numbers since a date, or stamps in text; in seconds since the first, with its wall clock."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.common.clock import Clock
from fusion_sfdia.logs.cell_tables import Table
from fusion_sfdia.logs.epochs import (
    EXCEL,
    IN_WORDS,
    AmbiguousTimesError,
    Calendar,
    EpochCount,
    calendar_stamps,
    calendars,
    count_of,
    dated,
    recognised,
    unix,
)
from fusion_sfdia.logs.loaded_log import Finding, counted
from fusion_sfdia.logs.log_map import PLAIN_MAP, LogMap, zone
from fusion_sfdia.logs.numbers import NotANumberError, Numbers

Array = NDArray[Any]

ISO = re.compile(r"\d{4}-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d(?:[.,]\d{1,9})?)?)?(?:Z|[+-]\d\d(?::?\d\d)?)?", re.ASCII | re.I)
BASIC = re.compile(r"(\d{4})(\d\d)(\d\d)[T ](\d\d)(\d\d)(\d\d(?:[.,]\d{1,9})?)?(Z|[+-]\d\d(?::?\d\d)?)?", re.ASCII | re.I)
APART = re.compile(r"(\S.*?)\s*(UTC|GMT|Z|[+-]\d\d(?::?\d\d)?)", re.ASCII | re.I)  # an offset behind a blank
OFFSET = re.compile(r"(?:Z|[+-]\d\d(?::?\d\d)?)", re.I)
OF_DAY = re.compile(r"(\d{1,4}):([0-5]\d):([0-5]\d(?:[.,]\d{1,9})?)", re.ASCII)
MIDNIGHT = re.compile(r"24(?=([:.]?)00(?:\D|00|$)(?!.*24\1?00))")  # the hour in 24:00, at the end of a day
DAY = 86400.0
AHEAD = DAY  # s by which a stamp may be ahead of the present: clocks and zones differ
DAYS = (
    "%d-%m-%Y", "%d/%m/%Y", "%m/%d/%Y", "%m-%d-%Y", "%d.%m.%Y", "%Y/%m/%d", "%Y.%m.%d", "%d-%b-%y", "%d-%b-%Y", "%d %b %Y",
    "%b %d %Y", "%b %d, %Y", "%d.%m.%y", "%d/%m/%y", "%m/%d/%y", "%y/%m/%d", "%y-%m-%d",
)  # fmt: skip
HOURS = ("%H:%M:%S", "%H:%M", "%I:%M:%S %p", "%I:%M %p", "%H:%M:%S.%f", "%H:%M:%S,%f", "%H.%M.%S")
COMMON = (*(f"{day} {hour}" for day in DAYS for hour in HOURS), *DAYS)


class Expected(NamedTuple):
    """What the times of a log are judged by: the usual step of the plant (s), None if unknown, and the present, None: now."""

    dt: float | None = None
    now: datetime | None = None

    @property
    def latest(self) -> float:
        """The latest time that a log may have, s since 1970."""
        return (self.now or datetime.now(UTC)).timestamp() + AHEAD


ANY = Expected()


class Times(NamedTuple):
    """Seconds t (K,), since the first stamp where the log has stamps; and where a row is in no order, as the log has it.

    kind: how the times were written, in words. numbers (K,): as the log has them, None of texts. taken: as what count they were
    read. stated: whether the map or the title says what they are. notes: findings on how they were read.
    """

    t: Array
    clock: Clock
    kind: str
    numbers: Array | None = None
    taken: str = ""
    stated: bool = True
    notes: tuple[Finding, ...] = ()


UNKNOWN = "unknown"


def unknown_times(count: int) -> Times:
    """Times in place of those that cannot be read, by which the other columns of so many rows are looked through."""
    return Times(np.arange(count, dtype=float), Clock(), UNKNOWN)


class Instant(NamedTuple):
    """One time: seconds, since 1970 where it is a stamp, and the stamp with its zone, None of plain seconds."""

    seconds: float
    stamp: datetime | None


def instant(
    cell: Any, log_map: LogMap = PLAIN_MAP, unit: str = "", *, near: datetime | None = None, now: datetime | None = None
) -> Instant:
    """Return the time that a single cell states, as `times_of` reads a column; ValueError for what is no time.

    Texts are ISO 8601 or as log_map.format states; numbers are s, ms, us or ns since 1970 by their size, digits of the calendar
    (12 or 14), what log_map.format or `unit` state, or else seconds. A stamp without an offset is in log_map.tz, UTC without
    one. near: the time that is expected, with its zone: of an hour that the zone has twice, the one nearer to it is meant;
    without it the first. now: the present, against which digits are told from numbers since 1970.
    """
    if isinstance(cell, np.datetime64):
        cell = cell.astype("datetime64[us]").astype(datetime)
    if isinstance(cell, datetime):
        return _in_zone(cell, log_map, near)
    text = cell.strip() if isinstance(cell, str) else cell
    try:
        if log_map.has_pattern:
            return _in_zone(_parsed(str(text), log_map.format), log_map, near)
        if isinstance(text, str) and (stamp := iso(text)):
            return _in_zone(_parsed(stamp, ""), log_map, near)
        if isinstance(text, bool):
            raise ValueError("a truth value")
        value = Numbers(log_map.decimal, log_map.thousands).cell(text)
        if np.isnan(value):
            raise ValueError("no number")
        seconds, local = _seconds(value, log_map.format or unit, Expected(now=now).latest)
        if local is None:
            return Instant(seconds, None)
        stamp_ = datetime(1970, 1, 1) + timedelta(seconds=seconds)
        return _in_zone(stamp_ if local else stamp_.replace(tzinfo=UTC), log_map, near)
    except _NoSuchTimeError:
        raise
    except (ValueError, TypeError, OverflowError) as error:
        form = f"a time as {log_map.format}" if log_map.format else "a time, in seconds or ISO 8601"
        raise ValueError(f"{shown(cell)}; expected {form}") from error


class _NoSuchTimeError(ValueError):
    """A local time that its zone skips."""


def _seconds(value: float, given: str, latest: float) -> tuple[float, bool | None]:
    """Seconds of a number, and whether they are of the wall clock since 1970, in UTC (False), or since any start (None)."""
    values = np.array([value])
    count = count_of(given) if given else None
    if count is not None and count.since is not None:
        return float(count.seconds(value)), count.local
    unit = unix(values, given)
    if not given and (unit is None or unit.seconds(value) > latest):
        digits = [c for c in calendars(values, latest) if c.name.startswith("%Y") and len(c.name) > 6]
        if digits:
            stamps = calendar_stamps(values, digits[0].name)
            assert stamps is not None
            return float((stamps[0] - np.datetime64(0, "us")) / np.timedelta64(1, "s")), True
        if value > 1e15 and (others := dated(values, latest)):
            return float(others[0].seconds(value)), others[0].local
    if unit is not None:
        return value * unit.unit, False
    return value * (count.unit if count else 1.0), None


def _in_zone(stamp: datetime, log_map: LogMap, near: datetime | None) -> Instant:
    own = zone(log_map.tz)
    if stamp.tzinfo is not None:
        aware = stamp.astimezone(own) if own else stamp
    else:
        aware = stamp.replace(tzinfo=own or UTC, fold=0)
        second = aware.replace(fold=1)
        if aware.utcoffset() != second.utcoffset():
            if aware.astimezone(UTC).astimezone(own).replace(tzinfo=None) != stamp.replace(fold=0):
                raise _NoSuchTimeError(f"{stamp} {_skipped(aware, log_map.tz)}")
            if near is not None and abs(second.timestamp() - near.timestamp()) < abs(aware.timestamp() - near.timestamp()):
                aware = second
    return Instant(aware.timestamp(), aware)


def _parsed(text: str, form: str) -> datetime:
    """A stamp in text, as strptime takes it, or ISO if the format is ""; 24:00 is the end of the day."""
    try:
        return datetime.strptime(text, form) if form else datetime.fromisoformat(text.upper())
    except ValueError:
        if not (early := MIDNIGHT.sub("00", text, count=1)) != text:
            raise
        return (datetime.strptime(early, form) if form else datetime.fromisoformat(early.upper())) + timedelta(days=1)


def iso(text: str) -> str:
    """A text in ISO 8601, also in its basic form or with a blank before the offset, in the extended form; "" of any other."""
    if ISO.fullmatch(text):
        return text.replace(",", ".")
    if match := BASIC.fullmatch(text):
        year, month, day, hour, minute, second, offset = match.groups()
        return f"{year}-{month}-{day} {hour}:{minute}:{second or '00'}{offset or ''}".replace(",", ".")
    if (match := APART.fullmatch(text)) and ":" in match[1] and ISO.fullmatch(match[1]) and not has_offset(match[1], ""):
        return (match[1] + ("Z" if match[2][0] not in "+-" else match[2])).replace(",", ".")
    return ""


def times_of(
    table: Table,
    titles: Sequence[str],
    unit: str,
    log_map: LogMap,
    tags: Sequence[str] | Array | None = None,
    expected: Expected = ANY,
) -> Times:
    """Return the times of a table from the columns of these titles, one, or two that are joined.

    unit: that the column's title states for numbers. tags: of a long format, in which each tag has its own order. ValueError
    that names row and column for what is no time, for numbers that may be several, for a time that the zone does not have and
    for one that it has twice.
    """
    column, title = table.column(titles[0]), " ".join(titles)
    if len(titles) == 2:
        column = [f"{_text(a)} {_text(b)}" for a, b in zip(column, table.column(titles[1]), strict=True)]
    kind = getattr(getattr(column, "dtype", None), "kind", "O")
    if kind == "m":
        return Times(_present(table, title, column) / np.timedelta64(1, "s"), Clock(), "durations")
    if kind == "M":
        stamps, own = _present(table, title, column), getattr(column.dtype, "tz", None)
        return _of_stamps(table, title, stamps, own, log_map, tags, "time stamps")
    if kind in "biuf" and re.fullmatch("(?:%[YymdHMS])+", log_map.format):
        return _of_numbers(table, title, column, unit, log_map, tags, expected)
    if not log_map.has_pattern and (kind in "biuf" or log_map.format or _is_number(_first(column), log_map)):
        return _of_numbers(table, title, column, unit, log_map, tags, expected)
    return _of_texts(table, title, [_text(c) for c in column], log_map, tags)


def _of_stamps(
    table: Table, title: str, stamps: Array, own: tzinfo | None, log_map: LogMap, tags: Sequence[str] | Array | None, kind: str
) -> Times:
    """Stamps in UTC where `own` is the zone that they state; local ones otherwise, in the zone of the map if it has one."""
    if own is None and log_map.tz:
        return _since_first(_localised(table, title, stamps, log_map.tz, tags), UTC, log_map, f"{kind} of {log_map.tz}")
    return _since_first(stamps, own, log_map, kind)


def _of_numbers(
    table: Table, title: str, column: Any, unit: str, log_map: LogMap, tags: Sequence[str] | Array | None, expected: Expected
) -> Times:
    try:
        values, _ = Numbers(log_map.decimal, log_map.thousands).column(column)
    except NotANumberError as error:
        raise ValueError(
            f"{table.text(error.position)}, column {title}: {shown(error.cell)}; expected a finite number, as in the first row"
        ) from error
    if np.isnan(values).any():
        raise ValueError(
            f"{table.text(int(np.argmax(np.isnan(values))))}, column {title}: ''; expected a finite number in each row"
        )
    given = log_map.format or unit
    count: EpochCount | Calendar | None = Calendar(given) if log_map.has_pattern else count_of(given) if given else None
    if count is None:
        try:
            count = recognised(values, expected.dt, expected.latest)
        except AmbiguousTimesError as error:
            raise ValueError(
                f"{table.where}, column {title}: {values[0]:.17g} may be a time in several ways; state one in a map: {error}"
            ) from error
    if isinstance(count, Calendar):
        stamps = calendar_stamps(values, count.name)
        if stamps is None:
            raise ValueError(f"{table.where}, column {title}: {values[0]:.17g}; expected digits as {count.name} in each row")
        found = _of_stamps(table, title, stamps, None, log_map, tags, f"digits of the calendar, {count.name}")
        return found._replace(numbers=values, taken=count.name, stated=bool(given))
    if count.since is None and (counted_ := unix(values, count.name)) is not None and given:
        count = counted_
    if count.since is None:
        return Times(values * count.unit, Clock(), count.name, values, count.name, bool(given))
    seconds = count.seconds(values)
    outside = ~((seconds > -6.2e10) & (seconds < 2.5e11)) | ((values <= 0) & (count.name == EXCEL))
    if outside.any():
        k, form = int(np.argmax(outside)), f"a number of {count.name}, of a year from 1 to 9998"
        form = "days since 1900, as Excel has them" if count.name == EXCEL else form
        raise ValueError(f"{table.text(k)}, column {title}: {values[k]:g}; expected {form}")
    name = IN_WORDS.get(count.name, count.name)
    found = _of_stamps(table, title, count.stamps(values), None if count.local else UTC, log_map, tags, name)
    return found._replace(numbers=values, taken=count.name, stated=bool(given))


def _of_texts(table: Table, title: str, texts: list[str], log_map: LogMap, tags: Sequence[str] | Array | None) -> Times:
    import pandas

    if not log_map.format:
        if texts and OF_DAY.fullmatch(texts[0]):
            return _of_day(table, title, texts, tags)
        for k, text in enumerate(texts):
            if ISO.fullmatch(text):
                continue
            if not (other := iso(text)):
                raise ValueError(f"{table.text(k)}, column {title}: {shown(text)}; expected {_expected(texts, k)}")
            texts[k] = other
        texts = [text.replace(",", ".") for text in texts]
    with_offset = [has_offset(text, log_map.format) for text in texts]
    if len(set(with_offset)) > 1:
        k = with_offset.index(not with_offset[0])
        raise ValueError(
            f"{table.text(k)}, column {title}: {shown(texts[k])} states {'an' if with_offset[k] else 'no'} offset from UTC, "
            "unlike the first row; write all times in one way"
        )

    def parsed(some: Sequence[str]) -> Any:
        form = log_map.format or "ISO8601"
        return pandas.to_datetime(pandas.Series(some, dtype=object), format=form, utc=with_offset[0], errors="coerce")

    try:
        stamps = parsed(texts)
        if (bad := np.flatnonzero(stamps.isna())).size:
            later = parsed([MIDNIGHT.sub("00", texts[k], count=1) for k in bad]) + pandas.Timedelta(days=1)
            stamps.iloc[bad] = later.where([bool(MIDNIGHT.search(texts[k])) for k in bad]).astype(stamps.dtype).to_numpy()
    except (ValueError, TypeError, re.error) as error:
        raise ValueError(
            f"{table.where}, column {title}: format is {log_map.format!r} ({error}); expected one as strptime takes it"
        ) from error
    if stamps.isna().any():
        k = int(stamps.isna().argmax())
        form = f"a time as {log_map.format}" if log_map.format else "a date and time as 2026-03-01 14:20:05"
        raise ValueError(f"{table.text(k)}, column {title}: {shown(texts[k])}; expected {form}")
    plain = np.asarray(stamps.dt.tz_localize(None) if with_offset[0] else stamps)
    if log_map.format and not re.search("%[djcxDFsU]", log_map.format):
        return _over_midnights((plain - np.datetime64("1900-01-01")) / np.timedelta64(1, "s"), tags)
    if with_offset[0]:
        return _since_first(plain, _offset_zone(texts[0]), log_map, "stamps with their offset from UTC")
    return _of_stamps(table, title, plain, None, log_map, tags, "stamps")


def _of_day(table: Table, title: str, texts: Sequence[str], tags: Sequence[str] | Array | None) -> Times:
    """Times of day without a date; hours from 24 on are of a duration."""
    seconds = np.empty(len(texts))
    for k, text in enumerate(texts):
        if not (match := OF_DAY.fullmatch(text)):
            raise ValueError(f"{table.text(k)}, column {title}: {shown(text)}; expected a time of day, as in the first row")
        seconds[k] = int(match[1]) * 3600 + int(match[2]) * 60 + float(match[3].replace(",", "."))
    if np.any(seconds > DAY):
        return Times(seconds, Clock(), "hours, minutes and seconds since a start")
    return _over_midnights(seconds, tags)


def _over_midnights(seconds: Array, tags: Sequence[str] | Array | None) -> Times:
    """Seconds since midnight as seconds since the midnight before the first row: a jump back by half a day is a new day."""
    t, days = seconds.copy(), 0
    for rows in _by_tag(tags, seconds.size):
        within = (steps := np.diff(seconds[rows]))[np.abs(steps) < DAY / 2]
        if np.sum(within < 0) > np.sum(within > 0):  # the newest come first
            rows = rows[::-1]
        steps = np.diff(seconds[rows], prepend=seconds[rows[0]])
        day = np.cumsum((steps < -DAY / 2).astype(int) - (steps > DAY - 3600.0))  # the latter: a late row of the day before
        t[rows] += DAY * day
        days = max(days, int(day.max()))
    passed = f"; midnight is passed {counted(days, 'time')}" if days else ""
    text = f"the times of day state no date: seconds count from the midnight before the first row{passed}"
    return Times(t, Clock(), "times of day", notes=(Finding("no date", "", days, text),))


def _by_tag(tags: Sequence[str] | Array | None, count: int) -> Iterator[Array]:
    """The rows of each tag in their order; of a table without tags all rows."""
    if tags is None:
        yield np.arange(count)
        return
    import pandas

    names = np.asarray(tags)
    for name in pandas.unique(names):
        yield np.flatnonzero(names == name)


def _expected(texts: Sequence[str], k: int) -> str:
    """The cure for a text that is no ISO time: the formats that all texts have, if any."""
    fitting = []
    for form in COMMON:
        try:
            for text in texts[k : k + 1000]:
                _parsed(text, form)
        except ValueError:
            continue
        fitting.append(f'format = "{form}"')
    if len(fitting) > 1:
        return f"a time without ambiguity: state {' or '.join(fitting)} in a map"
    if fitting:
        return f"seconds or an ISO time: state {fitting[0]} in a map"
    return "a finite number of seconds, or a time as 2026-03-01 14:20:05: state its format in a map"


def _localised(table: Table, title: str, stamps: Array, tz: str, tags: Sequence[str] | Array | None) -> Array:
    """Local stamps in UTC; of an hour that the zone has twice, the order of the rows tells which."""
    import pandas

    found = np.empty_like(stamps)
    for rows in _by_tag(tags, len(stamps)):
        if stamps[rows[-1]] < stamps[rows[0]]:  # the newest come first
            rows = rows[::-1]
        local = pandas.DatetimeIndex(stamps[rows])
        try:
            utc = local.tz_localize(zone(tz), ambiguous="infer")
        except ValueError as error:  # pandas' own and, of an older version, pytz's
            for k, stamp in zip(rows, local, strict=True):
                _require_single(table, title, int(k), stamp, tz, error)
            raise ValueError(f"{table.where}, column {title}: {error}") from error
        found[rows] = np.asarray(utc.tz_convert("UTC").tz_localize(None))
    return found


def _require_single(table: Table, title: str, k: int, stamp: Any, tz: str, error: ValueError) -> None:
    early, late = (stamp.to_pydatetime().replace(tzinfo=zone(tz), fold=fold) for fold in (0, 1))
    if early.utcoffset() == late.utcoffset():
        return
    if early.astimezone(UTC).astimezone(zone(tz)).replace(tzinfo=None) != stamp.to_pydatetime():
        fate = _skipped(early, tz)
    else:
        fate = (
            f"occurs twice, and the order of the rows does not tell which it is in {tz}, where clocks change; export the log "
            f'in UTC or with offsets, or state tz = "{_winter(early)}" of a logger that keeps no summer time'
        )
    raise ValueError(f"{table.text(k)}, column {title}: {stamp} {fate}") from error


def _skipped(stamp: datetime, tz: str) -> str:
    """What is wrong with a local time that its zone skips, and the cure."""
    return (
        f"does not exist in {tz}, where clocks change; correct tz, export the log in UTC, or state "
        f'tz = "{_winter(stamp)}" of a logger that keeps no summer time'
    )


def _winter(stamp: datetime) -> str:
    """The offset of a zone without summer time, near a stamp at which its clocks change."""
    offsets = [stamp.replace(fold=fold).utcoffset() or timedelta() for fold in (0, 1)]
    minutes = int(min(offsets).total_seconds() // 60)
    return f"{'-' if minutes < 0 else '+'}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}"


def _since_first(stamps: Array, own: tzinfo | None, log_map: LogMap, kind: str) -> Times:
    """Seconds since the earliest stamp: stamps in UTC where `own` is the zone that they state, local without a zone if None."""
    first = stamps.min()
    try:
        start = np.datetime64(first, "us").astype(datetime)
        if own is not None:
            start = start.replace(tzinfo=UTC).astimezone(zone(log_map.tz) or own)
    except (OverflowError, ValueError, AttributeError) as error:
        raise ValueError(f"the log begins at {first}; expected a year from 1 to 9998") from error
    return Times(np.asarray((stamps - first) / np.timedelta64(1, "s")), Clock(start), kind)


def _present(table: Table, title: str, column: Any) -> Array:
    """The stamps or durations of a pandas column, in UTC; ValueError for a row without."""
    kind = column.dtype.kind
    stamps = np.asarray(column, dtype="datetime64[ns]" if kind == "M" else "timedelta64[ns]")
    if np.any(np.isnat(stamps)):
        raise ValueError(f"{table.where}, column {title}: row {np.argmax(np.isnat(stamps)) + 1} has no time; drop such rows")
    return stamps


def _first(column: Any) -> Any:
    """The first cell that is not empty, None without any."""
    return next((c for c in column if not (isinstance(c, str) and not c.strip())), None)


def _is_number(cell: Any, log_map: LogMap) -> bool:
    try:
        Numbers(log_map.decimal, log_map.thousands).cell(cell)
    except (ValueError, TypeError, OverflowError):
        return False
    return True


def _text(cell: Any) -> str:
    if isinstance(cell, datetime):
        return cell.isoformat(sep=" ")
    return cell.strip() if isinstance(cell, str) else str(cell)


def has_offset(text: str, form: str) -> bool:
    """Whether a stamp states its offset from UTC: by its format, or as ISO 8601 has it."""
    return "%z" in form if form else bool(OFFSET.fullmatch(text[10:]) or OFFSET.search(text[16:]))


def _offset_zone(text: str) -> tzinfo:
    """The fixed zone of a stamp that ends in its offset, UTC for any other."""
    match = re.search(r"([+-])(\d\d):?(\d\d)?$", text)
    if match is None:
        return UTC
    away = timedelta(hours=int(match[2]), minutes=int(match[3] or 0))
    return timezone(-away if match[1] == "-" else away)
