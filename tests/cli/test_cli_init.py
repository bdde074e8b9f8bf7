"""init: a map and a plant that work as they are written, on logs of many kinds."""

from __future__ import annotations

import gzip
import tomllib
from pathlib import Path

import numpy as np
import pytest
from drafted_logs import STEPS, TAGS, UNITS, drafted_logs, readings, vat

from fusion_sfdia.cli.main import main
from fusion_sfdia.detectors.registry import plant as registered
from fusion_sfdia.logs.reading import load_log

HELPERS = Path(__file__).parents[1] / "helpers" / "drafted_logs.py"
DIRTY = ("dirty.csv", "everything.csv")
KINDS = (
    "comma.csv", "semicolon.csv", "tab.txt", "day_first.csv", "month_first.csv", "two_columns.csv", "long.csv", "unit_row.csv",
    "preamble.csv", "epoch.csv", "seconds.csv", "dirty.csv",
    "everything.csv",
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_one_run_gives_a_map_and_a_plant_that_read_the_log(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = drafted_logs(tmp_path)[kind]
    assert main(["init", "--data", str(log), "--out", str(tmp_path / "draft")]) == 0
    assert "next: fusion-sfdia check-log" in capsys.readouterr().out
    plant = registered(f"{tmp_path / 'draft' / 'plant.py'}:make")
    found = load_log(log, plant, tmp_path / "draft" / "map.toml")
    assert plant.dt == 60.0 and plant.sensor_names == tuple(t.replace(".", "_").replace("-", "_") for t in TAGS[:4])
    assert len(found.log.t) == STEPS and np.allclose(np.diff(found.log.t), 60.0)
    right = readings()[:, :4]
    wrong = np.argwhere(~np.isclose(found.log.y, right, rtol=0, atol=1e-9))
    assert wrong.tolist() == ([[20, 1], [21, 1], [40, 0]] if kind in DIRTY else [])
    assert np.all(np.isnan(found.log.y[tuple(wrong.T)]))
    assert "unsure" in (tmp_path / "draft" / "map.toml").read_text()  # the inflow, which is 7.2 throughout
    # the noise of the readings, 10 mm and 0.3 degC
    assert [s.sigma for s in plant.sensors] == pytest.approx([10.0, 10.0, 0.3, 0.3], rel=0.25)


@pytest.mark.parametrize("kind", ["semicolon.csv", "two_columns.csv", "long.csv"])
def test_a_log_is_diagnosed_by_the_draft_without_a_false_event(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    drafted_logs(tmp_path)
    given = ["--plant", "plant.py:make", "--data", kind, "--map", "map.toml"]
    assert main(["init", "--data", kind]) == 0
    assert main(["check-log", *given]) == 0
    assert main(["diagnose", *given, "--out", "found"]) == 0
    assert "no fault\n" in capsys.readouterr().out


@pytest.mark.parametrize("kind", KINDS)
def test_tags_are_found_among_the_sensors_and_inputs_of_a_plant(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = drafted_logs(tmp_path)[kind], tmp_path / "draft"
    assert main(["init", "--data", str(log), "--plant", f"{HELPERS}:vat", "--out", str(out)]) == 0
    assert [p.name for p in out.iterdir()] == ["map.toml"]
    found = load_log(log, vat(), out / "map.toml")
    right = readings() * [1e-3, 1e-3, 1.0, 1.0, 1 / 3600.0] + [0.0, 0.0, 273.15, 273.15, 0.0]
    known = np.isfinite(found.log.y)
    assert np.sum(~known) == (3 if kind in DIRTY else 0)
    assert np.allclose(found.log.y[known], right[:, :4][known]) and np.allclose(found.log.u, 7.2 / 3600.0)
    columns = tomllib.loads((out / "map.toml").read_text())["columns"]
    assert [c.get("sensor", c.get("input")) for c in columns.values()] == [
        "level_1", "level_2", "temperature_1", "temperature_2", "inflow",
    ]  # fmt: skip


def test_what_fits_in_several_ways_is_marked_with_the_alternatives(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = drafted_logs(tmp_path)
    assert main(["init", "--data", str(logs["day_first.csv"]), "--plant", f"{HELPERS}:vat", "--out", str(tmp_path)]) == 0
    lines = (tmp_path / "map.toml").read_text().splitlines()
    assert 'format = "%d/%m/%Y %H:%M"  # unsure: or "%m/%d/%Y %H:%M"' in lines
    assert any(line.startswith("# tz = ") and "no time zone" in line for line in lines)
    assert any("TT-201" in line and "its values fit degC" in line and "also temperature_2" in line for line in lines)
    printed = capsys.readouterr().out
    assert "  format: unsure" in printed and "  U7.LT-101.PV: unsure" in printed


def test_excel_and_packed_files_and_those_of_a_logger_are_drafted(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("openpyxl", reason="Excel files need openpyxl, which is not installed")
    logs, values = drafted_logs(tmp_path), readings()
    frame = pandas.DataFrame(values, columns=TAGS)
    frame.insert(0, "Stamp", pandas.date_range("2025-02-03 06:00", periods=STEPS, freq="min"))
    frame.to_excel(tmp_path / "book.xlsx", index=False)
    frame.to_parquet(tmp_path / "frame.parquet")
    (tmp_path / "packed.csv.gz").write_bytes(gzip.compress(logs["comma.csv"].read_bytes()))
    head, *rows = logs["comma.csv"].read_text().splitlines()
    kinds = ",".join(['"RN"', *['"Avg"'] * len(TAGS)])
    titles = head.replace("Timestamp", "TIMESTAMP")
    above = ['"TOA5","CR1000","CR1000","1","std","prog","7","Table1"', titles, ",".join(['"TS"', *UNITS]), kinds]
    (tmp_path / "logger.dat").write_text("\n".join([*above, *rows]) + "\n")
    for name in ("book.xlsx", "frame.parquet", "packed.csv.gz", "logger.dat"):
        out = tmp_path / f"of_{name}"
        assert main(["init", "--data", str(tmp_path / name), "--out", str(out)]) == 0, name
        found = load_log(tmp_path / name, registered(f"{out / 'plant.py'}:make"), out / "map.toml")
        assert np.allclose(found.log.y, values[:, :4]), name


def test_units_in_the_cells_and_columns_of_states(tmp_path: Path) -> None:
    flow, speed = (np.round(m + np.sin(np.arange(60.0)), 2) for m in (30.0, 1500.0))
    rows = [
        f"2025-01-01 00:{k:02d}:00,{flow[k]} m3/h,{speed[k]} rpm,{'Running' if k // 20 % 2 else 'Stopped'}" for k in range(60)
    ]
    (tmp_path / "log.csv").write_text("\n".join(["time,flow,speed,pump", *rows]) + "\n")
    assert main(["init", "--data", str(tmp_path / "log.csv"), "--out", str(tmp_path)]) == 0
    plant = registered(f"{tmp_path / 'plant.py'}:make")
    assert [(s.name, s.unit) for s in plant.sensors] == [("flow", "m3/h"), ("speed", "rpm")]
    assert np.array_equal(load_log(tmp_path / "log.csv", plant, tmp_path / "map.toml").log.y, np.column_stack([flow, speed]))
    line = '# "pump" = { input = "pump", states = { "Stopped" = 0.0, "Running" = 1.0 } }  # unsure: '
    text = (tmp_path / "map.toml").read_text()
    assert line in text
    tomllib.loads(text.replace('# "pump"', '"pump"'))


def test_what_a_draft_cannot_settle_is_printed_and_stated_in_the_map(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.csv"
    rows = drafted_logs(tmp_path)["comma.csv"].read_text().splitlines()
    path.write_text(
        "\n".join([rows[0].replace("U7.TT-202.PV", "operator"), *(r.rsplit(",", 2)[0] + ",Ann,7.2" for r in rows[1:])])
    )
    assert main(["init", "--data", str(path), "--plant", f"{HELPERS}:vat", "--out", str(tmp_path)]) == 2
    printed, err = capsys.readouterr()
    assert "no column for the sensors 'temperature_2'" in err
    text = (tmp_path / "map.toml").read_text()
    assert "# Still to be settled:\n# - no column for the sensors 'temperature_2'" in text
    assert '# "operator" = { sensor = "..." }  # texts \'Ann\'' in text
    assert "next:" not in printed and tomllib.loads(text)["columns"].keys() >= {"U7.LT-101.PV"}


def test_files_that_are_there_are_replaced_only_by_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = drafted_logs(tmp_path)["comma.csv"]
    (tmp_path / "plant.py").write_text("mine\n")
    given = ["init", "--data", str(log), "--out", str(tmp_path)]
    assert main(given) == 2
    assert "plant.py exists" in capsys.readouterr().err
    assert (tmp_path / "plant.py").read_text() == "mine\n" and not (tmp_path / "map.toml").exists()
    assert main([*given, "--force"]) == 0 and "def make" in (tmp_path / "plant.py").read_text()


def test_titles_cannot_leave_their_place_in_the_files(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    titles = ['"a""]\\"', '"b\n[log]\ntz = 1"', "c#{{ 7 }}", "d'''"]
    rows = [",".join([f"2025-01-01 00:{k:02d}:00", *(str(np.sin(k + i)) for i in range(4))]) for k in range(30)]
    path.write_text("\n".join([",".join(["time", *titles]), *rows]))
    assert main(["init", "--data", str(path), "--out", str(tmp_path / "draft")]) == 0
    assert len(registered(f"{tmp_path / 'draft' / 'plant.py'}:make").sensors) == 4
    assert len(tomllib.loads((tmp_path / "draft" / "map.toml").read_text())["columns"]) == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mine\n", "no column of times"),
        ("a,b\nx,y\n", "no column of times"),
        ("1,2,3\n4,5,6\n", "write a header"),
        ("a,b\n1,2\n5,3\n2,9\n7,1\n1,1\n", "no column of times"),
    ],
)
def test_a_file_that_is_no_log_is_refused(text: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "log.csv").write_text(text)
    assert main(["init", "--data", str(tmp_path / "log.csv"), "--out", str(tmp_path)]) == 2
    assert message in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["log.csv"]
