"""The rows of a log in the order of their times, one for each time."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.logs.loaded_log import Finding, counted, others
from fusion_sfdia.logs.log_map import SPREAD, LogMap
from fusion_sfdia.logs.problems import CountedError, Problems

Array = NDArray[Any]

HOUR, DAY = 3600.0, 86400.0
FEW = 3  # rows that may be late; more are of a clock that was set
RESETS = (1970, 1980, 1990, 2000)
# where clocks change, one place of each rule and zone
PLACES = (
    "Europe/Berlin", "Europe/London", "Europe/Helsinki", "America/New_York", "America/Chicago", "America/Denver",
    "America/Los_Angeles", "America/St_Johns", "America/Santiago", "Australia/Sydney", "Australia/Adelaide", "Pacific/Auckland",
)  # fmt: skip


class LogRows(NamedTuple):
    """A log by time: t (K,), the row of each time in the file, and the numbers of each column (K,) as logged."""

    t: Array
    rows: Array
    values: dict[str, Array]

    def kept(self, chosen: Any) -> LogRows:
        return LogRows(self.t[chosen], self.rows[chosen], {title: v[chosen] for title, v in self.values.items()})


def in_order(where: str, rows: LogRows, clock: Clock, log_map: LogMap, findings: list[Finding], problems: Problems) -> LogRows:
    """The rows with increasing times: sorted, and one for each time, as the map has it; problems takes what it refuses."""
    back, column = np.flatnonzero(np.diff(rows.t) < 0), " ".join(log_map.time)
    if back.size:
        with problems.collecting("order"):
            require_one_clock(where, rows, clock, log_map)
        if problems.of("order"):
            return _one_of_each_time(rows.kept(np.argsort(rows.t, kind="stable")), "first")
        if log_map.order == "refuse":
            k = int(back[0]) + 1
            text = (
                f"{_at(clock, rows.t[k])} after {_at(clock, rows.t[k - 1])}{others(back.size)}; times must increase: sort the "
                'rows, or state order = "sort" in a map'
            )
            problems.add("order", text, row=int(rows.rows[k]), column=column, count=back.size)
        findings += stuck_dates(rows, clock)
        newest = back.size == np.count_nonzero(np.diff(rows.t)) and back.size > 1
        rows = rows.kept(np.argsort(rows.t, kind="stable"))
        text = "rows sorted by time" + (": the newest came first" if newest else f", {back.size} came after a later one")
        findings.append(Finding("order", "", back.size, text))
    if log_map.duplicates == SPREAD:
        t = spread(rows.t)
        if count := int(np.sum(t != rows.t)):
            findings.append(spread_finding(count))
        rows = rows._replace(t=t)
    again = np.flatnonzero(np.diff(rows.t) == 0) + 1
    if again.size:
        if log_map.duplicates == "refuse" and _are_parts(rows):
            text = f"{counted(again.size, 'row')} joined with the one before of the same time, which lacks these readings"
            findings.append(Finding("duplicates", "", again.size, text))
        elif log_map.duplicates == "refuse":
            k = int(again[0])
            with problems.collecting("order"):
                raise twice(f"{where}, row {rows.rows[k]}", column, clock, float(rows.t[k]), again.size, rows.rows[k - 1])
        else:
            findings.append(dropped(again.size, log_map))
        rows = _one_of_each_time(rows, log_map.duplicates if log_map.duplicates in ("first", "last", "mean") else "first")
    return rows


def _are_parts(rows: LogRows) -> bool:
    """Whether sorted rows of one time have readings each, and none that another has, as where each tag writes its own."""
    known = np.array([np.isfinite(v) for v in rows.values.values()]).reshape(-1, rows.t.size)
    first = np.flatnonzero(np.diff(rows.t, prepend=-np.inf) > 0)
    again = np.diff(rows.t, prepend=-np.inf) == 0
    again[:-1] |= again[1:]
    return bool(known[:, again].any(axis=0).all() and (np.add.reduceat(known, first, axis=1, dtype=int) <= 1).all())


def _one_of_each_time(rows: LogRows, which: str) -> LogRows:
    """Sorted rows, of those with one time the first, the last or the mean of the values that are there."""
    import pandas

    first = np.flatnonzero(np.diff(rows.t, prepend=-np.inf) > 0)
    merged = pandas.DataFrame(rows.values).groupby(rows.t, sort=True).agg(which) if rows.values else None
    values = {} if merged is None else {n: merged[n].to_numpy() for n in rows.values}
    return LogRows(rows.t[first], rows.rows[first], values)


def spread(t: Array) -> Array:
    """Times (K,) in order, of which equal ones are spread evenly until the next, at most as far as stamps usually are apart.

    The first and the last stamp may have fewer rows than the others: these are the last and the first of a usual number.
    """
    first = np.flatnonzero(np.diff(t, prepend=-np.inf) > 0)
    counts = np.diff(np.append(first, t.size))
    if first.size < 2 or np.all(counts == 1):
        return t
    steps = np.diff(t[first])
    usual = float(np.median(steps))
    room, most = np.minimum(np.append(steps, usual), usual), int(np.median(counts))
    places = counts.copy()
    places[[0, -1]] = np.maximum(places[[0, -1]], most)
    skipped = np.zeros_like(counts)
    skipped[0] = places[0] - counts[0]
    number = np.arange(t.size) - np.repeat(first, counts) + np.repeat(skipped, counts)
    found: Array = t + number * np.repeat(room / places, counts)
    return found


def require_one_clock(where: str, rows: LogRows, clock: Clock, log_map: LogMap) -> None:
    """Raise ValueError, with what has happened and the cure, where the clock of the logger was set back among the rows.

    Where times go back, the rows before and after are two runs. Runs that do not overlap were joined in another order, and of
    rows that are late few do: both are sorted. Where more than FEW rows of each overlap, one clock showed these times twice,
    unless they are the same rows.
    """
    steps = np.diff(rows.t)
    if np.sum(steps < 0) > np.sum(steps > 0):  # the newest come first
        rows, steps = rows.kept(slice(None, None, -1)), -steps[::-1]
    t, step = rows.t, float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    bounds = np.concatenate([[0], np.flatnonzero(steps < 0) + 1, [t.size]])
    in_an_hour = max(int(HOUR // step) - 1, 1) if step else FEW + 1
    of_note = np.minimum(np.diff(bounds)[:-1], np.diff(bounds)[1:]) >= min(FEW + 1, in_an_hour)
    for i in np.flatnonzero(of_note):
        before, k, after = bounds[i : i + 3]
        back = float(t[k - 1] - t[k]) + step
        low, high = max(t[before], t[k]), min(t[k - 1], t[after - 1])
        shared = [np.flatnonzero((t[a:b] >= low) & (t[a:b] <= high)) + a for a, b in ((before, k), (k, after))]
        fewest = min(map(len, shared)) if low <= high else 0
        hour = abs(back - HOUR) <= min(0.6 * step + 1.0, 0.1 * HOUR) and fewest >= min(FEW + 1, in_an_hour)
        reset = fewest == 0 and _is_reset(clock, float(t[k])) and t[before] - t[after - 1] > DAY
        day = log_map.order == "refuse" and clock.start is not None and abs(back - DAY) <= step + 1.0
        if (fewest <= FEW and not hour and not reset and not day) or (fewest and _same_rows(rows, *shared)):
            continue
        at = f"{where}, row {rows.rows[k]}, column {' '.join(log_map.time)}: {_at(clock, t[k])} after {_at(clock, t[k - 1])}"
        cause = _cause(clock, float(t[k]), back, step, hour, log_map)
        joined = (
            '; or state order = "sort" in a map, if parts of a day were joined in another order'
            if fewest <= FEW and day
            else ""
        )
        raise ValueError(f"{at}; {cause}{joined}")


def stuck_dates(rows: LogRows, clock: Clock) -> list[Finding]:
    """A finding on rows behind a midnight at which the date did not change, which sorting puts before those of the evening.

    Parts of one day that were joined in another order follow each other once sorted; these leave most of a day between.
    """
    t, steps = rows.t, np.diff(rows.t)
    if clock.start is None or not np.any(steps > 0):
        return []
    step = float(np.median(steps[steps > 0]))
    bounds = np.concatenate([[0], np.flatnonzero(steps < 0) + 1, [t.size]])
    for before, k, after in zip(bounds[:-2], bounds[1:-1], bounds[2:], strict=True):
        if abs(float(t[k - 1] - t[k]) + step - DAY) <= step + 1.0 and t[before] - t[after - 1] > 2.0 * step:
            text = (
                f"{_at(clock, t[k])} in row {rows.rows[k]} after {_at(clock, t[k - 1])}: the date seems not to "
                "change at midnight, and sorted by time the rows behind it come before: correct the dates from there on"
            )
            return [Finding("dates", "", int(after - k), text)]
    return []


def _cause(clock: Clock, t: float, back: float, step: float, hour: bool, log_map: LogMap) -> str:
    """Why times go back, and the cure."""
    local = None if clock.start is None else clock.start.replace(tzinfo=None) + timedelta(seconds=t)
    cut = "cut the log in two there, or correct the times of one part; sorting would mix them"
    if hour and local is not None and clock.start is not None and clock.start.tzinfo is None:
        places = places_changing(local, back=True)
        which = f" ({', '.join(places)})" if places else ""
        place = places[0] if places else "Europe/Berlin"
        return f'an hour comes twice, as where summer time ends{which}: state the zone of the logger in a map: tz = "{place}"'
    if hour and local is not None and log_map.tz:
        local = (clock.start + timedelta(seconds=t)).replace(tzinfo=None) if clock.start else local
        places = places_changing(local, back=True)
        rule = f" but in {', '.join(places)}: state the zone whose rule the logger keeps, or else " if places else ": "
        return f"an hour comes twice, where clocks do not change in {log_map.tz}{rule}{cut}"
    if abs(back - DAY) <= step + 1.0 and local is not None:
        times_alone = f"; or state time = {log_map.time[1]!r} alone" if len(log_map.time) == 2 else ""
        return f"the date does not change at midnight: correct the dates from there on{times_alone}"
    if local is None and t <= 2.0 * step:
        return f"the count begins anew, as of a logger that was started again: {cut}"
    return f"the clock of the logger was set back by {back:.6g} s, which is no late row: {cut}"


def places_changing(local: datetime, *, back: bool) -> list[str]:
    """The first of PLACES whose clocks are put back at the end of the hour that begins near `local`, or put ahead over it."""
    found = []
    for place in PLACES:
        early, late = (local.replace(tzinfo=ZoneInfo(place), fold=fold) for fold in (0, 1))
        change = early.utcoffset() != late.utcoffset()
        skipped = change and early.astimezone(UTC).astimezone(ZoneInfo(place)).replace(tzinfo=None) != local
        if change and skipped is not back:
            found.append(place)
    return found[:3]


def _is_reset(clock: Clock, t: float) -> bool:
    """Whether a time is that at which a clock without a battery begins: the first day of 1970, 1980 and the like."""
    if clock.start is None:
        return False
    at = clock.start.replace(tzinfo=None) + timedelta(seconds=t)
    return at.year in RESETS and at.timetuple().tm_yday <= 2


def _same_rows(rows: LogRows, before: Array, after: Array) -> bool:
    """Whether rows of two runs are the same ones, as where exports overlap."""
    both, a, b = np.intersect1d(rows.t[before], rows.t[after], return_indices=True)
    if both.size < 0.9 * min(before.size, after.size):
        return False
    return all(np.array_equal(v[before[a]], v[after[b]], equal_nan=True) for v in rows.values.values())


def twice(row: str, column: str, clock: Clock, t: float, count: int, other: int | None = None, of: str = "") -> CountedError:
    """The error on a second value at one time, the first of so many, and in a long format of one tag."""
    before = "" if other is None else f", as in row {other}"
    local = None if clock.start is None or clock.start.tzinfo else clock.start + timedelta(seconds=t)
    places = [] if local is None else places_changing(local, back=True)
    zone = f'; or state tz = "{places[0]}" if this is the hour that comes twice there' if places else ""
    return CountedError(
        f"{row}, column {column}: {_at(clock, t)}{of} again{before}{others(count)}; times must increase: keep one row of each "
        f'time, or state duplicates = "first", "last", "mean" or "spread", evenly until the next time, in a map{zone}',
        count,
    )


def spread_finding(count: int) -> Finding:
    """The finding on rows whose time was another's, too."""
    return Finding("duplicates", "", count, f"{counted(count, 'row')} of a time stated before spread evenly")


def dropped(count: int, log_map: LogMap) -> Finding:
    """The finding on values at one time, of which one is kept."""
    fate = "averaged" if log_map.duplicates == "mean" else f"dropped, the {log_map.duplicates} of each time kept"
    return Finding("duplicates", "", count, f"{counted(count, 'duplicate')} {fate}")


def _at(clock: Clock, t: float) -> str:
    return f"{float(t)!r} s" if clock.start is None else clock.at(float(t))
