"""The command `inspect`: the verdict first, JSON, files, and an exit code that states whether the plant is ready."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia import simulate
from fusion_sfdia.cli.main import main
from fusion_sfdia.logs.csv_log import write_log
from fusion_sfdia.models.two_tanks.plant import two_tanks

BROADCAST = """
import numpy as np
from fusion_sfdia import Plant, Sensor, Signal

def step(t, x, u, dt):
    return x + dt * (0.1 - 0.1 * x[..., :1])

def output(t, x, u):
    return x

def make():
    states = [Signal(name, nominal=1.0, initial_sigma=0.1, process_sigma=0.01) for name in "ab"]
    return Plant("own", states, [Sensor(name, name, sigma=0.1) for name in "ab"], step, output, 1.0)
"""


def test_a_plant_without_a_mistake_is_ready(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "found"
    command = ["inspect", "--plant", "two-tanks", "--detectors", "loo-glr", "--sensors", "l1,q2", "--out", str(out)]
    assert main(command) == 0
    text = capsys.readouterr().out
    assert text.startswith("two-tanks: ready for diagnosis\n4 sensors, 2 states, 1 input, a reading every 5 s\n")
    assert (out / "inspection.txt").read_text(encoding="utf-8") == text
    assert json.loads((out / "inspection.json").read_text(encoding="utf-8"))["ready"] is True
    assert main(command) == 2
    assert "name another folder with --out, or replace what is there with --force" in capsys.readouterr().err


def test_a_plant_with_a_mistake_is_not(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text(BROADCAST, encoding="utf-8")
    assert main(["inspect", "--plant", f"{file}:make"]) == 1
    text = capsys.readouterr().out
    assert text.startswith("own: NOT READY, 1 mistake to correct\n")
    assert "a single derivative was broadcast to all states" in " ".join(text.split())
    assert main(["inspect", "--plant", f"{file}:make", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["verdict"] == "own: NOT READY, 1 mistake to correct"


def test_a_healthy_log_is_examined(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    plant = two_tanks()
    recording = simulate(plant, 100, seeds=[4])
    write_log(tmp_path / "log.csv", plant, recording.t, recording.y[:, 0], recording.u_of_runs[:, 0])
    assert main(["inspect", "--plant", "two-tanks", "--data", str(tmp_path / "log.csv"), "--no-simulation"]) == 0
    assert "100 readings, normalised innovation squared" in capsys.readouterr().out


def test_warnings_are_printed_as_those_of_the_other_commands(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    plant = two_tanks()
    recording = simulate(plant, 100, seeds=[4])
    y = recording.y[:, 0] + np.where(recording.t > 150, 1.0, 0.0)[:, None] * 20 * plant.sensor_sigma * [1, -1, 1, -1.5]
    write_log(tmp_path / "log.csv", plant, recording.t, y, recording.u_of_runs[:, 0])
    assert main(["inspect", "--plant", "two-tanks", "--data", str(tmp_path / "log.csv"), "--no-simulation"]) == 0
    assert capsys.readouterr().err.startswith("fusion-sfdia: warning: more sensors would be isolated in ")


def test_a_log_with_a_map_is_read_as_diagnose_reads_it(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    plant = two_tanks()
    recording = simulate(plant, 100, seeds=[4])
    write_log(tmp_path / "log.csv", plant, recording.t, recording.y[:, 0], recording.u_of_runs[:, 0])
    header, *rows = (tmp_path / "log.csv").read_text().splitlines()
    titles = [title.split(" [")[0] for title in header.split(",")]
    (tmp_path / "plain.csv").write_text("\n".join([",".join([*titles, "tag"]), *(f"{row},1" for row in rows)]) + "\n")
    (tmp_path / "own.csv").write_text("\n".join([";".join([titles[0], "LT1", *titles[2:]]), *rows]).replace(",", ";") + "\n")
    (tmp_path / "map.toml").write_text(
        '[log]\nseparator = ";"\ninputs = "until the sample"\n[columns]\nLT1 = { sensor = "l1" }\n'
    )
    of = ["inspect", "--plant", "two-tanks", "--no-simulation", "--json", "--data"]
    found = []
    for arguments in (["log.csv"], ["plain.csv", "--other-columns"], ["own.csv", "--map", str(tmp_path / "map.toml")]):
        assert main([*of, str(tmp_path / arguments[0]), *arguments[1:]]) == 0
        found.append(json.loads(capsys.readouterr().out)["healthy"])
    assert found[0]["samples"] == 100 and found[0] == found[1] == found[2]


def test_what_is_unknown_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "--plant", "two-tanks", "--sensors", "l9"]) == 2
    assert capsys.readouterr().err == "fusion-sfdia: unknown sensor 'l9' of plant 'two-tanks'; known: l1, l2, q12, q2\n"
