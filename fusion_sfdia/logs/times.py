"""The times of a log: seconds, numbers since 1970, or stamps in text; in seconds since the first, with its wall-clock time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import shown
from fusion_sfdia.core.clock import Clock
from fusion_sfdia.logs.log_map import SECONDS, LogMap, zone
from fusion_sfdia.logs.numbers import NotANumberError, Numbers
from fusion_sfdia.logs.tables import Table

Array = NDArray[Any]

EPOCH = (6.3e8, 4.1e9)  # s since 1970: numbers of the years 1990 to 2099
ISO = re.compile(r"\d{4}-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d(?:[.,]\d{1,9})?)?)?(?:Z|[+-]\d\d(?::?\d\d)?)?", re.ASCII | re.I)
OFFSET = re.compile(r"(?:Z|[+-]\d\d(?::?\d\d)?)", re.I)
DAYS = ("%d-%m-%Y", "%d/%m/%Y", "%m/%d/%Y", "%d.%m.%Y", "%Y/%m/%d", "%d-%b-%y", "%d-%b-%Y")
COMMON = tuple(f"{day} {hour}" for day in DAYS for hour in ("%H:%M:%S", "%H:%M", "%I:%M:%S %p"))
EXCEL = np.datetime64("1899-12-30", "ms")  # day 0, with which days from 1900-03-01 on are right


class Times(NamedTuple):
    """Seconds t (K,), since the first stamp where the log has stamps; and where a row is in no order, as the log has it."""

    t: Array
    clock: Clock
    kind: str  # how the times were written, in words


UNKNOWN = "unknown"


def unknown_times(count: int) -> Times:
    """Times in place of those that cannot be read, by which the other columns of so many rows are looked through."""
    return Times(np.arange(count, dtype=float), Clock(), UNKNOWN)


def times_of(table: Table, titles: Sequence[str], unit: str, log_map: LogMap, tags: Sequence[str] | None = None) -> Times:
    """Return the times of a table from the columns of these titles, one, or two that are joined.

    unit: that the column's title states for numbers. tags: of a long format, in which each tag has its own order. ValueError
    that names row and column for what is no time, for a time that the zone does not have and for one that it has twice.
    """
    column, title = table.column(titles[0]), " ".join(titles)
    if len(titles) == 2:
        column = [f"{str(a).strip()} {str(b).strip()}" for a, b in zip(column, table.column(titles[1]), strict=True)]
    kind = getattr(getattr(column, "dtype", None), "kind", "O")
    if kind == "m":
        return Times(_present(table, title, column) / np.timedelta64(1, "s"), Clock(), "durations")
    if kind == "M":
        stamps, own = _present(table, title, column), getattr(column.dtype, "tz", None)
        if own is not None or not log_map.tz:
            return _since_first(stamps, own, log_map, "time stamps")
        return _since_first(_localised(table, title, stamps, log_map.tz, tags), UTC, log_map, f"time stamps of {log_map.tz}")
    if not log_map.has_pattern and (kind in "biuf" or log_map.format or _is_number(_first(column), log_map)):
        return _of_numbers(table, title, column, unit, log_map)
    return _of_texts(table, title, [_text(c) for c in column], log_map, tags)


def _of_numbers(table: Table, title: str, column: Any, unit: str, log_map: LogMap) -> Times:
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
    if log_map.format == "excel":
        days = np.round(values * 86400e3)
        if not np.all((days > 0) & (days < 3e15)):
            raise ValueError(f"{table.where}, column {title}: {values[0]:g}; expected days since 1900, as Excel has them")
        stamps = EXCEL + days.astype("timedelta64[ms]")
        if log_map.tz:
            return _since_first(_localised(table, title, stamps, log_map.tz, None), UTC, log_map, "days of Excel")
        return _since_first(stamps, None, log_map, "days of Excel")
    given = log_map.format or unit
    for name in [given] if given else ("s", "ms", "us", "ns"):
        low, high = (limit / SECONDS[name] for limit in EPOCH)
        if np.all((values >= low) & (values < high)):
            micro = np.round(values * (SECONDS[name] * 1e6)) if SECONDS[name] >= 1e-6 else np.round(values / 1e3)
            stamps = np.datetime64(0, "us") + micro.astype("timedelta64[us]")
            return _since_first(stamps, UTC, log_map, f"{name} since 1970")
    return Times(values * SECONDS[given or "s"], Clock(), given or "s")


def _of_texts(table: Table, title: str, texts: list[str], log_map: LogMap, tags: Sequence[str] | None) -> Times:
    import pandas

    if not log_map.format:
        for k, text in enumerate(texts):
            if not ISO.fullmatch(text):
                raise ValueError(f"{table.text(k)}, column {title}: {shown(text)}; expected {_expected(texts, k)}")
        texts = [text.replace(",", ".") for text in texts]
    with_offset = [has_offset(text, log_map.format) for text in texts]
    if len(set(with_offset)) > 1:
        k = with_offset.index(not with_offset[0])
        raise ValueError(
            f"{table.text(k)}, column {title}: {shown(texts[k])} states {'an' if with_offset[k] else 'no'} offset from UTC, "
            "unlike the first row; write all times in one way"
        )
    try:
        stamps = pandas.to_datetime(
            pandas.Series(texts, dtype=object), format=log_map.format or "ISO8601", utc=with_offset[0], errors="coerce"
        )
    except (ValueError, TypeError, re.error) as error:
        raise ValueError(
            f"{table.where}, column {title}: format is {log_map.format!r} ({error}); expected one as strptime takes it"
        ) from error
    if stamps.isna().any():
        k = int(stamps.isna().argmax())
        form = f"a time as {log_map.format}" if log_map.format else "a date and time as 2026-03-01 14:20:05"
        raise ValueError(f"{table.text(k)}, column {title}: {shown(texts[k])}; expected {form}")
    plain = np.asarray(stamps.dt.tz_localize(None) if with_offset[0] else stamps)
    if with_offset[0]:
        return _since_first(plain, _offset_zone(texts[0]), log_map, "stamps with their offset from UTC")
    if log_map.tz:
        return _since_first(_localised(table, title, plain, log_map.tz, tags), UTC, log_map, f"stamps of {log_map.tz}")
    return _since_first(plain, None, log_map, "stamps")


def _expected(texts: Sequence[str], k: int) -> str:
    """The cure for a text that is no ISO time: the formats that all texts have, if any."""
    fitting = []
    for form in COMMON:
        try:
            for text in texts[k : k + 1000]:
                datetime.strptime(text, form)
        except ValueError:
            continue
        fitting.append(f'format = "{form}"')
    if len(fitting) > 1:
        return f"a time without ambiguity: state {' or '.join(fitting)} in a map"
    if fitting:
        return f"seconds or an ISO time: state {fitting[0]} in a map"
    return "a finite number of seconds, or a time as 2026-03-01 14:20:05: state its format in a map"


def _localised(table: Table, title: str, stamps: Array, tz: str, tags: Sequence[str] | None) -> Array:
    """Local stamps in UTC; of an hour that the zone has twice, the order of the rows tells which."""
    import pandas

    found = np.empty_like(stamps)
    names = np.zeros(len(stamps)) if tags is None else np.asarray(tags)
    for group in pandas.unique(names):
        rows = np.flatnonzero(names == group)
        if stamps[rows[-1]] < stamps[rows[0]]:  # the newest come first
            rows = rows[::-1]
        local = pandas.DatetimeIndex(stamps[rows])
        try:
            utc = local.tz_localize(tz, ambiguous="infer")
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
        fate, cure = "does not exist", "correct tz, or export the log in UTC"
    else:
        fate, cure = (
            "occurs twice, and the order of the rows does not tell which it is",
            "export the log in UTC or with offsets",
        )
    raise ValueError(f"{table.text(k)}, column {title}: {stamp} {fate} in {tz}, where clocks change; {cure}") from error


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
