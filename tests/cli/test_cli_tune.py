"""The command `tune`, and `diagnose` with what it has tuned or on a healthy stretch of the log itself."""

from __future__ import annotations

import io
import json
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas
import pytest

from fusion_sfdia.cli.main import main
from fusion_sfdia.logs.cell_tables import read_table
from fusion_sfdia.study.comparison.compare import ComparisonResult

TOY = """
from toy_plants import chain


def make():
    return chain(3, process=0.3)
"""

NOTHING = ComparisonResult([], [], [], [], None, "")


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = main(arguments)
    out, err = capsys.readouterr()
    return code, out, err


def with_further(path: str, seed: int, off: slice | None = None) -> None:
    """The log of the toy plant with two further channels, a state in words and one that never moves; off: rows of a fault."""
    log, rng = pandas.read_csv(path), np.random.default_rng(seed)
    both = log["s1 [1]"] + log["s2 [1]"]
    log["mean [1]"], log["sum"] = (factor * both + 0.1 * rng.standard_normal(len(log)) for factor in (0.5, 1.0))
    log["mode"], log["lamp"] = "auto", 1.0
    if off is not None:
        log.loc[log.index[off], "sum"] += 20.0
    log.to_csv(path, index=False)


def test_further_columns_are_learnt_and_judged(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("toy.py").write_text(TOY)
    plant = ("--plant", "toy.py:make")
    for name, seed, steps in (("a", "1", "400"), ("b", "2", "80")):
        call(capsys, "simulate", *plant, "--steps", steps, "--seed", seed, "--process-noise", "--out", f"{name}.csv")
    with_further("a.csv", 1)
    with_further("b.csv", 2, slice(50, 80))
    tune = ("tune", *plant, "--healthy", "a.csv", "--false-alarm", "0.02", "--other-columns")
    for further, error in (
        ("s1", "further 's1': plant 'chain' has them already; name other columns of the log"),
        ("sun", "further 'sun': no columns of the log; beside those of the plant it has 'mean', 'sum', 'mode', 'lamp'"),
    ):
        code, _, err = call(capsys, *tune, "--further", further)
        assert code == 2 and error in err
    code, out, _ = call(capsys, *tune, "--further", "all")
    assert code == 0 and "of its sensors and 3 further channels" in out
    assert "monitor: lamp never moved when healthy" in out
    written = tomllib.loads(Path("tuned.toml").read_text())
    assert list(written["further"]) == ["mean", "sum", "lamp"] and written["detector"]["monitor"] == "tuned.sfdia"

    tuned = (*plant, "--tuned", "tuned.toml", "--other-columns")
    code, out, _ = call(capsys, "diagnose", *tuned, "--data", "b.csv", "--json", "--out", "found")
    found = json.loads(out)
    assert code == 0 and found["verdict"] == "sensor sum" and {e["hypothesis"] for e in found["events"]} == {"sum"}, out
    code, out, _ = call(capsys, "check-log", *tuned, "--data", "b.csv")
    assert code == 0 and "1 column not used: 'mode'" in out
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(Path("b.csv").read_bytes())))
    code, out, _ = call(capsys, "watch", *tuned)
    lines = [json.loads(line) for line in out.splitlines()]
    assert code == 0 and {line["hypothesis"] for line in lines if line["event"] == "opened"} == {"sum"}, out

    short = pandas.read_csv("b.csv").drop(columns="sum")
    short.to_csv("c.csv", index=False)
    code, _, err = call(capsys, "diagnose", *tuned, "--data", "c.csv", "--out", "other")
    assert code == 2 and "no column for the sensors 'sum' of plant 'chain'" in err, err
    Path("tuned.sfdia").unlink()
    code, _, err = call(capsys, "diagnose", *tuned, "--data", "b.csv", "--out", "other")
    assert code == 2 and "tuned.sfdia cannot be read" in err


@pytest.mark.slow
def test_tune_then_diagnose(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("toy.py").write_text(TOY)
    plant = ("--plant", "toy.py:make")
    for name, seed in (("a", "1"), ("b", "2")):
        call(capsys, "simulate", *plant, "--steps", "250", "--seed", seed, "--process-noise", "--out", f"{name}.csv")
    tune = ("tune", *plant, "--healthy", "a.csv", "--healthy", "b.csv", "--false-alarm", "0.02")
    code, out, err = call(capsys, *tune)
    assert code == 0 and out.startswith("frozen-model on chain, ") and out.endswith("in tuned.toml\n")
    assert "learning from 500 samples" in err
    written = tomllib.loads(Path("tuned.toml").read_text())
    assert [row["file"] for row in written["healthy"]] == ["a.csv", "b.csv"]
    assert [row["rows"] for row in written["healthy"]] == [250, 250]

    code, _, err = call(capsys, *tune)
    assert code == 2 and "tuned.toml exists; name another file with --out, or replace it with --force" in err

    log = Path("b.csv").read_text().splitlines()
    for k in range(230, 251):
        cells = log[k].split(",")
        log[k] = ",".join([cells[0], str(float(cells[1]) + 10.0), *cells[2:]])
    Path("c.csv").write_text("\n".join(log) + "\n")
    diagnose = ("diagnose", *plant, "--data", "c.csv", "--json", "--force")
    code, out, _ = call(capsys, *diagnose, "--tuned", "tuned.toml")
    assert code == 0
    tuned = json.loads(out)["events"]
    assert "s0" in [e["hypothesis"] for e in tuned if 230 <= e["start"] <= 234]
    reads: list[Any] = []
    with monkeypatch.context() as patch:
        patch.setattr("fusion_sfdia.logs.reading.read_table", lambda *given: reads.append(given) or read_table(*given))
        code, out, _ = call(capsys, *diagnose, "--healthy", "..220")
    assert len(reads) == 1
    assert code == 0 and "s0" in [e["hypothesis"] for e in json.loads(out)["events"] if 230 <= e["start"] <= 234]

    # of another noise than the plant's, because nothing may have been learnt
    assert call(capsys, *tune, "--detector", "robust-glr", "--out", "bank.toml")[0] == 0
    louder = Path("bank.toml").read_text().replace("s0 = { sigma = 1.0", "s0 = { sigma = 2.0")
    Path("louder.toml").write_text(louder)
    code, out, _ = call(capsys, "inspect", *plant, "--tuned", "louder.toml", "--data", "b.csv", "--no-simulation", "--json")
    nis = [json.loads(out)["healthy"]["white"]["nis"]]
    code, out, _ = call(capsys, "inspect", *plant, "--data", "b.csv", "--no-simulation", "--json")
    nis.append(json.loads(out)["healthy"]["white"]["nis"])
    assert code == 0 and nis[0] < nis[1]
    code, _, err = call(capsys, "inspect", "--plant", "two-tanks", "--tuned", "tuned.toml")
    assert code == 2 and "tuned.toml: it was tuned for another plant than 'two-tanks'" in err

    # the other commands on a plant
    for k, more in enumerate(((), ("--tuned", "louder.toml"))):
        call(capsys, "simulate", *plant, "--steps", "400", "--truth", "model", *more, "--out", f"of_{k}.csv")
    once, twice = (
        pandas.read_csv(f"of_{k}.csv")["s0 [1]"][200:] for k in (0, 1)
    )  # .95^200: where a run begins does not matter
    np.testing.assert_allclose(twice, 2 * once, atol=1e-3)
    assert call(capsys, "check-log", *plant, "--data", "b.csv", "--tuned", "louder.toml")[0] == 0
    given: list[Any] = []
    with monkeypatch.context() as patch:
        patch.setattr("fusion_sfdia.study.comparison.compare.compare", lambda **settings: given.append(settings) or NOTHING)
        assert call(capsys, "compare", "--plants", "toy.py:make", "--tuned", "louder.toml")[0] == 0
    assert given[0]["plants"].sensors[0].noise_sigma == 2.0
    code, _, err = call(capsys, "compare", "--tuned", "louder.toml")
    assert code == 2 and "--tuned louder.toml is of one plant; name it, and no other, with --plants" in err

    for arguments, reason in (
        (("--tuned", "tuned.toml", "--healthy", "0..100"), "--tuned and --healthy both state what is healthy; give one"),
        (
            ("--tuned", "tuned.toml", "--detector", "pca"),
            "tuned.toml: it was tuned for frozen-model, not pca; leave --detector out",
        ),
        (("--tuned", "toy.py"), "toy.py is not a TOML file"),
        (("--healthy", "300..400"), "no reading from 300 to 400; the log goes from 1 s to 250 s"),
    ):
        code, _, err = call(capsys, *diagnose, *arguments)
        assert code == 2 and reason in err and err.count("\n") == 1, err
    code, _, err = call(capsys, "diagnose", "--plant", "two-tanks", *diagnose[3:], "--tuned", "tuned.toml")
    assert code == 2 and "tuned.toml: it was tuned for another plant than 'two-tanks'" in err and err.count("\n") == 1, err


def test_tune_refuses_before_it_learns(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("toy.py").write_text(TOY)
    plant = ("--plant", "toy.py:make")
    call(capsys, "simulate", *plant, "--steps", "250", "--out", "a.csv")
    for arguments, reason in (
        (("--healthy", "a.csv", "--false-alarm", "1/moon"), "expected such as 1/day, 2/hour or 1e-3"),
        (("--healthy", "a.csv", "--detector", "robust-glr"), "too short for 1/day (one sample in 8.64e+04): 250 samples"),
        (("--healthy", "missing.csv"), "missing.csv"),
        (("--healthy", "a.csv", "--detector", "loo-gir", "--false-alarm", "0.1"), "unknown detector 'loo-gir'"),
    ):
        code, _, err = call(capsys, "tune", *plant, *arguments)
        assert code == 2 and reason in err, err
    assert not Path("tuned.toml").exists()
