"""From healthy logs to a diagnosis without a model: steps, frozen, dead and still sensors are named, and what explains what."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_logs import DT, LOAD, SENSORS, of_factor

from fusion_sfdia.cli.main import main
from fusion_sfdia.core.log import Log
from fusion_sfdia.core.signals import Signal
from fusion_sfdia.evaluation.diagnose import DiagnosisWarning
from fusion_sfdia.identification.choice import Candidate
from fusion_sfdia.logs.log_map import Column, LogMap
from fusion_sfdia.monitoring.channels import Channel
from fusion_sfdia.monitoring.logs import load, signals_of
from fusion_sfdia.monitoring.monitor import Monitor, learn_monitor, on_grid

MORE = (*SENSORS, Signal("alone", "1"), Signal("still", "bar"))
VALUE = 3.0  # of the sensor that never moves
STEPS, STEP_AT, STEP, FROZEN_AT = 200, 80, 6.0, 140


def wide(seed: int, steps: int = STEPS) -> Log:
    """The four sensors of `of_factor`, one that has nothing to do with them, and one that never moves."""
    t, y, u = of_factor(seed, steps)
    alone = np.random.default_rng(1000 + seed).standard_normal((steps, 1))
    return Log(t, np.hstack([y, alone, np.full((steps, 1), VALUE)]), u)


@pytest.fixture(scope="module")
def monitor() -> Monitor:
    return learn_monitor(
        MORE, [wide(seed) for seed in range(4)], inputs=[LOAD], false_alarm=0.02, candidates=[Candidate("factors", 1)],
        beside=("predictors", "limits"),
    )  # fmt: skip


def faulty() -> Log:
    t, y, u = wide(21)
    y[STEP_AT : STEP_AT + 40, 1] += STEP
    y[FROZEN_AT:, 3] = y[FROZEN_AT, 3]
    y[150:, 5] = VALUE + 0.5
    return Log(t, y, u)


def test_a_step_is_named_with_its_size_and_a_healthy_log_is_not_accused(monitor: Monitor) -> None:
    found = monitor.diagnose(faulty())
    step = next(e for e in found.diagnosis.events if e.hypothesis == "b")
    assert step.start == DT * STEP_AT and step.size == pytest.approx(STEP, abs=1.5)
    assert np.mean(monitor.diagnose(wide(22)).diagnosis.decisions.alarm) <= 3 * 0.02
    assert set(found.beside) == {"predictors", "limits"}


def test_frozen_dead_and_still_sensors_are_reported(monitor: Monitor) -> None:
    found = monitor.diagnose(faulty())
    assert [(e.hypothesis, e.start, e.open) for e in found.frozen] == [("d", DT * FROZEN_AT, True)]
    assert [(e.hypothesis, e.start, e.size) for e in found.moved] == [("still", 300.0, 0.5)]
    text = str(found)
    once = [line for line in text.splitlines() if line.startswith("  d")]  # the bank isolates it, too
    assert len(once) == 1 and once[0].startswith("  d: 280 s to end of the log, freeze")
    assert f"  without a fault some {monitor.methods['bank'].rate * len(found.log.t):.2g} of these" in text
    assert "still moved since 300 s, by 0.5 bar; never when healthy" in text
    healthy = monitor.diagnose(wide(22))
    assert not (healthy.frozen or healthy.moved or healthy.missing)


def test_a_sensor_without_readings_is_reported(monitor: Monitor) -> None:
    log = wide(22)
    log.y[:, 4] = np.nan
    with pytest.warns(DiagnosisWarning, match="no readings of alone"):
        found = monitor.diagnose(log)
    assert found.missing == ("alone",) and "alone has no reading: dead or not recorded" in str(found)


def test_every_event_is_a_row_of_the_table(monitor: Monitor) -> None:
    found = monitor.diagnose(faulty())
    header, rows = found.table()
    methods = [row[0] for row in rows]
    assert header[:2] == ("method", "sensor") and methods.count("bank") == len(found.diagnosis.events)
    assert ("frozen", "d") in [row[:2] for row in rows] and ("moved", "still") in [row[:2] for row in rows]


def test_what_no_other_channel_explains_is_reported(monitor: Monitor) -> None:
    assert monitor.unexplained == ("alone",)
    channels = {c.name: c for c in monitor.channels}
    assert "alone: no other channel explains it" in str(monitor) and channels["alone"].shared < 0.2
    assert all(channels[name].explained > 0.8 for name in ("a", "b", "d"))
    assert "still: never moved when healthy, always 3" in str(monitor)
    assert "bank: " in str(monitor) and "held-out healthy samples in alarm" in str(monitor)


def test_redundant_sensors_are_found() -> None:
    assert "redundant with b" in str(Channel("a", 0.99, "b", 0.98, 1))
    assert "redundant" not in str(Channel("a", 0.99, "b", 0.8, 1))


def test_a_sensor_that_repeats_its_readings_when_healthy_is_not_frozen() -> None:
    """An analyser with a reading every fifth sample."""

    def repeated(seed: int, steps: int = STEPS) -> Log:
        t, y, u = of_factor(seed, steps)
        y[:, 2] = np.repeat(y[::5, 2], 5)
        return Log(t, y, u)

    logs = [repeated(seed) for seed in range(3)]
    found = learn_monitor(SENSORS, logs, inputs=[LOAD], false_alarm=0.05, candidates=[Candidate("factors", 1)], beside=())
    assert [c.repeats for c in found.channels] == [1, 1, 5, 1]
    assert not found.diagnose(repeated(9)).frozen


def test_times_are_moved_to_equal_steps_and_inputs_held() -> None:
    u = np.array([[np.nan], [5.0], [np.nan], [7.0], [8.0]])
    found = on_grid(Log(np.array([10.0, 12.1, 13.9, 18.0, 18.6]), np.arange(5.0)[:, None], u), 2.0, [1.0])
    assert found.t == pytest.approx([10.0, 12.0, 14.0, 18.0])
    assert found.y[:, 0].tolist() == [0.0, 1.0, 2.0, 4.0] and found.u[:, 0].tolist() == [1.0, 5.0, 5.0, 8.0]


def test_a_log_with_a_gap_is_diagnosed_to_its_end(monitor: Monitor) -> None:
    t, y, u = wide(22)
    y[150:, 1] += STEP
    keep = np.r_[0:60, 100:STEPS]
    found = monitor.diagnose(Log(t[keep], y[keep], u[keep]))
    assert np.isfinite(found.diagnosis.decisions.estimate).all()
    assert "b" in [e.hypothesis for e in found.diagnosis.events]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"beside": ("magic",)}, "beside has 'magic'; known: predictors"),
        ({"false_alarm": 1e-5}, "record more"),
        ({"false_alarm": "1/day"}, f"that one in {86400 / DT:.0f} exceeds; record more"),
        ({"false_alarm": 0.0}, "expected a positive number, such as 1/day"),
        ({"false_alarm": "1/moon"}, "such as 1/day"),
        ({"sensors": SENSORS}, "do not fit 4 sensors"),
    ],
)
def test_what_cannot_be_learnt_is_refused(changes: dict[str, Any], message: str) -> None:
    given = {"sensors": MORE, "healthy": [wide(seed) for seed in range(2)], "inputs": [LOAD], "beside": ()}
    with pytest.raises(ValueError, match=message):
        learn_monitor(**{"candidates": [Candidate("factors", 1)], **given, **changes})


def test_a_method_that_cannot_be_fitted_is_reported_and_the_others_stand() -> None:
    logs = [wide(seed, 25) for seed in range(4)]
    found = learn_monitor(MORE, logs, inputs=[LOAD], false_alarm=0.2, candidates=[Candidate("factors", 1)])
    assert "predictors" in found.failed and "bank" in found.methods and "predictors: left out" in str(found)


def written(path: Path, log: Log) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["time", *(f"{s.name} [{s.unit}]" for s in MORE), "load [kW]", "remark"])
        table.writerows([t, *["" if np.isnan(v) else v for v in y], *u, 1] for t, y, u in zip(*log, strict=True))
    return path


def test_columns_are_sensors_unless_they_are_named(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", faulty())
    sensors, inputs = signals_of(path, ["load"], ["remark"])
    assert tuple(sensors) == MORE and inputs == [LOAD]
    found = load(path, sensors, inputs).log
    assert np.array_equal(found.y, faulty().y, equal_nan=True) and np.array_equal(found.u, faulty().u)
    with pytest.raises(ValueError, match="no column 'lod'; known: 'a'"):
        signals_of(path, ["lod"], [])
    with pytest.raises(ValueError, match="no column is left"):
        signals_of(path, [], [*(s.name for s in MORE), "load", "remark"])


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


@pytest.mark.slow
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    healthy = [written(tmp_path / f"h{seed}.csv", wide(seed, 120)) for seed in range(2)]
    data, out = written(tmp_path / "data.csv", faulty()), tmp_path / "out"
    common = [
        "monitor", *(a for path in healthy for a in ("--healthy", str(path))), "--data", str(data), "--inputs", "load",
        "--ignore", "remark", "--false-alarm", "0.05", "--out", str(out),
    ]  # fmt: skip
    assert main([*common, "--json"]) == 0
    shown = capsys.readouterr()
    events = json.loads(shown.out)
    assert {"method": "moved", "sensor": "still"}.items() <= next(e for e in events if e["method"] == "moved").items()
    assert any(e["method"] == "frozen" and e["sensor"] == "d" for e in events)
    assert "chosen of" in shown.err and "alone: no other channel explains it" in shown.err
    assert {"monitor.txt", "methods.csv", "report.html", "events.csv", "reconstructed.csv"} <= {p.name for p in out.iterdir()}
    assert len((out / "methods.csv").read_text(encoding="utf-8").splitlines()) == 1 + len(events)
    assert main(common) == 2 and "already used" in capsys.readouterr().err


def test_the_command_refuses_an_input_that_no_log_has(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(written(tmp_path / "log.csv", wide(1, 20)))
    assert main(["monitor", "--healthy", path, "--data", path, "--inputs", "lod", "--out", str(tmp_path / "out")]) == 2
    assert "no column 'lod'" in capsys.readouterr().err and not (tmp_path / "out").exists()
