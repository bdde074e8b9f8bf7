"""Rows that are late are sorted; clocks that were set back, at the end of summer time or else, are named with their cure."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from toy_plants import tanks

from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.logs.time_order import spread

PLANT = tanks()


def load(folder: Path, times: Sequence[Any], values: Sequence[float] = (), **log_map: Any) -> LoadedLog:
    levels = values or [1 + 1e-4 * k for k in range(len(times))]
    rows = [f"{t},{v!r},1,6e-4,6e-4,6e-4\n" for t, v in zip(times, levels, strict=True)]
    path = folder / "log.csv"
    path.write_text("time,l1,l2,q12,q2,inflow\n" + "".join(rows), encoding="utf-8")
    return load_log(path, PLANT, LogMap(**log_map))


def stamps(start: datetime, place: str, step: float, count: int) -> list[str]:
    """Stamps of a logger whose clock shows the time of a place, from a moment in UTC."""
    moments = (start.replace(tzinfo=UTC) + timedelta(seconds=step * k) for k in range(count))
    return [m.astimezone(ZoneInfo(place)).strftime("%Y-%m-%d %H:%M:%S") for m in moments]


ENDS = {
    "Europe/Berlin": datetime(2024, 10, 26, 23),
    "Europe/London": datetime(2023, 10, 28, 23),
    "America/New_York": datetime(2024, 11, 3, 4),
    "Australia/Sydney": datetime(2024, 4, 6, 14),
}


@pytest.mark.parametrize("order", ["refuse", "sort"])
@pytest.mark.parametrize("step", [10.0, 60.0, 900.0, 1800.0])
@pytest.mark.parametrize("place", ENDS)
@pytest.mark.parametrize("newest_first", [False, True])
def test_an_hour_back_is_the_end_of_summer_time(
    tmp_path: Path, place: str, step: float, order: str, newest_first: bool
) -> None:
    times = stamps(ENDS[place], place, step, int(14400 / step))
    times = times[::-1] if newest_first else times
    with pytest.raises(
        ValueError, match=rf'an hour comes twice, as where summer time ends .*{place}.* in a map: tz = "'
    ) as error:
        load(tmp_path, times, order=order)
    assert "sort" not in str(error.value)
    found = load(tmp_path, times, tz=place, order="sort")
    assert np.allclose(np.diff(found.log.t), step)


def test_an_hour_back_at_rows_an_hour_apart(tmp_path: Path) -> None:
    times = stamps(ENDS["Europe/Berlin"], "Europe/Berlin", 3600.0, 6)
    with pytest.raises(ValueError, match=r'02:00:00 again, as in row 3; .* or state tz = "Europe/Berlin" if this is the hour'):
        load(tmp_path, times)
    assert np.allclose(np.diff(load(tmp_path, times, tz="Europe/Berlin").log.t), 3600.0)


def test_a_logger_of_another_rule(tmp_path: Path) -> None:
    times = stamps(ENDS["America/New_York"], "America/New_York", 60.0, 240)
    with pytest.raises(
        ValueError, match="an hour comes twice, where clocks do not change in Europe/Berlin but in America/New_York"
    ):
        load(tmp_path, times, tz="Europe/Berlin")
    winter = [f"2024-10-27 {k // 6:02d}:{k % 6}0:00" for k in range(24)]  # standard time all year
    with pytest.raises(ValueError, match=r'occurs twice, .* or state tz = "\+01:00" of a logger that keeps no summer time'):
        load(tmp_path, winter, tz="Europe/Berlin")
    found = load(tmp_path, winter, tz="+01:00")
    assert np.allclose(np.diff(found.log.t), 600.0) and found.clock.at(0.0) == "2024-10-27 00:00:00+01:00"
    spring = [s.replace("2024-10-27", "2024-03-31") for s in winter]
    with pytest.raises(ValueError, match=r'02:00:00 does not exist in Europe/Berlin, .* state tz = "\+01:00" of a logger'):
        load(tmp_path, spring, tz="Europe/Berlin")


def test_an_hour_without_rows_where_summer_time_begins(tmp_path: Path) -> None:
    times = stamps(datetime(2024, 3, 31), "Europe/Berlin", 60.0, 120)
    found = load(tmp_path, times)
    (text,) = (f.text for f in found.findings if f.kind == "hour missing")
    assert "an hour is missing after 2024-03-31 01:59:00, where summer time begins in Europe/Berlin" in text
    assert found.misread and text in found.remarks
    for tz, apart in (("Europe/Berlin", 60.0), ("UTC", 3660.0)):
        stated = load(tmp_path, times, tz=tz)
        assert not stated.misread and np.max(np.diff(stated.log.t)) == apart
    other_day = [t.replace("03-31", "03-30") for t in times]
    assert not any("an hour is missing" in f.text for f in load(tmp_path, other_day).findings)


@pytest.mark.parametrize("step", [30.0, 300.0])
def test_sorting_says_where_the_date_did_not_change_at_midnight(tmp_path: Path, step: float) -> None:
    evening, count = datetime(2023, 11, 6, 21, 10), int(6 * 3600 / step)
    moments = [evening + timedelta(seconds=step * k) for k in range(count)]
    times = [f"2023-11-06 {m:%H:%M:%S}" for m in moments]
    with pytest.raises(ValueError, match="the date does not change at midnight: correct the dates"):
        load(tmp_path, times)
    found = load(tmp_path, times, order="sort")
    (text,) = (f.text for f in found.findings if f.kind == "dates")
    first = int(170 * 60 / step)
    assert f"2023-11-06 00:00:00 in row {first + 2} after" in text and "the date seems not to change at midnight" in text
    assert found.misread and text in found.remarks
    day = [f"2023-11-06 {m:%H:%M:%S}" for m in (evening + timedelta(seconds=step * k) for k in range(int(86400 / step)))]
    assert not load(tmp_path, day, order="sort").misread  # parts of one day, joined in another order


@pytest.mark.parametrize("order", ["refuse", "sort"])
@pytest.mark.parametrize("back", [300.0, 1234.0, 7200.0])
def test_a_clock_that_was_set_back(tmp_path: Path, back: float, order: str) -> None:
    start = datetime(2024, 7, 1, tzinfo=UTC)
    times = [(start + timedelta(seconds=5.0 * k - back * (k >= 2000))).isoformat() for k in range(2600)]
    message = (
        rf"row 2002, column time: .*; the clock of the logger was set back by {back:g} s, which is no late row: cut the log"
    )
    with pytest.raises(ValueError, match=message):
        load(tmp_path, times, order=order)
    seconds = [5.0 * k - (10000.0 - 5.0) * (k >= 2000) for k in range(2600)]
    with pytest.raises(
        ValueError, match=r"row 2002, .*; the count begins anew, as of a logger that was started again: cut the log"
    ):
        load(tmp_path, seconds, order=order)


def test_a_clock_without_a_battery_and_a_date_that_stays(tmp_path: Path) -> None:
    times = [f"2024-07-01 12:00:{k:02d}" for k in range(10)] + [f"2000-01-01 00:00:{k:02d}" for k in range(10)]
    with pytest.raises(
        ValueError, match=r"row 12, .*; the clock of the logger was set back by 7.731.* s, which is no late row"
    ):
        load(tmp_path, times, order="sort")
    stays = [f"2024-07-01 {k // 60 % 24:02d}:{k % 60:02d}:00" for k in range(2000)]
    with pytest.raises(ValueError, match=r"row 1442, .* the date does not change at midnight: correct the dates from there on"):
        load(tmp_path, stays)
    evening = [f"2024-07-01 {k // 60 % 24:02d}:{k % 60:02d}:00" for k in range(1320, 1560)]  # no time comes twice
    either = r"the date does not change at midnight: .*; or state order = \"sort\" in a map, if parts of a day were joined"
    with pytest.raises(ValueError, match=either):
        load(tmp_path, evening)
    assert np.all(np.diff(load(tmp_path, evening, order="sort").log.t) > 0)


def test_few_late_rows_joined_files_and_exports_that_overlap_are_sorted(tmp_path: Path) -> None:
    times = [5.0 * k for k in range(60)]
    values = [1 + 1e-4 * k for k in range(60)]
    late = [*range(20), 21, 22, 23, 20, *range(24, 60)]
    swapped = [k + (1, -1)[k % 2] for k in range(60)]
    joined = [*range(30, 60), *range(30)]
    for order in (late, swapped, joined, range(59, -1, -1)):
        with pytest.raises(ValueError, match='times must increase: sort the rows, or state order = "sort" in a map'):
            load(tmp_path, [times[k] for k in order])
        found = load(tmp_path, [times[k] for k in order], [values[k] for k in order], order="sort")
        assert found.log.t.tolist() == times and found.log.y[:, 0].tolist() == values
    overlapping = [*range(40), *range(20, 60)]
    cells = [[times[k] for k in overlapping], [values[k] for k in overlapping]]
    found = load(tmp_path, *cells, order="sort", duplicates="first")
    assert found.log.t.tolist() == times and found.log.y[:, 0].tolist() == values
    cells[1][50] += 0.1  # not the same rows: two clocks, or one that was set back
    with pytest.raises(ValueError, match="the clock of the logger was set back by 100 s"):
        load(tmp_path, *cells, order="sort", duplicates="first")


def test_rows_of_one_stamp_are_spread_evenly(tmp_path: Path) -> None:
    times = [5.0 * (k // 5) for k in range(3, 38)]  # the first and the last stamp are cut
    found = load(tmp_path, times, duplicates="spread")
    np.testing.assert_allclose(found.log.t, 1.0 * np.arange(3, 38), atol=1e-12)
    assert [f.text for f in found.findings if f.kind == "duplicates"] == ["28 rows of a time stated before spread evenly"]
    after_a_gap = np.array([0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 100.0, 100.0])
    np.testing.assert_array_equal(spread(after_a_gap), [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 100.0, 100.5])
    uneven = np.array([0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 3.0])
    np.testing.assert_array_equal(spread(uneven), [0.0, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0])
    np.testing.assert_array_equal(spread(np.array([1.0, 2.0])), [1.0, 2.0])
