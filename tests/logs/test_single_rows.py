"""Rows one by one give what the whole log gives."""

from __future__ import annotations

import csv
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from realistic_logs import realistic_logs, vessel

from fusion_sfdia.logs.log_map import LogMap, load_map
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.logs.single_rows import row_reader

PLANT = vessel()


@pytest.mark.parametrize(
    "name", ["semicolons and decimal commas", "bad texts", "quality of OPC UA", "offsets that change", "AM and PM"]
)
def test_rows_of_realistic_logs(tmp_path: Path, name: str) -> None:
    case = realistic_logs(tmp_path)[name]
    (tmp_path / "map.toml").write_text(case.map or "")
    log_map = load_map(tmp_path / "map.toml")
    whole = load_log(case.source, PLANT, log_map).log
    with Path(case.source).open(newline="") as file:
        rows = list(csv.DictReader(file, delimiter=log_map.separator))
    reader = row_reader(PLANT, log_map, list(rows[0]))
    times, readings, inputs = [], [], []
    for row in rows:
        times.append(reader.time(row)[0])
        y, u = reader.values(row)
        readings.append(y)
        inputs.append(u)
    np.testing.assert_allclose(np.array(times) - times[0], whole.t)
    np.testing.assert_array_equal(readings, whole.y)
    np.testing.assert_array_equal(inputs[:-1], whole.u[1:])  # an input acts from its row on


def test_times_of_rows() -> None:
    titles = ["time", *PLANT.sensor_names, "feed"]
    reader = row_reader(PLANT, LogMap(), titles)
    assert reader.time({"time": "12.5"}) == (12.5, None)
    stamp = datetime(2024, 7, 1, 10, tzinfo=UTC)
    for cell in (stamp, "2024-07-01T10:00:00Z", "2024-07-01 12:00:00+02:00", stamp.timestamp(), str(1e3 * stamp.timestamp())):
        assert reader.time({"time": cell}) == (stamp.timestamp(), stamp)
    for cell in ("", "noon", None, "01/07/2024 10:00"):
        with pytest.raises(ValueError, match=r"column time: .*; expected"):
            reader.time({"time": cell})
    with pytest.raises(ValueError, match="column PT101: 'high'; expected a finite number, or nothing"):
        reader.values({"PT101": "high"})
