"""Times that are almost surely misread are found, with what they may be; others are not."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import tanks

from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.reading import read_log
from fusion_sfdia.logs.times import Expected

NOW = datetime(2026, 3, 1, tzinfo=UTC)
PLANT = tanks()  # dt 5 s
ALLOWED = {"absent": False, "other": False, "nominal": False}


def read(folder: Path, times: Sequence[Any], dt: float | None = 5.0, **log_map: Any) -> LoadedLog:
    path = folder / "log.csv"
    path.write_text("time,l1,l2,q12,q2,inflow\n" + "".join(f"{t},1,1,6e-4,6e-4,6e-4\n" for t in times), encoding="utf-8")
    return read_log(path, PLANT, LogMap(tz="UTC") if not log_map else LogMap(**log_map), ALLOWED, Expected(dt, NOW))


def texts(found: LoadedLog, *kinds: str) -> list[str]:
    return [f.text for f in found.findings if f.kind in kinds]


def steps(start: float, step: float, count: int = 30) -> list[float]:
    return [start + step * k for k in range(count)]


@pytest.mark.parametrize(
    ("start", "step", "form"),
    [
        (3802636800, 5, "s since 1904"),
        (3802636800000, 5000, "ms since 1904"),
        (3802636800000000, 5000000, "us since 1904"),
    ],
)
def test_stamps_in_the_future_name_1904(tmp_path: Path, start: float, step: float, form: str) -> None:
    found = read(tmp_path, steps(start, step))
    (text,) = texts(found, "future", "time unit suspected")
    assert text.startswith("30 stamps in the future, up to 2090-07-02 00:02:25+00:00: the numbers may be ")
    assert f'format = "{form}" (2024-07-01 00:00:00, rows 5 s apart)' in text and found.misread and text in found.remarks
    found = read(tmp_path, steps(start, step), format=form)
    assert found.clock.at(0.0) == "2024-07-01 00:00:00+00:00" and not texts(found, "future", "step") and not found.misread


def test_a_stamp_in_the_future_is_found_in_text_and_where_the_format_is_stated(tmp_path: Path) -> None:
    times = [f"2090-07-02 00:00:{5 * k:02d}" for k in range(6)]
    assert "66 years too late, as if seconds since 1904" in texts(read(tmp_path, times), "future")[0]
    late = read(tmp_path, [*times[:0], *(f"2024-07-01 00:00:{5 * k:02d}" for k in range(6)), "2026-03-02 00:00:01"])
    assert texts(late, "future") == [
        "1 stamp in the future, up to 2026-03-02 00:00:01+00:00: correct the clock of the logger, or state format in a map"
    ]
    tomorrow = read(tmp_path, ["2026-03-01 23:59:50", "2026-03-01 23:59:55", "2026-03-02 00:00:00"])
    assert not tomorrow.misread
    assert read(tmp_path, steps(3802636800, 5), format="s").misread


@pytest.mark.parametrize(
    ("start", "step", "dt", "forms"),
    [
        (1.2e9, 2e5, 0.2, ["us"]),  # since the start of a device, though they look as seconds since 1970
        (1.2e9, 2e5, 60.0, ["ms", "us"]),
        (0, 5e3, 5.0, ["ms"]),
        (0, 5e6, 5.0, ["us"]),
        (0, 5e9, 5.0, ["ns"]),
        (0, 1 / 60, 60.0, ["h"]),
        (0, 1 / 1440, 60.0, ["d"]),
        (0, 0.001, 3.6, ["h"]),
        (1.2e9, 2e5, None, ["ms", "us"]),
        (5e9, 2e5, None, ["ms", "us"]),
    ],
)
def test_a_step_unlike_the_plants_names_units(
    tmp_path: Path, start: float, step: float, dt: float | None, forms: list[str]
) -> None:
    found = read(tmp_path, steps(start, step), dt)
    (text,) = texts(found, "time unit suspected")
    assert found.misread and all(f'format = "{form}" (' in text for form in forms), text
    for form in forms[:1]:  # once stated, it is believed
        stated = read(tmp_path, steps(start, step), dt, format=form)
        assert not stated.misread and stated.log.t[1] - stated.log.t[0] == pytest.approx(
            step * {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "h": 3600.0, "d": 86400.0}[form]
        )


def test_a_stated_unit_is_believed_and_its_step_is_stated(tmp_path: Path) -> None:
    found = read(tmp_path, steps(0, 3e5), 60.0, format="us")
    assert texts(found, "step") == ["rows are 0.3 s apart, the readings of plant 'two-tanks' 60 s; times are us"]
    assert not found.misread and found.log.t[-1] == pytest.approx(8.7)


@pytest.mark.parametrize(
    ("step", "said"), [(5, False), (15, False), (1, False), (2.5, False), (7, True), (3, True), (12, True)]
)
def test_a_step_that_is_no_simple_multiple_is_stated(tmp_path: Path, step: float, said: bool) -> None:
    found = read(tmp_path, steps(100, step))
    assert bool(texts(found, "step")) is said and not found.misread
    jitter = np.cumsum(step * (1 + 0.5 * np.random.default_rng(0).standard_normal(30).clip(-1, 1)))
    assert not texts(read(tmp_path, jitter), "step")


@pytest.mark.parametrize("dt", [5.0, None])
@pytest.mark.parametrize("start", [0.0, 7400.0, 40000.0, 740000.0, 2.46e6, 20240501.0, 1714564800.0])
def test_plain_seconds_stay_seconds(tmp_path: Path, start: float, dt: float | None) -> None:
    found = read(tmp_path, steps(start, 5.0, 100), dt)
    np.testing.assert_array_equal(found.log.t - found.log.t[0], steps(0.0, 5.0, 100))
    assert not found.misread and (found.clock.start is None) == (start < 1e9)


@pytest.mark.parametrize(("form", "step"), [("%Y%m%d%H", 3600.0), ("%Y%m%d", 86400.0)])
def test_digits_of_the_calendar_are_no_other_unit_however_far_apart(tmp_path: Path, form: str, step: float) -> None:
    times = [(datetime(2024, 7, 1) + timedelta(seconds=step * k)).strftime(form) for k in range(60)]
    found = read(tmp_path, times)
    assert not found.misread and np.allclose(np.diff(found.log.t), step)
    assert f"times are digits of the calendar, {form} of UTC" in texts(found, "step")[0]


def test_digits_without_the_zero_of_the_first_days(tmp_path: Path) -> None:
    times = [(datetime(2024, 7, 1) + timedelta(seconds=60.0 * k)).strftime("%d%m%Y%H%M%S").lstrip("0") for k in range(60)]
    with pytest.raises(ValueError, match=r'may be a time in several ways; .* "%d%m%Y%H%M%S" .* "%m%d%Y%H%M%S"'):
        read(tmp_path, times, 60.0)
    later = [(datetime(2024, 7, 13) + timedelta(seconds=60.0 * k)).strftime("%d%m%Y%H%M%S") for k in range(60)]
    assert read(tmp_path, later, 60.0).clock.at(0.0) == "2024-07-13 00:00:00+00:00"


def test_candidates_are_no_absurd_counts(tmp_path: Path) -> None:
    found = read(tmp_path, steps(1.2e9, 6e7), 60.0)
    assert 'format = "us" (1200 s after a start, rows 60 s apart)' in texts(found, "time unit suspected")[0]
    assert '"s"' not in texts(found, "time unit suspected")[0] and '"h"' not in texts(found, "time unit suspected")[0]
