"""`monitor --units` diagnoses a log of each unit, and `monitor --update` learns later logs as well."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from test_monitor_command import DT, made, written

from fusion_sfdia.cli.main import main
from fusion_sfdia.learning.monitor.monitor import Monitor
from fusion_sfdia.plant.log import Log

OWN = ["--inputs", "load", "--ignore", "remark"]


def logs(folder: Path, units: int = 6) -> Path:
    """Six units, the third with a bias in the second half of its log."""
    folder.mkdir()
    for k in range(units):
        t, y, u = made(30 + k)
        y[450:, 1] += 6.0 * (k == 2)
        written(folder / f"unit-{k}.csv", Log(t, y, u))
    return folder


@pytest.mark.slow
def test_each_unit_is_diagnosed_and_one_that_cannot_be_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = logs(tmp_path / "logs"), tmp_path / "out"
    (folder / "unit-9.csv").write_text("time,a [K],load [kW],remark\n0,1,1,1\n10,2,1,1\n")
    command = ["monitor", "--units", str(folder), *OWN, "--learn", f"0..{400 * DT:g}", "--json"]
    assert main([*command, "--workers", "2", "--out", str(out)]) == 1
    shown = json.loads(capsys.readouterr().out)
    rows = {row["unit"]: row for row in shown["units"]}
    assert len(rows) == 7 and "the healthy logs have 2 rows" in rows["unit-9"]["error"]
    assert rows["unit-2"]["state"] == "sensor" and "Sensor b has read" in str(rows["unit-2"]["events"])
    assert sum(rows[f"unit-{k}"]["state"] == "healthy" for k in (0, 1, 3, 4, 5)) >= 4 and shown["different"] == []
    with (out / "units.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [line["unit"] for line in table] == list(rows) and table[2]["learnt"] == "0 s to 4000 s"
    assert '<a href="units/unit-2.html">unit-2</a>' in (out / "units.html").read_text(encoding="utf-8")
    assert "Diagnosis of unit-2.csv" in (out / "units" / "unit-2.html").read_text(encoding="utf-8")
    assert {p.stem for p in (out / "units").iterdir()} == {name for name, row in rows.items() if row["events"]}
    assert main([*command, "--workers", "1", "--out", str(tmp_path / "one")]) == 1
    assert (tmp_path / "one" / "units.csv").read_bytes() == (out / "units.csv").read_bytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--units", "nowhere/*.csv"], "no log; expected a folder of .csv or .parquet files"),
        (
            ["--units", "x", "--healthy", "a.csv", "--data", "b.csv"],
            "--healthy, --data and --units: each unit is learnt from its own",
        ),
        (["--healthy", "a.csv", "--data", "b.csv", "--learn", "0..1"], "--learn without --units"),
        (["--monitor", "m.sfdia", "--update", "a.csv"], "state both, and where to keep the new one with --save"),
    ],
)
def test_options_that_do_not_fit_are_refused(options: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", *options]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_a_later_log_is_learnt_as_well_and_what_changed_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = (written(tmp_path / f"h{seed}.csv", made(seed)) for seed in range(2))
    t, y, u = made(2)
    y[:, 1] += np.random.default_rng(9).standard_normal(len(y))  # a noisier sensor
    later, kept, new = written(tmp_path / "later.csv", Log(t, y, u)), str(tmp_path / "m.sfdia"), str(tmp_path / "n.sfdia")
    assert main(["monitor", "--healthy", first, "--healthy", second, *OWN, "--save", kept]) == 0
    capsys.readouterr()
    assert main(["monitor", "--monitor", kept, "--update", later, "--save", new]) == 0
    said = capsys.readouterr().out
    assert "later.csv: " in said and "of its rows were in alarm, or outside, before: was it healthy?" in said
    assert "b: a lasting bias is found from" in said
    was, now = Monitor.load(kept), Monitor.load(new)
    assert [name for name, *_ in now.healthy] == ["h0.csv", "h1.csv", "later.csv"] and len(was.logs) == 2
    whole = Monitor.fit([first, second, later], inputs=["load"], ignore=["remark"])
    assert np.array_equal(now.learnt.limits.limit, whole.learnt.limits.limit)  # as if learnt at once
