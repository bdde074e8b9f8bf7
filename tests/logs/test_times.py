"""Times of a log in each form, and those that could be taken for others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import tanks

from fusion_sfdia.logs.findings import LoadedLog
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.reading import load_log


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
    ],
)
def test_forms(tmp_path: Path, times: list[Any], log_map: dict[str, Any], start: str) -> None:
    found = load(tmp_path, times, **log_map)
    np.testing.assert_allclose(found.log.t, [0.0, 5.0], atol=1e-12)
    assert found.clock.at(0.0) == start


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
        (["12:00:00", "12:00:05"], {}, "'12:00:00'; expected a finite number of seconds, or a time as 2026-03-01 14:20:05"),
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
