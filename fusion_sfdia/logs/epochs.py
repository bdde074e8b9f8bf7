"""Numbers as times: a unit and the moment from which it counts, or the digits of a calendar; and what a number may stand for.

A map states "s", "ms since 1970", "s since 1904-01-01", "100 ns since 1601-01-01", "excel" or "%Y%m%d%H%M%S". A count of days
is of the wall clock, as spreadsheets write it; any other count, and one from a moment with its offset, is in UTC.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import posix

Array = NDArray[Any]

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
WORDS = {
    "sec": "s",
    "second": "s",
    "millisecond": "ms",
    "msec": "ms",
    "microsecond": "us",
    "usec": "us",
    "µs": "us",
    "μs": "us",
}
WORDS |= {"nanosecond": "ns", "minute": "min", "hour": "h", "hr": "h", "day": "d"}
EXCEL, UNIX = "excel", ("s", "ms", "us", "ns")
NAMES = {EXCEL: "d since 1899-12-30", "labview": "s since 1904-01-01", "filetime": "100 ns since 1601-01-01"}
NAMES |= {"ticks": "100 ns since 0001-01-01"}  # of .NET
IN_WORDS = {
    EXCEL: "days of Excel", "labview": "s since 1904, as LabVIEW counts them", "matlab": "days as MATLAB counts them",
    "julian": "Julian days", "filetime": "FILETIME of Windows", "ticks": "ticks of .NET",
}  # fmt: skip
DAY_ZERO = {"matlab": -719529.0, "julian": -2440587.5}  # days from 1970-01-01 to day 0, of which no calendar has a date
COUNT = re.compile(r"\s*(\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)?\s*([a-zµμ]+)\s+since\s+(\S.*?)\s*", re.I)
YEARS = (6.3e8, 4.1e9)  # s since 1970: numbers of the years 1990 to 2099
FIRST = 631152000.0  # s since 1970, 1990-01-01: no log is older
# digits of the calendar, by their number: years first, and orders that may be taken for them
CALENDARS = {
    8: ("%Y%m%d", "%d%m%Y", "%m%d%Y"),
    10: ("%Y%m%d%H", "%y%m%d%H%M"),
    12: ("%Y%m%d%H%M", "%y%m%d%H%M%S", "%d%m%y%H%M%S"),
    14: ("%Y%m%d%H%M%S", "%d%m%Y%H%M%S", "%m%d%Y%H%M%S"),
}
NEAR, FAR = 50.0, 1e3  # two steps within these factors of each other may be of one log, and are worth a question
SHORTEST, LONGEST = 1e-3, 86400.0  # s between the rows of a log of which nothing is known
LONGEST_COUNT = 1e9  # s: nothing is older than 30 years at the end of a log
MOST = 3  # candidates that a finding names


class EpochCount(NamedTuple):
    """What a number counts: units of so many seconds, since a moment (s since 1970, None: a start of its own)."""

    name: str
    unit: float
    since: float | None = None
    local: bool = False  # of the wall clock

    def seconds(self, values: Any) -> Any:
        """Numbers in seconds, since 1970 where the moment of their start is known."""
        if self.since is None:
            return values * self.unit
        start = self.since / self.unit if self.unit > 1e-2 else self.since * round(1.0 / self.unit)  # exact of small units
        return (values + start) * self.unit

    def stamps(self, values: Array) -> Array:
        """Numbers (K,) as datetime64, to the millisecond where they count days, else to the microsecond."""
        grain = 1e3 if self.local else 1e6
        micro: Array = (np.round(self.seconds(values) * grain) * (1e6 / grain)).astype("timedelta64[us]")
        return np.datetime64(0, "us") + micro


class Calendar(NamedTuple):
    """A number whose digits are a date and time of the wall clock, by its strptime format."""

    name: str


def count_of(text: str) -> EpochCount | None:
    """The count that a text states: a unit, "<unit> since <date>", or a name; None for any other text."""
    if text in DAY_ZERO:
        return EpochCount(text, 86400.0, DAY_ZERO[text] * 86400.0, local=True)
    match = COUNT.fullmatch(NAMES.get(text, text))
    if match is None:
        return EpochCount(text, SECONDS[text]) if text in SECONDS else None
    factor, unit, date = match.groups()
    unit = unit if unit in SECONDS else WORDS.get(unit.casefold().removesuffix("s"), WORDS.get(unit, ""))
    try:
        moment = datetime.fromisoformat(f"{date}-01-01" if re.fullmatch(r"\d{4}", date) else date.upper().replace(" UTC", "Z"))
    except ValueError:
        return None
    if not unit or not float(factor or 1.0) > 0:
        return None
    return EpochCount(text, float(factor or 1.0) * SECONDS[unit], posix(moment), local=unit == "d" and moment.tzinfo is None)


def since_1970(unit: str) -> EpochCount:
    """The count of a unit since 1970."""
    return EpochCount(f"{unit} since 1970", SECONDS[unit], 0.0)


# counts with a date that occur, by which numbers are recognised or asked about
DATED = tuple(
    EpochCount(count.name if short is None else short, *count[1:])
    for short, text in (
        *((None, f"{unit} since {year}") for year in (1970, 1904) for unit in UNIX),
        ("excel", "excel"),
        *((None, text) for text in ("1e-6 d since 1899-12-30", "d since 1970-01-01", "matlab", "julian", "filetime", "ticks")),
    )
    if (count := count_of(text)) is not None
)


def unix(values: Array, unit: str = "") -> EpochCount | None:
    """The count since 1970 by which all numbers are of the years 1990 to 2099, in that unit, or in any if ""; None if none."""
    for name in (unit,) if unit else UNIX:
        seconds = values * SECONDS[name]
        if np.all((seconds >= YEARS[0]) & (seconds < YEARS[1])):
            return since_1970(name)
    return None


def dated(values: Array, latest: float) -> list[EpochCount]:
    """The counts by which all numbers are of the years from 1990 to `latest`, s since 1970."""
    ends = np.array([np.min(values), np.max(values)])
    return [c for c in DATED if np.all((c.seconds(ends) >= FIRST) & (c.seconds(ends) <= latest))]


def calendars(values: Array, latest: float) -> list[Calendar]:
    """The calendars by which the digits of all numbers are dates from 1990 to `latest`, s since 1970."""
    whole = np.floor(values)
    low, high = float(np.min(whole)), float(np.max(whole))
    found = []
    for digits, forms in CALENDARS.items():
        if not 10 ** (digits - 2) <= low <= high < 10**digits or (digits < 14 and np.any(whole != values)):
            continue
        for form in forms:
            if low < 10 ** (digits - 1) and (digits < 12 or form[1] not in "dm"):
                continue  # a number lacks the zero of the first days and months
            stamps = calendar_stamps(values, form)
            if stamps is not None and FIRST <= _since_1970(stamps.min()) and _since_1970(stamps.max()) <= latest:
                found.append(Calendar(form))
    return found


def calendar_stamps(values: Array, form: str) -> Array | None:
    """Numbers (K,) whose digits are a date, as datetime64; None where one of them is no date. A fraction is one of a second."""
    whole = np.floor(values)
    digits, parts = whole.astype(np.int64), {}
    for code in re.findall("%(.)", form)[::-1]:
        size = 10_000 if code == "Y" else 100
        parts[code], digits = digits % size, digits // size
    zero = np.zeros(whole.shape, np.int64)
    year, month, day = parts.get("Y", parts.get("y", zero) + 2000), parts["m"], parts["d"]
    hour, minute, second = (parts.get(code, zero) for code in "HMS")
    if np.any(digits != 0) or not np.all((month >= 1) & (month <= 12) & (day >= 1) & (year >= 1)):
        return None
    months = (year - 1970).astype("datetime64[Y]").astype("datetime64[M]") + (month - 1)
    dates = months.astype("datetime64[D]") + (day - 1)
    midnight = (hour == 24) & (minute == 0) & (second == 0)
    if np.any(dates.astype("datetime64[M]") != months) or not np.all(((hour < 24) | midnight) & (minute < 60) & (second < 60)):
        return None
    fraction = np.round((values - whole) * 1e6).astype(np.int64)
    found: Array = dates.astype("datetime64[us]") + ((hour * 60 + minute) * 60 + second) * 1_000_000 + fraction
    return found


def _since_1970(stamp: Any) -> float:
    return float((stamp - np.datetime64(0, "us")) / np.timedelta64(1, "s"))


def is_near(step: float, dt: float) -> bool:
    """Whether rows `step` apart may be of a plant whose readings are dt apart."""
    return 1 / NEAR <= step / dt <= NEAR


class AmbiguousTimesError(ValueError):
    """Numbers that are times in several ways: `texts` states each, as a map does, with the times that it gives."""

    def __init__(self, texts: Sequence[str]) -> None:
        super().__init__(", or ".join(texts))
        self.texts = texts


def recognised(values: Array, dt: float | None, latest: float) -> EpochCount | Calendar:
    """What numbers (K,) without a stated unit are: seconds, a count since 1970 or of days, or digits of the calendar.

    dt: the usual step of the plant, s, or None where it is not known. latest: the present, s since 1970, with what a clock may
    be ahead. Where more than seconds fits, dt decides, and AmbiguousTimesError is raised where it does not.
    """
    counted, digits = unix(values), _of_one_calendar(values, calendars(values, latest))
    first = counted or EpochCount("s", 1.0)
    absurd = counted is None and values.max() > 1e10  # 300 years of seconds
    ahead = counted is not None and float(np.max(counted.seconds(values))) > latest
    if digits and (counted is None or ahead):
        regular = _steady(values) >= max(_steady_calendar(values, c.name) for c in digits)
        seconds_fit = dt is not None and values.max() < LONGEST_COUNT and regular and is_near(usual_step(values), dt)
        if len(digits) == 1 and (not seconds_fit or is_near(_step_as(values, digits[0]), dt or 1.0)):
            return digits[0]
        possible: list[EpochCount | Calendar] = [*digits, first] if seconds_fit else [*digits]
        raise AmbiguousTimesError([shown_as(values, c) for c in possible])
    if ahead:
        return first
    others: list[EpochCount | Calendar] = [c for c in dated(values, latest) if c.name != first.name]
    if others and counted is None and values.max() > 1e15:  # 30 million years of seconds
        return others[0]
    others += digits
    if dt is None:
        likely = [c for c in others if 0 < _step_as(values, c) <= 3600.0] if counted is None else []
        if likely and (absurd or not _is_round(values)):
            raise AmbiguousTimesError([shown_as(values, c) for c in (*likely, EpochCount("us", 1e-6) if absurd else first)])
        return first
    if is_near(_step_as(values, first), dt) and not absurd:
        return first
    fitting = [c for c in others if is_near(_step_as(values, c), dt)]
    if len(fitting) > 1:
        raise AmbiguousTimesError([shown_as(values, c) for c in fitting])
    return fitting[0] if fitting else first


def _of_one_calendar(values: Array, digits: list[Calendar]) -> list[Calendar]:
    """Of calendars that all fit the one with the year first, and those by which the steps are more regular."""
    by_year = [c for c in digits if c.name.startswith("%Y")]
    if len(by_year) != 1 or len(values) < 2:
        return digits
    steady = _steady_calendar(values, by_year[0].name)
    return [c for c in digits if c in by_year or _steady_calendar(values, c.name) > steady]


def candidates(values: Array, taken: str, dt: float | None, latest: float) -> list[EpochCount | Calendar]:
    """What numbers (K,) may be that are taken as the count of that name, the likeliest first, at most MOST of them.

    Those are counts whose steps are within FAR of dt, the nearest first, or without dt between SHORTEST and LONGEST; of counts
    since a date those with dates that a log can have.
    """
    counts: list[EpochCount | Calendar] = [*calendars(values, latest), *dated(values, latest)]
    counts += [EpochCount(name, unit) for name, unit in SECONDS.items() if np.max(np.abs(values)) * unit <= LONGEST_COUNT]

    def away(c: EpochCount | Calendar) -> float:
        own = _step_as(values, c)
        if not own:
            return 0.0
        if dt is not None:
            return abs(float(np.log(own / dt)))
        return 0.0 if SHORTEST <= own <= LONGEST else np.inf

    others = [c for c in counts if c.name != taken and away(c) <= np.log(FAR)]
    return sorted(others, key=lambda c: (round(away(c), 6), isinstance(c, EpochCount) and c.since is None))[:MOST]


def usual_step(values: Array) -> float:
    """The median of the steps other than 0, without their sign; 0 without any."""
    steps = np.abs(np.diff(values))
    return float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0


def _is_round(values: Array) -> bool:
    """Whether numbers have few digits behind the point, as seconds do, and days, of which a minute is 0.00069444, have not."""
    return bool(np.all(np.abs(values * 1e3 - np.round(values * 1e3)) < 1e-3))


def _step_as(values: Array, what: EpochCount | Calendar) -> float:
    """The usual step (s) of numbers that are counts or digits of a calendar."""
    return usual_step(_seconds_of(values, what.name)) if isinstance(what, Calendar) else usual_step(values) * what.unit


def _seconds_of(values: Array, form: str) -> Array:
    """Seconds since the first of numbers whose digits are dates."""
    stamps = calendar_stamps(values, form)
    return np.zeros(values.shape) if stamps is None else (stamps - stamps[0]) / np.timedelta64(1, "s")


def _steady(values: Array) -> float:
    """The share of the steps that are the usual one: small of numbers that are read as what they are not."""
    steps = np.abs(np.diff(values))
    return float(np.mean(np.isclose(steps, np.median(steps), rtol=0.01))) if steps.size else 1.0


def _steady_calendar(values: Array, form: str) -> float:
    return _steady(_seconds_of(values, form))


def shown_as(values: Array, what: EpochCount | Calendar) -> str:
    """A way to read numbers, in a map's words, with the time that it gives the first, and the step: "format = "ms" (...)"."""
    form = what.name.removesuffix(" since 1970") if isinstance(what, EpochCount) and what.unit <= 1.0 else what.name
    if isinstance(what, Calendar):
        stamps = calendar_stamps(values, what.name)
        assert stamps is not None
        first = str(stamps[0].astype("datetime64[s]")).replace("T", " ")
    else:
        first = f"{values[0] * what.unit:.6g} s after a start"
        if what.since is not None:
            first = f"{datetime(1970, 1, 1) + timedelta(seconds=float(what.seconds(values[0]))):%Y-%m-%d %H:%M:%S}"
    step = _step_as(values, what)
    apart = f", rows {step:.6g} s apart" if step else ""
    return f'format = "{form}" ({first}{apart})'
