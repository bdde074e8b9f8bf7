"""Logs whose columns are sensors and inputs of a plant that is not modelled."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from made_up_logs import LOAD, SENSORS, of_factor

from fusion_sfdia.learning.monitor.unmodelled_logs import load, signals_of
from fusion_sfdia.logs.log_map import Column, LogMap
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.signals import Signal

MORE = (*SENSORS, Signal("alone", "1"), Signal("still", "bar"))


def wide() -> Log:
    """The four sensors of `of_factor`, one that has nothing to do with them, and one that never moves."""
    t, y, u = of_factor(21, 60)
    alone = np.random.default_rng(1).standard_normal((60, 1))
    return Log(t, np.hstack([y, alone, np.full((60, 1), 3.0)]), u)


def written(path: Path, log: Log) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["time", *(f"{s.name} [{s.unit}]" for s in MORE), "load [kW]", "remark"])
        table.writerows([t, *["" if np.isnan(v) else v for v in y], *u, 1] for t, y, u in zip(*log, strict=True))
    return path


def test_columns_are_sensors_unless_they_are_named(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", wide())
    sensors, inputs = signals_of(path, ["load"], ["remark"])
    assert tuple(sensors) == MORE and inputs == [LOAD]
    found = load(path, sensors, inputs).log
    assert np.array_equal(found.y, wide().y, equal_nan=True) and np.array_equal(found.u, wide().u)
    with pytest.raises(ValueError, match="no column 'lod'; known: 'a'"):
        signals_of(path, ["lod"], [])
    with pytest.raises(ValueError, match="no column is left"):
        signals_of(path, [], [*(s.name for s in MORE), "load", "remark"])


def test_a_tag_may_end_by_its_unit(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,SAT_degC,SAP_KPA,flow_in,T_MIN,p_MPa,w_mw\n0,1,2,3,4,5,6\n10,1,2,3,4,5,6\n", encoding="utf-8")
    sensors, inputs = signals_of(path, ["SAP_KPA"])
    assert [s.unit for s in sensors] == ["degC", "1", "1", "MPa", "1"] and inputs == [Signal("SAP_KPA", "kPa")]
    assert load(path, sensors, inputs).log.y[0].tolist() == [1, 3, 4, 5, 6]


def test_a_map_states_how_a_log_is_written_and_which_columns_are_used(tmp_path: Path) -> None:
    path = tmp_path / "export.csv"
    path.write_text("Stamp;TI 1;FI 1;N\n2026-01-01 00:00:00;1,5;2,0;x\n2026-01-01 00:00:10;Bad;3,0;x\n", encoding="utf-8")
    columns = {"TI 1": Column(sensor="T1", unit="degC"), "FI 1": Column(input="F1", unit="m3/h")}
    log_map = LogMap(time=("Stamp",), tz="UTC", separator=";", decimal=",", bad=("Bad",), columns=columns)
    sensors, inputs = signals_of(path, log_map=log_map)
    assert sensors == [Signal("T1", "degC")] and inputs == [Signal("F1", "m3/h")]
    path.write_text(path.read_text(encoding="utf-8").replace(":10", ":59"), encoding="utf-8")
    found = load(path, sensors, inputs, log_map)
    assert not [text for text in found.remarks if "in seconds" in text]  # any step is that of the plant to be identified
    assert found.log.t.tolist() == [0.0, 59.0] and found.log.u[:, 0].tolist() == [2.0, 2.0]  # acts from its row on
    assert found.log.y[:, 0] == pytest.approx([1.5, np.nan], nan_ok=True)
    with pytest.raises(ValueError, match="states no columns"):
        signals_of(path, log_map=LogMap(time=("Stamp",), separator=";", tag="N", value="TI 1"))


@pytest.mark.parametrize("title", ["timestamp", "DateTime", "Time stamp", "Zeit"])
def test_a_column_with_a_usual_title_of_times_is_that_of_the_times(tmp_path: Path, title: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{title},a\n2026-01-01 00:00:00Z,1\n2026-01-01 00:00:10Z,2\n", encoding="utf-8")
    sensors, _ = signals_of(path)
    assert [s.name for s in sensors] == ["a"]
    found = load(path, sensors)
    assert found.log.t.tolist() == [0.0, 10.0] and f"times are those of the column {title!r}" in str(found)
    path.write_text(f"{title},date,a\n2026-01-01 00:00:00Z,1,1\n", encoding="utf-8")  # which of them?
    with pytest.raises(ValueError, match="no column 'time'"):
        load(path, sensors)
