"""Local stamps of rows as they come are read as those of a whole log, and times that are misread are said."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from toy_plants import tanks

from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live.text_rows import TextRows
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.reading import load_log

PLANT = tanks()  # dt 5 s
HEADER = "time,l1,l2,q12,q2,inflow"


def stamps(start: datetime, place: str, step: float, count: int) -> list[str]:
    moments = (start.replace(tzinfo=UTC) + timedelta(seconds=step * k) for k in range(count))
    return [m.astimezone(ZoneInfo(place)).strftime("%Y-%m-%d %H:%M:%S") for m in moments]


def rows_of(log_map: LogMap, times: list[str], said: list[str] | None = None, last: datetime | None = None) -> list[float]:
    rows = TextRows(PLANT, log_map, refused=print if said is None else said.append)
    rows.last, rows.now = last, datetime(2026, 3, 1, tzinfo=UTC)
    assert rows.row(HEADER) is None
    found = [rows.row(f"{t},1,1,6e-4,6e-4,6e-4") for t in times]
    return [row[0].timestamp() if isinstance(row[0], datetime) else row[0] for row in found if row is not None]


@pytest.mark.parametrize(
    ("place", "start"),
    [
        ("Europe/Amsterdam", datetime(2024, 10, 26, 23, 30)),
        ("America/New_York", datetime(2024, 11, 3, 4, 30)),
        ("Australia/Lord_Howe", datetime(2024, 4, 6, 14, 30)),  # by half an hour
        ("Europe/Amsterdam", datetime(2024, 3, 30, 23, 30)),
    ],
)
@pytest.mark.parametrize("step", [5.0, 7.0, 600.0])
def test_the_second_hour_is_read_as_of_a_whole_log(tmp_path: Path, place: str, start: datetime, step: float) -> None:
    times = stamps(start, place, step, int(9000 / step))
    path = tmp_path / "log.csv"
    path.write_text("\n".join([HEADER, *(f"{t},1,1,6e-4,6e-4,6e-4" for t in times)]) + "\n")
    log_map = LogMap(tz=place)
    whole = load_log(path, PLANT, log_map)
    seconds = np.array(rows_of(log_map, times))
    np.testing.assert_array_equal(seconds - seconds[0], whole.log.t)
    assert whole.clock.start is not None and seconds[0] == whole.clock.start.timestamp()
    k = next((k for k in range(1, len(times)) if times[k] < times[k - 1]), len(times) // 2) + 3  # a watch that goes on
    rest = rows_of(log_map, times[k:], last=datetime.fromtimestamp(seconds[k - 1], UTC))
    np.testing.assert_array_equal(rest, seconds[k:])


def test_a_watch_counts_the_seconds_of_the_second_hour() -> None:
    watch = Watch(CentralFilter(PLANT), refused=print)
    rows = TextRows(PLANT, LogMap(tz="Europe/Amsterdam"))
    rows.row(HEADER)
    times = []
    for text in stamps(datetime(2024, 10, 27, 0, 59), "Europe/Amsterdam", 5.0, 40):
        row = rows.row(f"{text},1,1,6e-4,6e-4,6e-4")
        assert row is not None
        times += [sample.t for sample in watch.update(*row)]
    times += [sample.t for sample in watch.finish()]
    assert times == [5.0 * k for k in range(40)]


def test_a_late_row_does_not_begin_the_second_hour() -> None:
    times = stamps(datetime(2024, 10, 27, 0, 30), "Europe/Amsterdam", 5.0, 20)
    late = [*times[:10], times[8], *times[10:]]
    seconds = rows_of(LogMap(tz="Europe/Amsterdam"), late)
    assert np.diff(np.delete(seconds, 10)).tolist() == [5.0] * 19 and seconds[10] == seconds[8]


def test_an_hour_back_without_a_zone_names_it() -> None:
    said: list[str] = []
    times = stamps(datetime(2024, 10, 27, 0, 59), "Europe/Amsterdam", 5.0, 40)
    rows_of(LogMap(), times, said)
    assert said == [
        "line 14: an hour comes twice, as where summer time ends (Europe/Berlin): state the zone of the logger in a map: "
        'tz = "Europe/Berlin"'
    ]


@pytest.mark.parametrize(
    ("start", "step", "message"),
    [
        (3802636800, 5, 'the first 20 rows: 20 stamps in the future, .* format = "s since 1904"'),
        (1200000000, 5000000, 'the first 20 rows: rows are 5e\\+06 s apart, .* format = "us"'),
        (0, 5000, 'the first 20 rows: rows are 5000 s apart, .* format = "ms"'),
    ],
)
def test_times_that_are_misread_are_said_once(start: float, step: float, message: str) -> None:
    said: list[str] = []
    rows_of(LogMap(), [str(start + step * k) for k in range(60)], said)
    assert len(said) == 1
    with pytest.raises(ValueError, match=message):
        raise ValueError(said[0])
    for form in ("s since 1904", "us", "ms"):
        if f'"{form}"' in message:
            quiet: list[str] = []
            rows_of(LogMap(format=form), [str(start + step * k) for k in range(60)], quiet)
            assert quiet == []
