"""Times of a log in each form, and those that could be taken for others."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import tanks

from fusion_sfdia.logs.epochs import AmbiguousTimesError, recognised
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.logs.times import instant

NOON = datetime(2024, 5, 1, 12)
LATEST = datetime(2026, 1, 1, tzinfo=UTC).timestamp()


def load(folder: Path, times: list[Any], **log_map: Any) -> LoadedLog:
    path = folder / "log.csv"
    path.write_text("time,l1,l2,q12,q2,inflow\n" + "".join(f"{t},1,1,6e-4,6e-4,6e-4\n" for t in times), encoding="utf-8")
    return load_log(path, tanks(), LogMap(**log_map))


@pytest.mark.parametrize(
    ("times", "log_map", "start"),
    [
        ([0, 5], {}, "0 s"),
        ([1714564800, 1714564805], {}, "2024-05-01 12:00:00+00:00"),
        (["1714564800.1", "1714564805.1"], {}, "2024-05-01 12:00:00.100+00:00"),
        ([1714564800000, 1714564805000], {"tz": "Europe/Amsterdam"}, "2024-05-01 14:00:00+02:00"),
        ([1714564800000000000, 1714564805000000000], {}, "2024-05-01 12:00:00+00:00"),
        (["2024-05-01 12:00", "2024-05-01 12:00:05"], {}, "2024-05-01 12:00:00"),
        (["2024-05-01T12:00:00.25Z", "2024-05-01T12:00:05.25Z"], {}, "2024-05-01 12:00:00.250+00:00"),
        (["2024-05-01T12:00:00-0500", "2024-05-01T12:00:05-05:00"], {}, "2024-05-01 12:00:00-05:00"),
        (["20240501120000", "20240501120005"], {"format": "%Y%m%d%H%M%S"}, "2024-05-01 12:00:00"),
        ([45413.5, 45413.50005787037], {"format": "excel"}, "2024-05-01 12:00:00"),
        (["0", "8.333333333333333e-02"], {"format": "min"}, "0 s"),
        (["2024-05-01 12:00:00 +0200", "2024-05-01 12:00:05 +0200"], {}, "2024-05-01 12:00:00+02:00"),
        (["2024-05-01 12:00:00 UTC", "2024-05-01 12:00:05 UTC"], {}, "2024-05-01 12:00:00+00:00"),
        (["20240501T120000Z", "20240501T120005Z"], {}, "2024-05-01 12:00:00+00:00"),
        (["20240501 120000", "20240501 120005"], {"tz": "+01:00"}, "2024-05-01 12:00:00+01:00"),
        (["2024-05-01 24:00", "2024-05-02 00:00:05"], {}, "2024-05-02 00:00:00"),
        (["01.05.2024 24:00:00", "02.05.2024 00:00:05"], {"format": "%d.%m.%Y %H:%M:%S"}, "2024-05-02 00:00:00"),
    ],
)
def test_forms(tmp_path: Path, times: list[Any], log_map: dict[str, Any], start: str) -> None:
    found = load(tmp_path, times, **log_map)
    np.testing.assert_allclose(found.log.t, [0.0, 5.0], atol=1e-12)
    assert found.clock.at(0.0) == start


# each way of writing 2024-05-01 12:00:00 and 5 s later as numbers; of days and digits of the calendar on the wall clock
NUMBERS = {
    "s since 1904": ([3797409600, 3797409605], True),
    "labview": ([3797409600.0, 3797409605.0], True),
    "seconds since 1904-01-01 00:00:00": ([3797409600, 3797409605], True),
    "ms since 2000-01-01T12:00+02:00": ([767844000000, 767844005000], True),
    "us since 1970": ([1714564800000000, 1714564805000000], True),
    "100 ns since 1601-01-01": ([133590384000000000, 133590384050000000], True),
    "filetime": ([133590384000000000, 133590384050000000], True),
    "ticks": ([638501616000000000, 638501616050000000], True),
    "d since 1899-12-30": ([45413.5, 45413.500057870], False),
    "1e-6 d since 1899-12-30": ([45413500000, 45413500057.87], False),
    "days since 1970": ([19844.5, 19844.50005787037], False),
    "days since 1970-01-01T00:00Z": ([19844.5, 19844.50005787037], True),
    "matlab": ([739373.5, 739373.50005787037], False),
    "julian": ([2460432.0, 2460432.00005787037], False),
    "%Y%m%d%H%M%S": ([20240501120000, 20240501120005], False),
}


@pytest.mark.parametrize("form", NUMBERS)
def test_numbers_with_a_stated_format(tmp_path: Path, form: str) -> None:
    times, utc = NUMBERS[form]
    for tz, start in (("", "2024-05-01 12:00:00"), ("-07:00", f"2024-05-01 {'05' if utc else '12'}:00:00-07:00")):
        found = load(tmp_path, times, format=form, tz=tz)
        np.testing.assert_allclose(found.log.t, [0.0, 5.0], atol=2e-3)
        assert found.clock.at(0.0) == start + ("+00:00" if utc and not tz else "")
        one = instant(times[0], LogMap(format=form, tz=tz)).stamp
        assert one is not None and (one if tz else one.replace(tzinfo=found.clock.start.tzinfo)) == found.clock.start


@pytest.mark.parametrize(
    "form",
    [f for f in NUMBERS if f[0] in "1djmft%" and "1904" not in f and "2000" not in f and not f.startswith("100")],
)
def test_numbers_that_can_be_one_thing_are_recognised(tmp_path: Path, form: str) -> None:
    found = load(tmp_path, NUMBERS[form][0])
    np.testing.assert_allclose(found.log.t, [0.0, 5.0], atol=2e-3)
    assert found.clock.start.replace(tzinfo=None) == NOON
    with_seconds = [5.0 * k + NUMBERS[form][0][0] // 1 for k in range(3)]
    if form[0] not in "1ft%":  # the same numbers, but with steps of the plant, are seconds
        assert load(tmp_path, with_seconds).clock.start is None


@pytest.mark.parametrize("step", [1.0, 0.25])
def test_whole_days_may_be_seconds(tmp_path: Path, step: float) -> None:
    """Eight digits that are dates, a day apart: with a plant that is read every second they may be seconds, too."""
    values = np.array([20240501.0, 20240502.0, 20240503.0])
    with pytest.raises(
        AmbiguousTimesError, match=r'format = "%Y%m%d" \(2024-05-01 00:00:00, rows 86400 s apart\), or format = "s"'
    ):
        recognised(values, step, LATEST)
    assert recognised(values, 86400.0, LATEST).name == "%Y%m%d" == recognised(values, None, LATEST).name
    with pytest.raises(AmbiguousTimesError, match=r'format = "%d%m%Y%H%M%S" .*, or format = "%m%d%Y%H%M%S"'):
        recognised(np.array([11052024120000.0, 11052024120005.0]), 5.0, LATEST)
    days = 45413.5 + np.arange(4) / 1440.0 + 1e-7
    with pytest.raises(
        AmbiguousTimesError, match=r'format = "excel" \(2024-05-01 12:00:00, rows 60 s apart\), or format = "s"'
    ):
        recognised(days, None, LATEST)
    assert recognised(days, 60.0, LATEST).name == "excel"


def test_times_of_day_pass_midnight(tmp_path: Path) -> None:
    texts = ["23:59:55", "00:00:00.0", "0:00:05", "00:00:10"]
    for log_map in ({}, {"format": "%H:%M:%S"}):
        given = [t.replace(".0", "") for t in texts] if log_map else texts
        found = load(tmp_path, given, **log_map)
        assert found.log.t.tolist() == [86395.0, 86400.0, 86405.0, 86410.0] and found.clock.start is None
        (note,) = (f for f in found.findings if f.kind == "no date")
        assert note.count == 1 and note.text.endswith("midnight is passed 1 time")
    newest_first = load(tmp_path, texts[::-1], order="sort")
    assert np.diff(newest_first.log.t).tolist() == [5.0, 5.0, 5.0]
    assert load(tmp_path, ["23:59:55", "24:00:00", "00:00:05"]).log.t.tolist() == [86395.0, 86400.0, 86405.0]
    assert load(tmp_path, ["24:59:55", "25:00:00"]).log.t.tolist() == [89995.0, 90000.0]  # a duration


def test_one_time_as_a_column_of_it() -> None:
    amsterdam = LogMap(tz="Europe/Amsterdam")
    first, second = (
        instant("2024-10-27 02:30:00", amsterdam, near=near).seconds
        for near in (None, datetime(2024, 10, 27, 1, 10, tzinfo=UTC))
    )
    assert second - first == 3600.0
    with pytest.raises(ValueError, match=r'2024-03-31 02:30:00 does not exist .* tz = "\+01:00" of a logger'):
        instant("2024-03-31 02:30:00", amsterdam)
    assert (
        instant(5) == (5.0, None)
        and instant("0.5", LogMap(format="min")) == (30.0, None)
        and instant("7", unit="ms") == (0.007, None)
    )
    for cell in (
        1714564800,
        "1714564800000",
        1714564800000000,
        1714564800000000000,
        "20240501120000",
        np.datetime64("2024-05-01T12"),
    ):
        assert instant(cell, now=NOON.replace(tzinfo=UTC)).seconds == 1714564800.0
    for cell in ("", None, True, "noon", "12:00", float("nan"), 10**400, "2024-05-01 25:00", [1]):
        with pytest.raises(ValueError, match="; expected a time, in seconds or ISO 8601"):
            instant(cell)


@pytest.mark.parametrize(
    ("times", "log_map", "message"),
    [
        (
            ["01/05/2024 12:00", "01/05/2024 12:01"],
            {},
            r'state format = "%d/%m/%Y %H:%M" or format = "%m/%d/%Y %H:%M" in',
        ),
        (
            ["13/05/2024 12:00", "13/05/2024 12:01"],
            {},
            r'seconds or an ISO time: state format = "%d/%m/%Y %H:%M" in a map',
        ),
        (["12:00", "12:05"], {}, "'12:00'; expected a finite number of seconds, or a time as 2026-03-01 14:20:05"),
        (["2024-05-01T12:00:00Z", "2024-05-01T12:00:05"], {}, "row 3, .* states no offset from UTC, unlike the first row"),
        (["2024-02-30 12:00:00"], {}, "row 2, .*'2024-02-30 12:00:00'; expected a date and time as"),
        (["2024-05-01", "1714564805"], {}, "row 3, column time: '1714564805'; expected"),
        (["1714564800", "2024-05-01"], {}, "row 3, column time: '2024-05-01'; expected a finite number, as in the first row"),
        (["2024-03-31 02:30:00"], {"tz": "Europe/Amsterdam"}, "2024-03-31 02:30:00 does not exist in Europe/Amsterdam"),
        (["2024-10-27 02:30:00"], {"tz": "Europe/Amsterdam"}, "2024-10-27 02:30:00 occurs twice, and the order"),
        (["1", ""], {}, "row 3, column time: ''; expected a finite number in each row"),
        (["-5", "0"], {"format": "excel"}, "expected days since 1900"),
        (["0099-01-01 00:00:00", "x"], {}, "row 3, column time: 'x'"),
    ],
)
def test_refused(tmp_path: Path, times: list[Any], log_map: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load(tmp_path, times, **log_map)


@pytest.mark.parametrize("dtype", ["int64", "float64"])
def test_digits_of_the_calendar_in_a_frame(dtype: str) -> None:
    pandas = pytest.importorskip("pandas")
    frame = (
        pandas.DataFrame({"time": [1052024120000, 1052024120005]})
        .astype(dtype)
        .assign(l1=1, l2=1, q12=6e-4, q2=6e-4, inflow=6e-4)
    )
    found = load_log(frame, tanks(), LogMap(format="%d%m%Y%H%M%S"))
    assert found.log.t.tolist() == [0.0, 5.0] and found.clock.start == NOON
    with pytest.raises(ValueError, match="1052024120000; expected digits as %Y%m%d%H%M%S in each row"):
        load_log(frame, tanks(), LogMap(format="%Y%m%d%H%M%S"))
