"""Tags with times of their own are put in rows of one time, however they are written."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import tanks

from fusion_sfdia.learning.monitor.unmodelled_logs import load as load_monitored
from fusion_sfdia.learning.monitor.unmodelled_logs import signals_of
from fusion_sfdia.live.text_rows import TextRows
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_map import Column, LogMap
from fusion_sfdia.logs.reading import load_log

PLANT = tanks()  # dt 5 s
NAMES = ["l1", "l2", "q12", "q2", "inflow"]
COUNT = 40
VALUES = np.round(np.array([[1.0], [0.9], [6e-4], [6e-4], [6e-4]]) * (1 + 1e-4 * np.arange(COUNT)), 9)
START = datetime(2024, 7, 1, 12)
MANY = {"inputs": "until the sample"}


def stamp(t: float) -> str:
    return str(START + timedelta(seconds=t))


def columns_of(offsets: Sequence[float], form: Any = stamp, step: float = 5.0) -> list[list[tuple[str, str]]]:
    """Of each tag pairs of time and value, as text."""
    return [
        [(str(form(step * k + offset)), repr(float(v))) for k, v in enumerate(values)]
        for offset, values in zip(offsets, VALUES, strict=True)
    ]


def written(path: Path, titles: Sequence[str], columns: Sequence[Sequence[tuple[str, ...]]]) -> Path:
    rows = [[cell for pair in row for cell in pair] for row in zip(*columns, strict=True)]
    path.write_text("\n".join(map(",".join, [titles, *rows])) + "\n", encoding="utf-8")
    return path


def pairs(pattern: str, value: str = "{}") -> list[str]:
    return [title.format(name) for name in NAMES for title in (pattern, value)]


def texts(found: LoadedLog, kind: str) -> list[str]:
    return [f.text for f in found.findings if f.kind == kind]


def require_all(found: LoadedLog, at: float = 0.0) -> None:
    np.testing.assert_array_equal(found.log.y, VALUES[:4].T)
    np.testing.assert_array_equal(found.log.u[:, 0], VALUES[4])
    np.testing.assert_allclose(found.log.t - found.log.t[0], 5.0 * np.arange(COUNT), atol=1e-9)
    if (start := found.clock.start) is not None:
        assert start.replace(tzinfo=None) + timedelta(seconds=float(found.log.t[0])) == START + timedelta(seconds=at)


@pytest.mark.parametrize(
    ("titles", "log_map"),
    [
        (pairs("Timestamp"), {"time": "Timestamp"}),
        (pairs("Timestamp"), {}),
        (pairs("time"), {}),
        (pairs("{} Time", "{} ValueY"), {}),
        (pairs("{} Time", "{} ValueY"), {"time": "l1 Time"}),
        (pairs("{}_timestamp", "{}_value"), {}),
        (pairs("{}.Time"), {}),
        (pairs("Time {}"), {}),
        (pairs("time_{}"), {}),
        (pairs("Timestamp of {}"), {}),
        (pairs("Date/Time ({})"), {}),
        (pairs("{} time", "{} [-]".replace(" [-]", "")), {}),
        (
            ["Timestamp", "l1", *(t if t == n else f"Timestamp.{k}" for k, n in enumerate(NAMES) if k for t in ("", n))],
            {"time": "Timestamp"},
        ),
    ],
)
def test_times_beside_each_tag(tmp_path: Path, titles: list[str], log_map: dict[str, Any]) -> None:
    path = written(tmp_path / "log.csv", titles, columns_of([0.0, 0.3, 0.6, 0.9, 1.2]))
    found = load_log(path, PLANT, LogMap(**log_map, **MANY))
    require_all(found)
    assert texts(found, "grid") == [
        "5 tags with times of their own in rows 5 s apart: of each the value nearest in time, at most 1.2 s away"
    ]
    assert texts(found, "grid")[0] in found.remarks


def test_times_that_a_map_states(tmp_path: Path) -> None:
    titles = [t for n in NAMES for t in (f"{n} at", f"{n} reads")]
    path = written(tmp_path / "log.csv", titles, columns_of([0.0, 0.3, 0.6, 0.9, 1.2]))
    kinds = {n: {"input" if n == "inflow" else "sensor": n} for n in NAMES}
    columns = {f"{n} reads": Column(**kinds[n], time=f"{n} at") for n in NAMES}
    require_all(load_log(path, PLANT, LogMap(time="l1 at", columns=columns, **MANY)))
    columns["l2 reads"] = Column(sensor="l2", time="l2 when")
    with pytest.raises(ValueError, match="no column 'l2 when' with the times of 'l2 reads'; correct the map"):
        load_log(path, PLANT, LogMap(time="l1 at", columns=columns, **MANY))
    for log_map in (LogMap(columns=columns), LogMap(step=5.0), LogMap(duplicates="spread")):
        with pytest.raises(ValueError, match="which need the rows after: a watch takes rows as"):
            TextRows(PLANT, log_map)


@pytest.mark.parametrize("form", [float, lambda t: 1e3 * (t + 1719835200.0)])
def test_numbers_as_times_of_plain_columns_and_frames(tmp_path: Path, form: Any) -> None:
    pandas = pytest.importorskip("pandas")
    columns = columns_of([0.0, 0.5, 1.0, 0.5, 0.0], form)
    path = written(tmp_path / "log.csv", pairs("time"), columns)
    require_all(load_log(path, PLANT))
    require_all(load_log(pandas.read_csv(path), PLANT, LogMap(**MANY)))


def test_stamps_of_a_frame() -> None:
    pandas = pytest.importorskip("pandas")
    data = {}
    for name, offset, values in zip(NAMES, (0.0, 0.5, 1.0, 0.5, 0.0), VALUES, strict=True):
        data[f"{name} time"] = pandas.to_datetime([stamp(5.0 * k + offset) for k in range(COUNT)])
        data[name] = values
    require_all(load_log(pandas.DataFrame(data), PLANT, LogMap(**MANY)))


@pytest.mark.parametrize(
    ("offsets", "away", "at"),
    [
        ([0.0, -0.4, 0.4, 1.0, -1.0], "1 s", 0.0),  # around whole steps of the wall clock
        ([0.0, 0.9, 1.8, 2.7, 3.6], "1.8 s", 1.8),  # on one side of it: rows are parted where no value is
        ([3.0, 3.1, 3.2, 2.9, 3.0], "0.15 s", 3.05),
    ],
)
def test_rows_are_parted_where_no_values_are(tmp_path: Path, offsets: list[float], away: str, at: float) -> None:
    path = written(tmp_path / "log.csv", pairs("{} Time"), columns_of(offsets))
    found = load_log(path, PLANT, LogMap(**MANY))
    require_all(found, at)
    assert texts(found, "grid")[0].endswith(f"nearest in time, at most {away} away")


def test_a_long_table_with_seconds_between_tags(tmp_path: Path) -> None:
    columns = columns_of([0.0, 0.5, 1.0, 1.5, 2.0])
    rows = [(t, n, v) for n, c in zip(NAMES, columns, strict=True) for t, v in c]
    for order in (rows, sorted(rows), rows[::-1]):
        path = written(tmp_path / "log.csv", ["Timestamp", "Tag", "Value"], [order])
        require_all(load_log(path, PLANT, LogMap(time="Timestamp", tag="Tag", value="Value", **MANY)), 1.0)
    same = [(stamp(5.0 * k), n, c[k][1]) for n, c in zip(NAMES, columns, strict=True) for k in range(COUNT)]
    path = written(tmp_path / "log.csv", ["Timestamp", "Tag", "Value"], [same])
    found = load_log(path, PLANT, LogMap(time="Timestamp", tag="Tag", value="Value", **MANY))
    require_all(found)
    assert not texts(found, "grid")


def test_tags_that_change_seldom_are_missing_between_and_inputs_are_held(tmp_path: Path) -> None:
    columns = columns_of([0.0, 0.5, 1.0, 1.5, 0.1])
    rows = [
        (t, n, v)
        for n, c in zip(NAMES, columns, strict=True)
        for k, (t, v) in enumerate(c)
        if n not in ("l2", "inflow") or k % 4 == 0
    ]
    path = written(tmp_path / "log.csv", ["Timestamp", "Tag", "Value"], [rows])
    found = load_log(path, PLANT, LogMap(time="Timestamp", tag="Tag", value="Value", hold=60.0, **MANY))
    assert np.isfinite(found.log.y[:, 1]).tolist() == [k % 4 == 0 for k in range(COUNT)]
    np.testing.assert_array_equal(found.log.u[:, 0], np.repeat(VALUES[4][::4], 4))
    np.testing.assert_array_equal(found.log.y[:, 0], VALUES[0])


def test_columns_of_different_lengths_and_values_without_a_time(tmp_path: Path) -> None:
    columns = columns_of([0.0, 0.3, 0.6, 0.9, 1.2])
    columns[1][-3:] = [("", "")] * 3
    path = written(tmp_path / "log.csv", pairs("{} Time"), columns)
    found = load_log(path, PLANT, LogMap(**MANY))
    assert np.isnan(found.log.y[:, 1]).tolist() == [k >= COUNT - 3 for k in range(COUNT)]
    np.testing.assert_array_equal(found.log.y[:, 0], VALUES[0])
    columns[1][-1] = ("", "0.9")
    written(path, pairs("{} Time"), columns)
    with pytest.raises(ValueError, match="row 41, column l2 Time: ''; expected the time of the value of l2"):
        load_log(path, PLANT, LogMap(**MANY))


def test_a_stated_step_puts_any_log_in_rows(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [[f"{5.0 * k + 0.2 * (-1) ** k}", *(repr(float(v)) for v in VALUES[:, k])] for k in range(COUNT)]
    path.write_text("\n".join(map(",".join, [["time", *NAMES], *rows])) + "\n")
    require_all(load_log(path, PLANT, LogMap(step=5.0, **MANY)))
    found = load_log(path, PLANT, LogMap(step=20.0, **MANY))
    np.testing.assert_array_equal(found.log.y[:-1], VALUES[:4, ::4].T)
    assert texts(found, "grid")[0].endswith("; 145 values between these left out")
    with pytest.raises(ValueError, match="step is -1; expected seconds between rows, or 0"):
        LogMap(step=-1)


def test_titles_with_time_in_them_are_no_times_of_others(tmp_path: Path) -> None:
    """A single counter of hours beside a tag, and a title that occurs twice and is no time."""
    path = tmp_path / "log.csv"
    cells = [f"{5 * k},1,1,6e-4,6e-4,6e-4,{k}" for k in range(5)]
    path.write_text("\n".join(["time,l1,l2,q12,q2,inflow,l1 time", *cells]) + "\n")
    found = load_log(path, PLANT, other_columns=True)
    assert found.log.t.tolist() == [0.0, 5.0, 10.0, 15.0, 20.0] and not texts(found, "grid")
    path.write_text("\n".join(["time,l1,l2,q12,q2,inflow,l1", *cells]) + "\n")
    with pytest.raises(ValueError, match="the column 'l1' occurs twice; keep one"):
        load_log(path, PLANT)


@pytest.mark.parametrize("pattern", ["{} Time", "Timestamp"])
def test_monitor_reads_them_by_their_own_step(tmp_path: Path, pattern: str) -> None:
    path = written(tmp_path / "log.csv", pairs(pattern), columns_of([0.0, 0.3, 0.6, 0.9, 1.2], step=30.0))
    log_map = LogMap(time="Timestamp", **MANY)
    sensors, inputs = signals_of(path, ["inflow"], log_map=log_map)
    assert [s.name for s in (*sensors, *inputs)] == NAMES
    found = load_monitored(path, sensors, inputs, log_map)
    np.testing.assert_array_equal(found.log.y, VALUES[:4].T)
    np.testing.assert_allclose(np.diff(found.log.t), 30.0)
