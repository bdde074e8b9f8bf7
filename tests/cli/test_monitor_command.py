"""The command `monitor`: from healthy logs, or from what was kept, to a diagnosis and its files."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_schema import require_described

from fusion_sfdia.cli.main import main
from fusion_sfdia.learning.monitor.held_out import BLOCKS
from fusion_sfdia.learning.monitor.monitor import Monitor
from fusion_sfdia.logs.physics import StatedPhysics
from fusion_sfdia.plant.log import Log

DT = 10.0
NAMES = ("a [K]", "b [bar]", "c [K]", "d [m3/h]")


def made(seed: int, rows: int = 600) -> Log:
    """Four readings of one thing that follows a load."""
    rng = np.random.default_rng(seed)
    u, x = np.zeros((rows, 1)), np.zeros(rows)
    for k in range(1, rows):
        u[k] = 0.98 * u[k - 1] + 0.2 * rng.standard_normal()
        x[k] = 0.9 * x[k - 1] + 0.1 * u[k, 0] + 0.3 * rng.standard_normal()
    return Log(DT * np.arange(rows), x[:, None] * [1.0, -2.0, 0.5, 1.5] + 0.3 * rng.standard_normal((rows, 4)), u)


def faulty() -> Log:
    t, y, u = made(21)
    y[300:400, 1] += 6.0
    y[500:, 3] = y[500, 3]
    return Log(t, y, u)


def written(path: Path, log: Log) -> str:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["time", *NAMES, "load [kW]", "remark"])
        table.writerows([t, *["" if np.isnan(v) else v for v in y], *u, 1] for t, y, u in zip(*log, strict=True))
    return str(path)


@pytest.fixture
def healthy(tmp_path: Path) -> list[str]:
    """The options that give two healthy logs."""
    logs = [written(tmp_path / f"h{seed}.csv", made(seed)) for seed in range(2)]
    return [*(a for path in logs for a in ("--healthy", path)), "--inputs", "load", "--ignore", "remark"]


def test_a_log_in_another_unit_than_the_healthy_ones_is_said_to_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], undrawn: None
) -> None:
    paths, out = [], tmp_path / "out"
    for seed, factor in ((0, 1.0), (21, 1000.0)):
        t, y, u = made(seed)
        paths.append(written(tmp_path / f"{seed}.csv", Log(t, factor * (y + 100.0), u)))
    command = [
        "monitor",
        "--healthy",
        paths[0],
        "--data",
        paths[1],
        "--inputs",
        "load",
        "--ignore",
        "remark",
        "--out",
        str(out),
    ]
    assert main(command) == 1
    said, page = capsys.readouterr().out, (out / "report.html").read_text(encoding="utf-8")
    for name in "ac":  # in K; a pressure may be off by more units
        text = f"{name} looks 1000 times too large: usually"
        assert said.count(text) == page.count(text) == 1 and page.index(text) < page.index("What was learnt")
    assert (
        (out / "reconstructed.csv").read_text(encoding="utf-8").startswith("time [s],a [K],b [bar],c [K],d [m3/h],load [kW],")
    )


def test_learning_and_diagnosing_show_the_time_that_is_left(
    healthy: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, undrawn: None
) -> None:
    """By their parts, whose number is known from the start: blocks of healthy rows, and the rows of a log some at a time."""
    shown: list[tuple[str, int]] = []

    def noted(steps: Sequence[Any], what: str) -> Iterator[Any]:
        for k, step in enumerate(steps):
            shown.append((what, len(steps) - k))
            yield step

    monkeypatch.setattr("fusion_sfdia.report.progress.progress", noted)
    monkeypatch.setattr("fusion_sfdia.learning.monitor.monitor.AT_ONCE", 200)
    assert main(["monitor", *healthy, "--data", written(tmp_path / "data.csv", faulty()), "--out", str(tmp_path / "out")]) == 0
    left = {what: [n for found, n in shown if found == what] for what, _ in shown}
    assert left == {"learning": list(range(BLOCKS, 0, -1)), "diagnosing": [3, 2, 1]}


@pytest.mark.slow
def test_a_log_is_diagnosed_and_what_was_learnt_is_kept(
    healthy: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out, kept = written(tmp_path / "data.csv", faulty()), tmp_path / "out", str(tmp_path / "plant.sfdia")
    command = ["monitor", *healthy, "--data", data, "--save", kept, "--out", str(out)]
    assert main([*command, "--json"]) == 0
    shown = capsys.readouterr()
    document = require_described(shown.out)
    assert document["health"] is None and document["state"] == "sensor" and document["detector"] == "the monitor"
    events = {e["hypothesis"]: e for e in document["events"] if e["kind"] == "sensor" and not (e["confidence"] or 1) < 0.5}
    assert abs(events["b"]["start"] - 3000) <= 4 * DT and abs(events["b"]["size"] - 6.0) < 0.6
    assert events["d"]["fault"] == "freeze" and events["d"]["open"]
    assert shown.err.count("rows in alarm without a fault") == 1  # and not again below what was found
    files = {"monitor.txt", "report.html", "events.csv", "reconstructed.csv", "scores.csv", "diagnosis.svg", "diagnosis.png"}
    assert files == {p.name for p in out.iterdir() if not p.name.startswith(".")}
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Judged by healthy logs, without a model" in page and "model not tested" not in page
    learnt = page.index("rows in alarm without a fault")
    assert page.index("<h2>Each finding") < page.index("Statistics, and how to read them") < learnt  # folded
    assert main(command) == 2 and "already used" in capsys.readouterr().err
    assert main(["monitor", "--monitor", kept, "--data", data, "--out", str(tmp_path / "again"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == document


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--data", "log.csv"], "state healthy logs with --healthy"),
        (["--healthy", "log.csv", "--monitor", "m.sfdia"], "state healthy logs with --healthy"),
        (["--healthy", "log.csv"], "state the log to diagnose with --data"),
        (["--monitor", "m.sfdia", "--data", "log.csv", "--inputs", "load"], "are for learning"),
        (["--monitor", "m.sfdia", "--data", "log.csv", "--same", "a,b"], "are for learning"),
        (["--healthy", "log.csv", "--save", "m.sfdia", "--drives", "load"], "expected an input and what it drives"),
        (["--monitor", "m.sfdia", "--data", "log.csv"], "cannot be read"),
    ],
)
def test_arguments_that_do_not_go_together_are_refused(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["monitor", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not list((tmp_path / "monitor").glob("*/*.html"))


def test_physics_is_stated_by_options_and_by_the_map(
    healthy: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept, log_map = str(tmp_path / "plant.sfdia"), tmp_path / "map.toml"
    log_map.write_text('[physics]\nsame = ["a", "c"]\n')
    options = ["--same", "b,d", "--drives", "load=a, b", "--drives", "load=c", "--map", str(log_map)]
    assert main(["monitor", *healthy, *options, "--save", kept]) == 0
    told = ["a, c: stated to measure one quantity", "b, d: stated to measure one quantity", "a, b, c: stated to move with load"]
    assert [line for line in capsys.readouterr().out.splitlines() if " stated to " in line] == told
    assert Monitor.load(kept).physics == StatedPhysics([["a", "c"], ["b", "d"]], {"load": ["a", "b", "c"]})
    assert main(["monitor", *healthy, "--same", "a,e", "--save", kept]) == 2
    assert "same: 'e' is no column of the logs; expected a sensor, one of a, b, c, d" in capsys.readouterr().err


def test_an_input_that_no_log_has_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path / "log.csv", made(1, 80))
    assert main(["monitor", "--healthy", path, "--data", path, "--inputs", "lod", "--out", str(tmp_path / "out")]) == 2
    assert "no column 'lod'" in capsys.readouterr().err and not (tmp_path / "out").exists()
