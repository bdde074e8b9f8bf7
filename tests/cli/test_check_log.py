"""`check-log` states what reading a log found, and `diagnose --map` diagnoses what it read."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from realistic_logs import PLAIN, Logged, comma, csv, iso, local

from fusion_sfdia.cli.main import main

PLANT = f"{Path(__file__).parents[1] / 'helpers' / 'realistic_logs.py'}:vessel"
HEADER = ["Timestamp", "P1.TT-101.PV", "P1.PT-101.PV", "P1.LT-101.PV", "P1.FC-001.PV"]
MAP = """
[log]
time = "Timestamp"
tz = "Europe/Amsterdam"
format = "%d-%m-%Y %H:%M:%S"
decimal = ","
separator = ";"
duplicates = "last"
hold = 120
"""


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    """A log with four duplicates, three missing inputs and a pressure in bar that its map does not state."""
    rows = Logged().rows(local, comma)
    for k in (5, 6, 20):
        rows[k][4] = ""
    csv(tmp_path / "log.csv", [HEADER, *(row for k, row in enumerate(rows) for _ in range(2 if k % 60 == 30 else 1))], ";")
    (tmp_path / "map.toml").write_text(MAP + PLAIN.replace(', unit = "bar"', ""))
    return ["--plant", PLANT, "--data", str(tmp_path / "log.csv"), "--map", str(tmp_path / "map.toml")]


def test_what_was_found_is_printed(files: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check-log", *files]) == 1  # it cannot be used as it was read
    assert capsys.readouterr().out.splitlines() == [
        "240 rows from 2024-07-01 12:00:00+02:00 to 2024-07-01 15:59:00+02:00, usually 60 s apart; times are stamps of "
        "Europe/Amsterdam",
        "4 duplicates dropped, the last of each time kept",
        "3 feed values held",
        'inputs taken as acting from their row until the next (inputs = "at the sample", as historians log them)',
        "PT101 looks 100000 times too small: usually 4.001 Pa, the model predicts 4e+05; state its unit in a map",
    ]
    assert main(["check-log", *files, "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert {"kind": "held", "name": "feed", "count": 3, "text": "3 feed values held"} in found


def test_a_wrong_unit_is_reported_and_no_fault(files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diagnose", *files, "--out", str(tmp_path / "out"), "--detector", "loo-glr"]) == 1
    out, err = capsys.readouterr()
    assert "240 readings by loo-glr: cannot tell: the unit of PT101 looks wrong" in out  # it is taken as missing
    assert "PT101 looks 100000 times too small" in err and "3 feed values held" in err and "4 duplicates" in err


def test_a_log_without_a_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = csv(
        tmp_path / "log.csv", [["time", "TT101 [degC]", "PT101 [bar]", "LT101 [mm]", "feed [m3/h]"], *Logged().rows(iso)]
    )
    assert main(["check-log", "--plant", PLANT, "--data", str(path)]) == 0
    assert "having acted until their row" in capsys.readouterr().out
