"""The command `watch` on a stream of rows: lines out, a kill, and the same events."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import urllib.request
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnosis_schema import require_event, require_line
from toy_plants import readings, tanks

from fusion_sfdia.cli.main import main
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.logs.csv_log import write_log
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.plant.plant import Plant

PATIENCE = 120  # s, after which the test fails instead of hanging
DETECTOR = ["--plant", "two-tanks", "--detector", "loo-chi2"]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """200 rows, with a bias of l1 in samples 60 to 99 and of q2 from 150 on."""
    t, _, y, u = readings(tanks(), 200, 1, seed=1)
    y = y[:, 0].copy()
    y[60:100, 0] += 0.5
    y[150:, 3] += 3e-4
    write_log(tmp_path / "log.csv", tanks(), t, y, u[:, 0])
    return tmp_path / "log.csv"


def watched(monkeypatch: pytest.MonkeyPatch, text: bytes, *options: str) -> int:
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(text)))
    return main(["watch", *DETECTOR, *options])


def test_rows_in_and_a_json_line_an_event_and_a_sample_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], log: Path
) -> None:
    text = log.read_bytes()
    assert watched(monkeypatch, text) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    long = [e for e in events if e["event"] == "opened" and e["hypothesis"] in ("l1", "q2")]
    assert [(e["hypothesis"], e["t"]) for e in long][:2] == [("l1", 305.0), ("q2", 755.0)]
    assert watched(monkeypatch, text, "--samples") == 0
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [e for e in found if e["event"] != "sample"] == events
    samples = [e for e in found if e["event"] == "sample"]
    for line in samples:
        require_line("sample", line)
    assert [s["t"] for s in samples] == [5.0 * k for k in range(1, 201)]
    bad = samples[70]
    assert "l1" in bad["isolated"] and bad["alarm"]
    assert bad["sigma"]["l1"] != 0.01 and bad["sigma"]["l2"] == 0.01  # of the estimate, of the sensor
    header, *rows = text.decode().splitlines()
    names = [cell.split()[0] for cell in header.split(",")]
    lines = [json.dumps({n: float(c) for n, c in zip(names, r.split(","), strict=True)}) for r in rows]
    assert watched(monkeypatch, "\n".join(lines).encode()) == 0
    assert [json.loads(line) for line in capsys.readouterr().out.splitlines()] == events


def test_what_is_no_row_is_said_and_counted_and_ends_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], log: Path
) -> None:
    header, *rows = log.read_bytes().splitlines(keepends=True)
    rows[20:20] = [b"a,b\n", b"\xff\xfe,1,2,3,4,5\n", b"\n", header, rows[3], b"x" * 2_500_000 + b"\n"]
    assert watched(monkeypatch, header + b"".join(rows)) == 0
    out, err = capsys.readouterr()
    events = [json.loads(line) for line in out.splitlines()]
    assert events and watched(monkeypatch, log.read_bytes()) == 0
    assert [json.loads(line) for line in capsys.readouterr().out.splitlines()] == events
    said = err.splitlines()
    assert "fusion-sfdia: line 22: 2 cells under a header of 6" in said[0] and "line 23: column time [s]: " in said[1]
    assert "row at 20 s: it is earlier than the last one, at 100 s" in said[2]
    assert said[-1] == f"fusion-sfdia: {len(said) - 1} remarks in all"
    assert watched(monkeypatch, b"time,l1\n1,2\n") == 2
    assert "no column for the sensors" in capsys.readouterr().err
    assert watched(monkeypatch, b"", "--state", str(log / "x")) == 2 and watched(monkeypatch, b"", "--save-every", "0") == 2
    assert "there is no folder" in capsys.readouterr().err


@pytest.mark.slow
def test_a_watch_that_is_killed_and_started_again_has_written_the_same_events(tmp_path: Path, root: Path, log: Path) -> None:
    lines = log.read_text().splitlines(keepends=True)
    command = [sys.executable, "-m", "fusion_sfdia", "watch", *DETECTOR, "--state", "w.state", "--save-every", "20"]
    environment = os.environ | {"PYTHONPATH": str(root)}

    def started() -> subprocess.Popen[str]:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        return subprocess.Popen([*command, "--samples"], cwd=tmp_path, env=environment, text=True, **pipes)  # type: ignore[call-overload, no-any-return]

    first = started()
    assert first.stdin and first.stdout
    first.stdin.writelines(lines[:130])
    first.stdin.flush()
    before = ""
    while '"t": 645.0' not in before:  # the 129th row, after the save at 600 s
        line = first.stdout.readline()
        assert line, "the watch has ended"
        before += line
    first.kill()
    rest, _ = first.communicate(timeout=PATIENCE)
    second = started()
    after, err = second.communicate("".join(lines), timeout=PATIENCE)  # all rows again
    assert second.returncode == 0 and "w.state: goes on after 600 s" in err
    (tmp_path / "w.state").unlink()
    whole, _ = started().communicate("".join(lines), timeout=PATIENCE)
    seen = [line for text in (before + rest, after) for line in text.splitlines(keepends=True) if line.endswith("\n")]
    assert list(dict.fromkeys(seen)) == whole.splitlines(keepends=True)
    assert len(seen) > len(set(seen)) and np.array([len(before), len(after)]).min() > 0


def test_a_tuned_detector_watches(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], log: Path) -> None:
    from fusion_sfdia.learning.tuning.tuned import Tuned

    class Found(Tuned):
        def detector(self, plant: Plant, detector: object = None) -> LeaveOneOutBank:
            return LeaveOneOutBank(plant, window=1, threshold_scale=1000.0)

    found = Found({"detector": {"name": "loo-chi2"}})
    monkeypatch.setattr(Tuned, "read", lambda path: found if path == log.parent / "tuned.toml" else None)
    assert watched(monkeypatch, log.read_bytes(), "--tuned", str(log.parent / "tuned.toml")) == 0
    line = json.loads(capsys.readouterr().out)  # one: its thresholds are far above the faults, which speak against the model
    assert line["event"] == "health" and line["reason"].startswith("model suspect: NIS ")
    assert main(["watch", *DETECTOR[:2], "--tuned", str(log.parent / "tuned.toml"), "--detector", "pca"]) == 2
    assert "was tuned for loo-chi2, not pca" in capsys.readouterr().err


def test_a_map_states_how_rows_are_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path
) -> None:
    """Time stamps, a decimal comma, and inputs that act from their row on, as `diagnose` takes them with the same map."""
    header, *rows = log.read_text().splitlines()
    stamps = [datetime(2026, 3, 1) + timedelta(seconds=float(row.partition(",")[0])) for row in rows]
    cells = [
        ";".join([str(s), *(c.replace(".", ",") for c in row.split(",")[1:])]) for s, row in zip(stamps, rows, strict=True)
    ]
    assert header.startswith("time")
    (tmp_path / "map.toml").write_text('[log]\ntz = "Europe/Amsterdam"\nseparator = ";"\ndecimal = ","\n')
    text = "\n".join([header.replace(",", ";"), *cells])
    (tmp_path / "mapped.csv").write_text(text)
    loaded = load_log(tmp_path / "mapped.csv", tanks(), tmp_path / "map.toml")
    expected = diagnose(LeaveOneOutBank(tanks(), window=1), loaded.log)
    assert watched(monkeypatch, text.encode(), "--map", str(tmp_path / "map.toml"), "--samples") == 0
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    isolated = [[name in s["isolated"] for name in tanks().sensor_names] for s in found if s["event"] == "sample"]
    np.testing.assert_array_equal(isolated, expected.decisions.isolated)
    opened = next(e for e in found if e["event"] == "opened" and e["hypothesis"] == "l1")
    assert opened["time"] == opened["start_time"] == "2026-03-01T00:05:05+01:00"
    require_event(opened)


@pytest.mark.parametrize("stuck", ["inf", "Bad", "ON", "1.5e999", "7 bar", '"1,234"'])
def test_a_sensor_that_gives_no_numbers_any_more_hides_no_fault_of_another(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], log: Path, stuck: str
) -> None:
    header, *rows = log.read_text().splitlines()
    column = [title.split()[0] for title in header.split(",")].index("l2")
    for k in range(60, len(rows)):
        cells = rows[k].split(",")
        cells[column] = stuck
        rows[k] = ",".join(cells)
    assert watched(monkeypatch, "\n".join([header, *rows, ""]).encode(), "--samples") == 0
    out, err = capsys.readouterr()
    found = [json.loads(line) for line in out.splitlines()]
    assert sum(e["event"] == "sample" for e in found) == 200
    assert {"l1", "q2"} <= {e["hypothesis"] for e in found if e["event"] == "opened"}
    assert err.count("column l2") == 2 and "line 62, column l2 [m]: " in err and "140 values could not be used" in err


def test_a_line_that_is_too_long_is_refused_whole(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], log: Path
) -> None:
    header, *rows = log.read_bytes().splitlines(keepends=True)
    text = b"".join([header, *rows[:50], b"x" * 1_000_000 + rows[50], b"9," * 700_000 + b"\n", *rows[51:]])
    assert watched(monkeypatch, text, "--samples") == 0
    out, err = capsys.readouterr()
    times = [found["t"] for found in map(json.loads, out.splitlines()) if found["event"] == "sample"]
    assert times == [5.0 * k for k in range(1, 201) if k != 51]
    assert err.count("it has more than 1000000 bytes; expected a row") == 2


def test_a_page_is_served_while_rows_come(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], log: Path
) -> None:
    rows, pages = log.read_bytes().replace(b"q2 [", b"FI2.PV [", 1).splitlines(keepends=True), list[str]()
    mapped = log.with_name("map.toml")
    mapped.write_text('[columns]\n"FI2.PV" = { sensor = "q2" }\n')

    class Asking(io.BytesIO):
        """Rows, after the 161st of which the page is asked for."""

        def readline(self, *size: Any) -> bytes:
            if self.tell() == sum(map(len, rows[:162])):
                address = re.findall(r"page: (http://127.0.0.1:[0-9]+/)", capsys.readouterr().err)[0]
                with urllib.request.urlopen(address, timeout=PATIENCE) as found:
                    pages.append(found.read().decode())
            return super().readline(*size)

    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=Asking(b"".join(rows))))
    assert main(["watch", *DETECTOR, "--map", str(mapped), "--page", "0", "--page-hours", "0.1"]) == 0
    (page,) = pages
    assert "The last 0.1 hours" in page and "FI2.PV has read" in page and "FI2.PV: out of specification" in page
    assert watched(monkeypatch, b"", "--page", "70000") == 2
    assert "--page is 70000; expected a port" in capsys.readouterr().err
    for options, error in (
        (("--page-hours", "8"), "--page-hours needs --page, the page that goes back so far; add --page 8080, or leave"),
        (("--page", "0", "--page-hours", "-1"), "--page-hours is -1; expected a positive number of hours"),
        (("--page", "0", "--page-hours", "0"), "--page-hours is 0; expected a positive number of hours"),
    ):
        assert watched(monkeypatch, b"", *options) == 2
        assert error in capsys.readouterr().err
