"""Generated logs and maps with mistakes: one clear line each, nothing half-written, no misread value."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from malformed_logs import malformed, verdict
from realistic_logs import vessel

from fusion_sfdia.cli.main import main

PLANT = vessel()


def check(seeds: range, folder: Path) -> Counter[str]:
    kinds: Counter[str] = Counter()
    for seed in seeds:
        log, log_map = malformed(seed, folder)
        kind, text = verdict(PLANT, log, log_map)
        kinds[kind] += 1
        assert kind != "misread", f"seed {seed}: {text}"
        if kind == "refused":
            assert all(len(line) < 700 for line in text.splitlines()) and ("log.csv" in text or "map" in text), (
                f"seed {seed}: {text}"
            )
    return kinds


def test_a_few_hundred_malformed_logs(tmp_path: Path) -> None:
    kinds = check(range(400), tmp_path)
    assert kinds["refused"] > 200 and kinds["read"] > 20, kinds


@pytest.mark.long
def test_ten_thousand_malformed_logs(tmp_path: Path) -> None:
    kinds = check(range(1000, 11000), tmp_path)
    print(kinds)
    assert kinds["refused"] > 5000


def test_the_command_prints_a_line_a_problem_and_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    helpers = Path(__file__).parents[1] / "helpers" / "realistic_logs.py"
    refused = 0
    for seed in range(40):
        log, log_map = malformed(seed, tmp_path)
        if verdict(PLANT, log, log_map)[0] != "refused":
            continue
        refused += 1
        for command in ("check-log", "diagnose"):
            out = [] if command == "check-log" else ["--out", str(tmp_path / "out" / "deep")]
            plant = f"{helpers}:vessel"
            assert main([command, "--plant", plant, "--data", str(log), "--map", str(log_map), *out]) == 2
            printed, err = capsys.readouterr()
            assert printed == "" and err.startswith("fusion-sfdia: "), f"seed {seed}: {err}"
            first, *lines = err.splitlines()
            assert not lines or first.endswith("problems"), f"seed {seed}: {err}"
            assert all(line.startswith("  ") and line.strip() for line in lines), f"seed {seed}: {err}"
        assert {path.name for path in tmp_path.iterdir()} == {"log.csv", "map.toml"}
    assert refused > 20
