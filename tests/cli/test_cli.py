"""The command line: what it prints, its exit codes, one line for an error."""

from __future__ import annotations

import argparse
import errno
import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from fusion_sfdia import __version__
from fusion_sfdia.cli import listing
from fusion_sfdia.cli import scenarios as runs
from fusion_sfdia.cli.logs import _size
from fusion_sfdia.cli.main import main
from fusion_sfdia.cli.monitor import add_monitor
from fusion_sfdia.common.files import locked, locked_file
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.faults import FAULT_KINDS, Fault, load_faults
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.report.log_report import FILES
from fusion_sfdia.study import scenarios
from fusion_sfdia.study.comparison import protocol

PLANT = gas_pipeline()
HELPERS = Path(__file__).resolve().parents[1] / "helpers"


@pytest.fixture(autouse=True)
def toys(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(scenarios, "SCENARIOS", {"toy/mean": "toy_scenario:TOY"})
    monkeypatch.chdir(tmp_path)


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = main(arguments)
    out, err = capsys.readouterr()
    return code, out, err


def test_list(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = call(capsys, "list", "--json")
    found = json.loads(out)
    assert code == 0
    assert list(found) == ["plants", "detectors", "faults", "scenarios"]
    names = {kind: [e["name"] for e in entries] for kind, entries in found.items()}
    assert names["plants"] == ["gas-pipeline", "marine-engine", "power-network", "two-tanks"]
    assert {"fusing-ekf", "fusing-ukf", "fusing-enkf", "loo-chi2", "loo-glr"} <= set(names["detectors"])
    assert {"bias", "drift", "strong-bias", "weak-drift"} <= set(names["faults"])
    assert names["scenarios"] == ["toy/mean"]
    assert all(e["about"] for entries in found.values() for e in entries)
    code, out, _ = call(capsys, "list", "detectors")
    assert [line.split()[0] for line in out.splitlines()] == names["detectors"]
    code, out, _ = call(capsys, "list")
    assert [line for line in out.splitlines() if not line.startswith(" ")] == ["plants:", "detectors:", "faults:", "scenarios:"]
    assert [e["use"].split(",")[0] for e in found["faults"] if e["name"] in ("weak-bias", "bias")] == ["at random", "kinds"]
    assert [line for line in out.splitlines() if re.match(r" \w", line)] == [f" {listing.DRAWN}:", f" {listing.LISTED}:"]


def test_the_list_marks_detectors_that_test_the_process(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    registered = dict(registry.detectors())
    monkeypatch.setattr(registry, "_DETECTORS", registered)
    detector = f"{HELPERS / 'process_bank.py'}:ProcessBank"
    registry.register_detector("process-bank", "by a fixed rule", detector, tests_process=True)
    code, out, _ = call(capsys, "list", "detectors")
    assert code == 0 and re.search(r"^  process-bank +by a fixed rule \[tests the process, too\]", out, re.MULTILINE)
    assert not re.search(r"^  loo-glr .*tests the process", out, re.MULTILINE)
    listed = {e["name"]: e["tests"] for e in json.loads(call(capsys, "list", "detectors", "--json")[1])["detectors"]}
    assert (listed["loo-glr"], listed["process-bank"]) == ("sensors", "sensors and process")


def test_the_list_states_how_many_sensors_a_detector_isolates_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = call(capsys, "list", "detectors")
    assert re.search(r"^  kf-chi2 .* \[at most 1 sensor at once\]$", out, re.MULTILINE)
    assert re.search(r"^  pca .* \[at most 3 sensors at once\]$", out, re.MULTILINE)
    assert not re.search(r"^  (loo-glr|limits) .*at once", out, re.MULTILINE)


def test_the_list_marks_slow_references(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = call(capsys, "list", "detectors")
    marked = re.findall(r"^  (\S+) .* \[slow reference\]$", out, re.MULTILINE)
    listed = json.loads(call(capsys, "list", "detectors", "--json")[1])["detectors"]
    assert marked == [e["name"] for e in listed if e["reference"] == "yes"] == ["filterpy-ekf", "filterpy-ukf"]


def test_run(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    once = ("run", "toy/*", "--seeds", "2", "--workers", "1", "--set", "size=5", "--set", "figure=no")
    code, out, err = call(capsys, *once, "--json")
    assert (code, err) == (0, "")
    assert [r["detector"] for r in json.loads(out)] == ["a", "b", "a"]
    folder = tmp_path / "results" / "toy-all"
    assert {"metrics.csv", "report.html", "manifest.json"} <= {p.name for p in folder.iterdir()}
    settings = json.loads((folder / "manifest.json").read_text())["scenarios"][0]["settings"]
    assert (settings["size"], settings["figure"]) == (5, False)
    code, out, _ = call(capsys, *once)
    assert out.splitlines() == ["3 rows.", "3 numbers in results/toy-all/metrics.csv; report: results/toy-all/report.html"]


def test_a_failure_is_exit_code_1_and_an_interruption_130(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    trap = tmp_path / "trap"
    once = ("run", "toy/mean", "--seeds", "2", "--workers", "1", "--set", f"trap={trap}", "--set", "figure=no", "--out", "x")
    trap.write_text("interrupt")
    assert call(capsys, *once) == (130, "", "fusion-sfdia: interrupted; repeat the same command to continue\n")
    trap.write_text("fail")
    code, _, err = call(capsys, *once)
    assert code == 1
    assert err.startswith("fusion-sfdia: failed: toy/mean, ")
    assert "detector b, quantity flow and level, seeds [0, 1]: ArithmeticError: " in err
    assert err.count("\n") == 1
    trap.unlink()
    assert call(capsys, *once)[0] == 0


def test_a_damaged_part_is_a_note(capsys: pytest.CaptureFixture[str]) -> None:
    once = ("run", "toy/mean", "--seeds", "2", "--workers", "1", "--set", "figure=no", "--out", "x")
    call(capsys, *once)
    part = next(Path("x/parts").iterdir())
    part.write_bytes(part.read_bytes()[:-1])
    code, _, err = call(capsys, *once)
    assert (code, err) == (0, f"fusion-sfdia: note: {part} is damaged or cut and was computed again\n")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "toy/meen"), "unknown scenario 'toy/meen'; did you mean 'toy/mean'? known: toy/mean"),
        (("run", "nothing/*"), "unknown scenario 'nothing/*'; known: toy/mean"),
        (("run", "toy/mean", "--set", "size"), "--set size: expected KEY=VALUE"),
        (("run", "toy/mean", "--set", "sise=1"), "no setting 'sise'"),
        (
            ("run", "toy/mean", "--set", "size=1", "--set", "size=2"),
            "setting size is given twice, as '1' and '2'; give it once",
        ),
        (
            ("compare", "--plants", "two-tanks", "--set", "plants=gas-pipeline"),
            "setting plants is given twice, as 'two-tanks' and",
        ),
        (("compare", "--faults", "bias", "--faults", "drift"), "setting faults is given twice, as 'bias' and 'drift'"),
        (("run", "toy/mean", "--seeds", "0"), "0 seeds; expected at least 1"),
        (("run", "toy/mean", "--seeds", "9" * 30), "a number is too large"),
        (("run", "toy/mean", "--out", "file/deeper"), "file/deeper"),
        (("simulate", "--out", "file"), "file exists; name another file with --out, or replace it with --force"),
        (("simulate", "--out", "x.csv", "--plant", "gas-pipelin"), "did you mean 'gas-pipeline'?"),
        (("simulate", "--out", "x.csv", "--steps", "0"), "0 steps; expected at least 1"),
        (("simulate", "--out", "x.csv", "--seed", "-1"), "expected an integer of at least 0"),
        (("simulate", "--out", "x.csv", "--fault", "week-bias"), "did you mean 'weak-bias'?"),
        (("simulate", "--out", "x.csv", "--fault", "weak-bias:presure"), "unknown quantity 'presure'"),
        (("simulate", "--out", "x.csv", "--fault", "weak-bias:"), "'weak-bias:' has no quantity after its colon"),
        (("simulate", "--out", "x.csv", "--fault", "freeze"), "'freeze' is a kind, to be listed in a file (--faults)"),
        (("simulate", "--out", "x.csv", "--fault", "weak-bias", "--steps", "5"), "ask for at least 70"),
        (("simulate", "--out", "."), ". is a folder; name a file"),
        (("simulate", "--out", "file/x.csv"), "file/x.csv: Not a directory; name a place below folders"),
        (("simulate", "--out", "x.csv", "--faults", "absent.toml"), "absent.toml: No such file or directory; name an existing"),
        (("simulate", "--out", "x.csv", "--faults", "file"), "file"),
        (("simulate", "--out", "x.csv", "--faults", "."), ".: Is a directory; name a file"),
        (("diagnose", "--data", "absent.csv"), "absent.csv: No such file or directory"),
        (("diagnose", "--data", "file"), "no column 'time'"),
        (("diagnose", "--data", "file", "--out", "."), ". is already used: it holds 'file', the newest of 20"),
        (("diagnose", "--data", "file", "--out", "file"), "file is a file; name a folder with --out"),
        (("bench", "model", "--out", "."), "; name another folder with --out, or replace what is there with --force"),
        (("bench", "model", "--seconds", "nan"), "positive time"),
    ],
)
def test_an_error_is_one_line_a_problem(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    (tmp_path / "file").write_text("mine\n")
    code, out, err = call(capsys, *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("fusion-sfdia: ")
    first, *lines = err.splitlines()
    assert not lines or (first.endswith("problems") and all(line.startswith("  ") for line in lines))
    assert message in err
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(sys.platform == "win32", reason="the system has no locks of files")
@pytest.mark.parametrize(
    "arguments",
    [
        ("diagnose", "--data", "log.csv", "--plant", "two-tanks", "--out", "held"),
        ("monitor", "--healthy", "log.csv", "--data", "log.csv", "--out", "held"),
        ("inspect", "--plant", "two-tanks", "--out", "held", "--no-simulation"),
        ("run", "toy/mean", "--out", "held"),
        ("bench", "model", "--out", "held"),
        ("tune", "--plant", "two-tanks", "--healthy", "log.csv", "--out", "held.toml"),
        ("watch", "--plant", "two-tanks", "--state", "held.npz"),
    ],
)
def test_two_runs_into_one_place_are_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    (tmp_path / "log.csv").write_text("time,level\n0,1\n1,1\n")
    out = next(Path(a) for a in arguments if a.startswith("held"))
    with locked_file(out) if out.suffix else locked(out):
        before = sorted(tmp_path.rglob("*"))
        code, printed, err = call(capsys, *arguments)
        assert sorted(tmp_path.rglob("*")) == before
    assert (code, printed) == (2, "")
    assert f"{out} is in use: another run writes into it; wait until it has ended" in err


@pytest.mark.parametrize(
    "arguments", [(), ("paint",), ("run",), ("run", "toy/mean", "--seeds", "2", "--full"), ("list", "cats")]
)
def test_a_wrong_command_line_shows_its_use(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert "usage: fusion-sfdia" in capsys.readouterr().err


def test_the_help_of_compare_lists_faults_and_settings_of_the_protocol(capsys: pytest.CaptureFixture[str]) -> None:
    def text(value: object) -> str:
        if isinstance(value, tuple):
            return ",".join(map(text, value))
        return str(value).lower() if isinstance(value, bool) else f"{value:.4g}"

    named = ("plants", "detectors", "faults")
    assert runs.FAULTS == protocol.KINDS
    assert {key: text(value) for key, value in protocol.SETTINGS.items() if key not in named} == runs.SETTINGS
    with pytest.raises(SystemExit):
        main(["compare", "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    assert "replay, sign, published" in shown and "window=30, false_alarm=0.001" in shown


def test_the_help_of_a_healthy_stretch_states_seconds_and_time_stamps(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["diagnose", "--help"])
    shown = "".join(capsys.readouterr().out.split())
    assert "seconds,as0..3600,ortimestampsofthelog,as2026-03-01T06:00..2026" in shown


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"fusion-sfdia {__version__}\n"


def test_a_drawn_fault_is_stated_as_its_readings_show_it(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """In the sensor's unit, as share of the signal and over the noise."""
    logs = []
    for name, fault in (("healthy.csv", ()), ("faulty.csv", ("--fault", "weak-bias"))):
        code, out, _ = call(capsys, "simulate", "--plant", "two-tanks", "--steps", "75", "--out", name, *fault)
        assert code == 0
        logs.append(np.genfromtxt(tmp_path / name, delimiter=",", skip_header=1))
    expected = re.search(r": bias from .* s, magnitude (\S+) \S+ \((\S+) of the signal, \S+ \S+\), (\S+) sigma", out)
    assert expected is not None
    off = logs[1] - logs[0]
    assert float(expected[1]) == pytest.approx(off.flat[np.argmax(np.abs(off))], rel=1e-3)
    assert 0.2 <= abs(float(expected[2])) <= 0.4 < float(expected[3])


def test_simulate_then_diagnose(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The strong and the weak fault of Shaheen 2024 are hundreds of sigma: the bank isolates their sensors and no other."""
    faults = ("--fault", "strong-bias:mass flow", "--fault", "weak-bias:pressure")
    code, out, err = call(capsys, "simulate", "--steps", "120", "--seed", "3", *faults, "--out", "log.csv", "--json")
    drawn = json.loads(out)
    assert (code, err, len(drawn)) == (0, "", 2)
    assert drawn[0]["sensor"].startswith("m_") and drawn[1]["sensor"].startswith("p_")
    code, out, _ = call(capsys, "diagnose", "--force", "--data", "log.csv", "--detector", "loo-chi2", "--json")
    events = json.loads(out)["events"]
    assert code == 0
    assert {e["hypothesis"]: e["start"] for e in events} == {f["sensor"]: f["onset"] for f in drawn}
    code, out, _ = call(capsys, "diagnose", "--force", "--data", "log.csv", "--detector", "loo-chi2")
    assert out.startswith("120 readings by loo-chi2: 2 faulty sensors\n  ")
    assert re.search(
        r"\nmodel fits: NIS 0\.9\d* over 100 samples \(expected 1, suspect above 1\.3\); noise of a sensor \d\.\d times as "
        r"large as stated, or residuals off by .* would have been seen\n",
        out,
    )


def test_a_change_of_the_process_is_what_was_found(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """It is no model that is suspect; how to tune the model, if that is what is wrong, is last."""
    detector = f"{HELPERS / 'process_bank.py'}:ProcessBank"
    assert call(capsys, "simulate", "--plant", "two-tanks", "--steps", "20", "--out", "log.csv")[0] == 0
    chosen = ("diagnose", "--force", "--plant", "two-tanks", "--data", "log.csv", "--detector", detector)
    code, out, _ = call(capsys, *chosen)
    assert code == 0 and out.splitlines()[:3] == [
        f"20 readings by {detector}: 1 process change",
        "  Outlet has been 5.0 % (3.4 to 6.6) below its value in the model since 15 s; no single sensor fault explains this. "
        "Check this part of the plant.",
        "If the plant was in order at that time, the model is wrong: tune it to a log without a fault.",
    ]
    assert "model suspect" not in out
    expected = f"`fusion-sfdia tune --plant two-tanks --detector {detector} --healthy HEALTHY.csv`"
    assert "the model was not tuned to the real plant" in out.splitlines()[-1] and expected in out.splitlines()[-1]
    code, out, _ = call(capsys, *chosen, "--json")
    (event,) = json.loads(out)["events"]
    assert (event["kind"], event["hypothesis"], event["start"], event["open"]) == ("process", "outlet", 15.0, True)


def test_the_exit_code_states_what_was_found_where_that_is_asked_for(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    bank = f"{HELPERS / 'process_bank.py'}:ProcessBank"
    for name, fault in (("healthy.csv", ()), ("faulty.csv", ("--fault", "strong-bias:level"))):
        assert call(capsys, "simulate", "--plant", "two-tanks", "--steps", "120", "--out", name, *fault)[0] == 0
    cases = {("healthy.csv", "loo-chi2"): (0, 0, 0), ("faulty.csv", "loo-chi2"): (3, 3, 3), ("healthy.csv", bank): (0, 3, 3)}
    for (log, detector), codes in cases.items():
        for on, code in zip(("fault", "process", "suspect"), codes, strict=True):
            given = ("--data", log, "--detector", detector, "--plant", "two-tanks", "--force", "--quiet")
            assert call(capsys, "diagnose", *given, "--fail-on", on) == (code, "", ""), (log, detector, on)
    code, out, err = call(capsys, "diagnose", *given, "--json")
    assert (code, err) == (0, "") and json.loads(out)["state"] == "process"
    given = ("--quiet", "--plant", "two-tanks", "--detector", "loo-chi2", "--fail-on", "fault")
    code, out, err = call(capsys, "diagnose", *given, "--data", "faulty.csv")
    assert (code, out) == (2, "") and re.search(
        r"faulty is already used: it holds 'diagnosis.png', .* the newest of 20\d\d-.*; name another folder with",
        err,
    )


def test_force_leaves_no_file_of_the_diagnosis_before(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert call(capsys, "simulate", "--plant", "two-tanks", "--steps", "20", "--out", "log.csv")[0] == 0
    (tmp_path / "out").mkdir()
    for name in ("monitor.txt", "notes.txt", "events.csv"):
        (tmp_path / "out" / name).write_text("before")
    given = ("--plant", "two-tanks", "--detector", "loo-chi2", "--data", "log.csv", "--out", "out", "--force")
    assert call(capsys, "diagnose", *given)[0] == 0
    assert {p.name for p in (tmp_path / "out").iterdir()} == {*FILES, "notes.txt"}
    assert (tmp_path / "out" / "events.csv").read_text() != "before"
    code, out, _ = call(capsys, "diagnose", *given, "--tables", "parquet")
    assert code == 0 and "reconstructed.parquet, scores.parquet" in out
    as_parquet = {name.replace(".csv", ".parquet") if name != "events.csv" else name for name in FILES}
    assert {p.name for p in (tmp_path / "out").iterdir()} == {*as_parquet, "notes.txt"}


def test_simulate_with_a_fault_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "faults.toml").write_text('[[fault]]\nsensor = "p_3"\nkind = "bias"\nonset = 50.0\nmagnitude = 2e5\n')
    for name, more in (("healthy.csv", ()), ("faulty.csv", ("--faults", "faults.toml"))):
        code, out, _ = call(capsys, "simulate", "--steps", "10", "--out", name, *more)
        assert code == 0
    sigma = PLANT.sensors[PLANT.sensor_index("p_3")].noise_sigma
    assert out.splitlines()[1] == f"  p_3: bias from 50 s for inf s, magnitude 2e+05 Pa, {2e5 / sigma:.3g} sigma"
    healthy, faulty = (np.genfromtxt(tmp_path / n, delimiter=",", skip_header=1) for n in ("healthy.csv", "faulty.csv"))
    column = 1 + PLANT.sensor_index("p_3")
    assert np.allclose((faulty - healthy)[:, column], np.where(healthy[:, 0] >= 50, 2e5, 0), rtol=0, atol=1e-8)
    assert np.array_equal(np.delete(faulty, column, 1), np.delete(healthy, column, 1))


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_the_error_of_a_kind_holds_a_file_that_works(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = registry.plant("two-tanks")
    code, _, err = call(capsys, "simulate", "--plant", "two-tanks", "--fault", f"{kind}:q2", "--out", "log.csv")
    assert code == 2 and f"fault '{kind}:q2' is a kind" in err
    (tmp_path / "fault.toml").write_text(re.search(r"fault = \[.*\]", err)[0])  # type: ignore[index]
    (fault,) = load_faults(tmp_path / "fault.toml", plant)
    assert (fault.sensor, fault.kind, fault.onset) == ("q2", kind, 60 * plant.dt)


def test_a_share_of_an_absolute_temperature_is_printed_as_one() -> None:
    tanks = registry.plant("two-tanks")
    thermometer = replace(tanks.sensors[0], name="T", unit="K", sigma=0.1)
    plant = replace(tanks, sensors=(thermometer, *tanks.sensors[1:]))
    text = _size(Fault("T", "bias", onset=5.0, magnitude=-0.2, relative=True), -78.6, plant)
    assert text == ", magnitude -78.6 K (-0.2 of the signal, 393 K above absolute zero), 786 sigma"


def altered(change: Callable[[list[list[str]]], object]) -> None:
    """A log of a dozen readings with some of its cells changed: rows of cells, the header first, the time in front."""
    if not Path("log.csv").exists():
        assert main(["simulate", "--steps", "12", "--out", "log.csv"]) == 0
    rows = [line.split(",") for line in Path("log.csv").read_text(encoding="utf-8").splitlines()]
    change(rows)
    Path("other.csv").write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8")


def filled(column: int, text: str, count: int = 1) -> Callable[[list[list[str]]], None]:
    def change(rows: list[list[str]]) -> None:
        for row in rows[1:]:
            row[column : column + count] = [text] * count

    return change


INLET = 1 + len(PLANT.sensors)  # the column of p_inlet


@pytest.mark.parametrize(
    ("change", "exits", "reported"),
    [
        (filled(1, "", len(PLANT.sensors)), 1, "warning: no readings of p_0, p_1, .* and 55 more: the diagnosis is only"),
        (filled(1, ""), 0, "warning: no readings of p_0; fill"),
        (lambda rows: rows.pop(6), 0, ""),  # a gap is stepped through
        (
            filled(INLET, "2e6"),
            0,
            r"warning: the estimate left the limits of the model and was moved back in \d+ of 12 samples",
        ),
        (filled(INLET, "2e9"), 2, r"other.csv, row 2, column p_inlet: 2e\+09 Pa \(and in 11 other rows\); plant"),
        (lambda rows: rows[5].__setitem__(0, "1e9"), 2, "other.csv, row 7, column time: 60.0 s after 1000000000.0 s"),
        (
            lambda rows: rows[-1].__setitem__(0, "1e9"),
            0,
            r"warning: no row for 1e\+09 s before 1000000000 s, 1e\+08 steps of the ",
        ),
    ],
    ids=["silent", "sensor", "gap", "guarded", "inlet", "order", "years"],
)
@pytest.mark.usefixtures("undrawn")
def test_what_a_diagnosis_cannot_judge_is_reported(
    capsys: pytest.CaptureFixture[str], change: Callable[[list[list[str]]], object], exits: int, reported: str
) -> None:
    altered(change)
    capsys.readouterr()
    code, out, err = call(capsys, "diagnose", "--data", "other.csv", "--detector", "loo-chi2")
    assert code == exits
    assert re.match(f"fusion-sfdia: {reported}", err, flags=re.DOTALL) if reported else err == ""
    assert all(line.startswith(("fusion-sfdia: ", "  ")) for line in err.splitlines())
    assert ("by loo-chi2" in out) == (exits != 2) == Path("diagnosis/other/events.csv").exists()


def test_a_model_without_numbers_fails_the_diagnosis(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    altered(len)
    capsys.readouterr()

    def without_numbers(x: Any, u: Any, theta: Any, columns: Any, *_: Any) -> tuple[Any, Any]:
        return np.full_like(x, np.nan), np.full((*x.shape, columns.size), np.nan)

    monkeypatch.setattr("fusion_sfdia.models.gas_pipeline.equations.advance_tangent", without_numbers)
    monkeypatch.setattr("fusion_sfdia.models.gas_pipeline.equations.advance", lambda x, *_: np.full_like(x, np.nan))
    code, _, err = call(capsys, "diagnose", "--data", "other.csv", "--detector", "loo-chi2")
    assert code == 1 and re.search(r"diverged and is not valid in \d+ of 12 samples, first at", err)


def test_a_full_disk_leaves_no_half_diagnosis(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, *_: object, **__: object) -> NoReturn:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    altered(len)
    capsys.readouterr()
    monkeypatch.setattr("fusion_sfdia.report.sample_tables.write_lines", full)
    code, out, err = call(capsys, "diagnose", "--data", "other.csv", "--detector", "loo-chi2")
    assert (code, out) == (1, "")
    assert err == "fusion-sfdia: diagnosis/other/reconstructed.csv: No space left on device; make room, or name another place\n"
    assert not Path("diagnosis").exists()
    assert not list(Path().glob(".*"))  # nor anything that was in the making


def test_a_forced_diagnosis_that_fails_leaves_the_one_before(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    altered(len)
    once = ("diagnose", "--data", "other.csv", "--detector", "loo-chi2", "--out", "found", "--force")
    assert call(capsys, *once)[0] == 0
    Path("found/mine.txt").write_text("mine")
    before = {p.name: p.read_bytes() for p in Path("found").iterdir()}

    def failing(*_: object) -> NoReturn:
        raise RuntimeError("the figure failed")

    with monkeypatch.context() as patch:
        patch.setattr("fusion_sfdia.report.log_report.write_figure", failing)
        assert call(capsys, *once)[0] == 1
    assert {p.name: p.read_bytes() for p in Path("found").iterdir()} == before
    assert call(capsys, *once)[0] == 0
    assert {p.name for p in Path("found").iterdir()} == before.keys()


def test_simulate_writes_through_a_pipe_and_keeps_the_mode_of_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    once = ("simulate", "--plant", "two-tanks", "--steps", "3")
    assert call(capsys, *once, "--out", "log.csv")[0] == 0
    Path("log.csv").chmod(0o600)
    assert call(capsys, *once, "--out", "log.csv", "--force")[0] == 0
    assert Path("log.csv").stat().st_mode & 0o777 == 0o600
    if hasattr(os, "mkfifo"):
        os.mkfifo("pipe")
        reader = os.open("pipe", os.O_RDONLY | os.O_NONBLOCK)
        assert call(capsys, *once, "--out", "pipe")[0] == 0
        assert os.read(reader, 10_000) == Path("log.csv").read_bytes() and Path("pipe").is_fifo()
        os.close(reader)
    if Path("/dev/full").exists():
        code, _, err = call(capsys, *once, "--out", "/dev/full", "--force")
        assert (code, Path("/dev/full").is_char_device()) == (1, True) and "/dev/full: No space left" in err


def run_alone(root: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    code = "import sys; from fusion_sfdia.cli.main import main; sys.exit(main(sys.argv[1:]))"
    known = {**os.environ, "PYTHONPATH": str(root), **environment}
    return subprocess.run([sys.executable, "-c", code, *arguments], env=known, capture_output=True, check=False)


@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="needs /dev/stdout")
def test_a_log_on_standard_output_is_all_that_stands_there(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    once = ("simulate", "--plant", "two-tanks", "--steps", "3")
    assert call(capsys, *once, "--out", "log.csv")[0] == 0
    done = run_alone(root, *once, "--out", "/dev/stdout", "--force")
    assert (done.returncode, done.stdout) == (0, Path("log.csv").read_bytes())
    assert b"3 readings of 4 sensors in /dev/stdout" in done.stderr


@pytest.mark.parametrize("encoding", ["ascii", "utf-8"])
def test_a_terminal_without_the_letters_gets_others(root: Path, encoding: str) -> None:
    done = run_alone(root, "simulate", "--plant", "two-tanks", "--steps", "3", "--out", "π.csv", PYTHONIOENCODING=encoding)
    assert done.returncode == 0 and done.stderr == b""
    shown = "in π.csv, 0 faults" if encoding == "utf-8" else r"in \u03c0.csv, 0 faults"
    assert shown.encode() in done.stdout and Path("π.csv").exists()


def test_a_thread_may_call_it(tmp_path: Path) -> None:
    codes: list[int] = []

    def work() -> None:
        codes.append(main(["simulate", "--plant", "two-tanks", "--steps", "3", "--out", "log.csv"]))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert codes == [0]


@pytest.mark.parametrize("text", ["1_0", "１２", "9" * 5000])
def test_an_option_takes_plain_numbers(capsys: pytest.CaptureFixture[str], text: str) -> None:
    with pytest.raises(SystemExit):
        main(["simulate", "--out", "x.csv", "--steps", text])
    assert "argument --steps: invalid integer value" in capsys.readouterr().err


def test_inputs_that_a_log_lacks_are_assumed_only_when_asked_for(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{5 * k},1.0,1.0,6e-4,6e-4\n" for k in range(1, 9))
    Path("log.csv").write_text("time,l1,l2,q12,q2\n" + rows, encoding="utf-8")
    command = ("diagnose", "--plant", "two-tanks", "--detector", "kf-chi2", "--data", "log.csv")
    code, out, err = call(capsys, *command)
    assert (code, out) == (2, "") and "no column for the inputs 'inflow'" in err and "--nominal-inputs" in err
    code, out, err = call(capsys, *command, "--nominal-inputs")
    assert code == 0 and "8 readings" in out
    assert err.startswith("fusion-sfdia: warning: log.csv: no column for the inputs 'inflow'; the nominal values")


def test_commands_use_one_thread_of_linear_algebra() -> None:
    program = (
        "import os, sys; os.environ.pop('OMP_NUM_THREADS', None); os.environ.pop('OPENBLAS_NUM_THREADS', None)\n"
        "sys.argv = ['fusion-sfdia', 'list', 'plants']\n"
        "from fusion_sfdia.cli.main import main\n"
        "main()\n"
        "import numpy, threadpoolctl\n"
        "print([pool['num_threads'] for pool in threadpoolctl.threadpool_info()])"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert set(json.loads(found.stdout.splitlines()[-1])) == {1}


def test_an_option_that_is_given_twice_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["check-log", "--plant", "two-tanks", "--data", "monday.csv", "--data", "tuesday.csv"])
    assert ended.value.code == 2
    assert "argument --data: it is given twice; expected once" in capsys.readouterr().err


def test_options_of_names_may_be_given_several_times() -> None:
    commands = argparse.ArgumentParser().add_subparsers()
    add_monitor(commands)
    parsed = commands.choices["monitor"].parse_args(
        ["--healthy", "a.csv", "--data", "b.csv", "--inputs", "load, valve", "--inputs", "speed"]
    )
    assert parsed.inputs == ["load", "valve", "speed"] and parsed.ignore == []
