"""A monitor over rows as they come decides as on the whole log, from a saved state too, and at the command line."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_learning_monitor import DT, LOAD, SENSORS, STEP, made

from fusion_sfdia.cli.main import main
from fusion_sfdia.detectors.detector import Decision, stack
from fusion_sfdia.detectors.verdicts import Verdict
from fusion_sfdia.diagnosis.events import events_of
from fusion_sfdia.diagnosis.sentences import Wording
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.learning.monitor.channels import Read, read
from fusion_sfdia.learning.monitor.held_out import JOINED
from fusion_sfdia.learning.monitor.monitor import Monitor
from fusion_sfdia.logs.csv_log import write_log
from fusion_sfdia.plant.log import Log

ROWS = 320


def faulty(seed: int) -> Log:
    """A bias, a freeze, and a sensor that never moved and does."""
    t, y, u = made(seed, ROWS)
    y[60:140, 2] += STEP
    y[180:230, 0] = y[180, 0]
    y[250:260, 7] = 4.5
    return Log(t, y, u)


def gappy(seed: int) -> Log:
    """Skipped rows, a gap of 100 steps, inputs that miss readings, and two rows at some steps."""
    t, y, u = made(seed, ROWS)
    y[200:, 3] += STEP
    u[::7] = np.nan
    rng = np.random.default_rng(seed)
    k = np.flatnonzero((rng.random(ROWS) > 0.2) & ((np.arange(ROWS) < 90) | (np.arange(ROWS) >= 190)))
    k = np.sort(np.concatenate([k, k[::9]]))
    jitter = np.where(np.append(False, np.diff(k) == 0), 3.0, 0.0)
    return Log(t[k] + jitter, y[k] + 0.01 * jitter[:, None], u[k])


LOGS = {"faults": faulty(21), "process": made(24, ROWS, process=slice(150, 250)), "gaps": gappy(37)}


@pytest.fixture(scope="module")
def monitor() -> Monitor:
    return Monitor.of_logs(SENSORS, [made(1), made(2)], inputs=[LOAD])


@pytest.fixture(scope="module")
def of_runs() -> Monitor:
    return Monitor.of_logs(SENSORS, [made(seed, 200) for seed in range(5)], inputs=[LOAD])


def live(monitor: Monitor, log: Log) -> Decision:
    """The Decisions on the rows, each after all before it."""
    detector = monitor.stream().detector
    state, found = detector.init(), []
    for t, y, u in zip(*log, strict=True):
        state, decision = detector.step(state, float(t), y, u)
        found.append(decision)
    return stack(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*LOGS, "runs"])
def test_row_by_row_it_decides_as_on_the_whole_log(monitor: Monitor, of_runs: Monitor, name: str) -> None:
    of, log = (of_runs, faulty(41)) if name == "runs" else (monitor, LOGS[name])
    whole, on_grid = of.diagnose(log).decisions, of.diagnose(log).log.t
    found = live(of, log)
    step = np.rint((log.t - log.t[0]) / DT)
    last = np.append(np.diff(step) > 0, True)  # of several rows at one step the last has them all
    at = np.searchsorted(np.rint((on_grid - log.t[0]) / DT), step[last])
    for what in ("isolated", "process", "suspect"):
        assert np.array_equal(getattr(found, what)[last], getattr(whole, what)[at]), what
    for what in ("residual", "fault_size", "reconstruction"):
        # the same sums in products of other shapes: errors of some n^2 roundings of readings below 100
        np.testing.assert_allclose(getattr(found, what)[last], getattr(whole, what)[at], rtol=1e-5, atol=1e-10, err_msg=what)
    assert np.any(whole.isolated) or np.any(whole.process)


@pytest.mark.slow
def test_a_stream_that_goes_on_from_its_state_writes_what_one_without_a_stop_writes(monitor: Monitor, tmp_path: Path) -> None:
    rows = list(zip(*LOGS["faults"], strict=True))
    whole = monitor.stream()
    expected = [c for row in rows for s in whole.update(*row) for c in s.changes]
    first = monitor.stream()
    found = [c for row in rows[:130] for s in first.update(*row) for c in s.changes]
    first.save(tmp_path / "state")
    again = monitor.stream(tmp_path / "state")
    assert isinstance(again, Watch) and again.t == rows[129][0]
    found += [c for row in rows[130:] for s in again.update(*row) for c in s.changes]
    assert repr(found) == repr(expected)
    opened = {c.event.hypothesis: c for c in found if c.what == "opened" and c.event}
    assert "Sensor s0 has been stuck at one value since" in opened["s0"].sentence({}, whole.clock)
    moved = opened["still (never moved when healthy)"].sentence({"still": Wording("sensor", "still")}, whole.clock)
    assert "Sensor still has moved by 0.5 K since 2500 s, which it never did in the healthy logs" in moved
    (named,) = [c for c in found if c.what == "named" and c.event and c.event.hypothesis == "s2"]
    assert named.id == opened["s2"].id and named.t - opened["s2"].t == (JOINED - 1) * DT and named.event is not None
    assert named.event.size == pytest.approx(STEP, abs=1.0)
    other = Monitor.of_logs(SENSORS, [made(1), made(3)], inputs=[LOAD])
    with pytest.raises(ValueError, match="saved by another detector"):
        other.stream(tmp_path / "state")


def test_a_fault_of_the_process_is_live_what_it_is_in_a_log(monitor: Monitor) -> None:
    """Without a model no sentence speaks of one."""
    log = made(22, 40)
    d = monitor.diagnose(log).decisions
    assert d.process is not None
    d.process[10:30, 0] = d.process[10:30, 2] = True
    process, recorder = [e for e in events_of(monitor.stream().detector, log.t, d, JOINED) if e.kind in ("process", "outside")]
    assert process.statement("now", {}).startswith("Readings moved together now as never in the healthy logs; no sensor alone")
    assert recorder.statement("now", {}).startswith("Several sensors repeated or missed their readings now")


def test_missing_readings_and_inputs_and_repeats_are_judged_as_they_are(monitor: Monitor) -> None:
    watch = monitor.stream()
    t, y, _ = made(22, 40)
    for k in range(40):
        watch.update(float(t[k]), np.where(np.arange(8) == 1, np.nan, y[k]), np.full(1, np.nan))
    (sample,) = watch.update(400.0, np.full(8, np.nan), np.full(1, np.nan))
    assert sample.decision.isolated.tolist() == [i == 1 for i in range(8)] and sample.verdict is Verdict.SENSOR
    anew = monitor.stream()
    assert anew.update(0.0, np.full(8, np.nan), np.full(1, np.nan)) == ()  # the first row waits for the next one
    assert {s.verdict for s in anew.update(10.0, np.full(8, np.nan), np.full(1, np.nan))} == {Verdict.BLIND}
    with pytest.raises(ValueError, match=r"expected \(8,\) and \(1,\)"):
        watch.detector.step(watch.detector.init(), 0.0, y[0], np.empty(0))
    state, _ = watch.detector.step(watch.detector.init(), 100.0, y[0], np.zeros(1))
    state, _ = watch.detector.step(state, 120.0, y[1], np.zeros(1))
    with pytest.raises(ValueError, match="t is 105 s, before the last row, at 120 s"):
        watch.detector.step(state, 105.0, y[2], np.zeros(1))
    with pytest.raises(ValueError, match="follows one run"):
        watch.detector.init((2,))


def test_what_is_read_continues_over_parts() -> None:
    v = np.array([[1.0, np.nan], [1.0, 5.0], [np.nan, 5.0], [1.0, np.nan], [2.0, np.nan], [2.0, 5.0]])
    whole = read(v)
    assert whole.equal[:, 0].tolist() == [1, 2, 2, 3, 1, 2] and whole.age[:, 1].tolist() == [1, 0, 0, 1, 2, 0]
    for k in range(1, 6):
        part = read(v[k:], Read(*(a[-1] for a in read(v[:k]))))
        for one, other in zip(part, whole, strict=True):
            assert np.array_equal(one, other[k:], equal_nan=True)


@pytest.fixture
def kept(monitor: Monitor, tmp_path: Path) -> str:
    monitor.save(tmp_path / "plant.sfdia")
    return str(tmp_path / "plant.sfdia")


@pytest.mark.slow
def test_watch_and_diagnose_take_a_kept_monitor(
    monitor: Monitor, kept: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "data.csv"
    write_log(data, monitor.plant, *LOGS["faults"])
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(data.read_bytes())))
    assert main(["watch", "--monitor", kept, "--samples"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    isolated = [line["isolated"] for line in lines if line["event"] == "sample"]
    names, decisions = monitor.plant.sensor_names, monitor.diagnose(LOGS["faults"]).decisions
    assert isolated == [[names[i] for i in np.flatnonzero(row)] for row in decisions.isolated]
    assert main(["diagnose", "--monitor", kept, "--data", str(data), "--out", str(tmp_path / "out"), "--json"]) == 0
    events = {(e["kind"], e["hypothesis"]) for e in json.loads(capsys.readouterr().out)["events"]}
    assert {("sensor", "s2"), ("sensor", "s0"), ("outside", "still")} <= events


def misspelt(data: Path, lines: list[str], name: str) -> Path:
    """A log beside another one with a typing error in a title."""
    path = data.with_name("misspelt.csv")
    path.write_text("\n".join([lines[0].replace(name, f"s{name}"), *lines[1:]]) + "\n")
    return path


@pytest.mark.slow
def test_a_log_without_a_column_is_refused_or_its_sensor_is_missing(
    monitor: Monitor, kept: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_log(tmp_path / "whole.csv", monitor.plant, *made(22, 120))
    lines = (tmp_path / "whole.csv").read_text().splitlines()
    data = tmp_path / "data.csv"
    data.write_text("\n".join(",".join(line.split(",")[:2] + line.split(",")[3:]) for line in lines) + "\n")  # without s1
    diagnose = ["diagnose", "--monitor", kept, "--data", str(data), "--out", str(tmp_path / "out"), "--json"]
    assert main(diagnose) == 2 and "no column for the sensors 's1'" in capsys.readouterr().err
    assert main([*diagnose, "--absent-sensors"]) == 0  # which is no finding then
    assert not [e["hypothesis"] for e in json.loads(capsys.readouterr().out)["events"] if e["fault"] == "dropout"]
    assert main([*diagnose[:4], str(misspelt(data, lines, "s1")), *diagnose[5:], "--force"]) == 2
    assert "did you mean 'ss1' for 's1'?" in capsys.readouterr().err
    for options, code in (([], 2), (["--absent-sensors"], 0)):
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(data.read_bytes())))
        assert main(["watch", "--monitor", kept, *options]) == code
    opened = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert "s1" in {e["hypothesis"] for e in opened if e["event"] == "opened"}


@pytest.mark.parametrize("command", ["watch", "diagnose"])
def test_a_plant_or_a_detector_beside_a_monitor_is_refused(
    kept: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = ["--data", str(tmp_path / "data.csv")] if command == "diagnose" else []
    assert main([command, "--monitor", kept, *data, "--plant", "two-tanks", "--detector", "loo-chi2"]) == 2
    assert "--detector, --plant and --monitor: a monitor has no model" in capsys.readouterr().err


def test_a_log_with_longer_steps_is_refused(monitor: Monitor) -> None:
    t, y, u = made(29)
    with pytest.raises(ValueError, match="a row every 30 s, and the monitor has learnt rows 10 s apart"):
        monitor.diagnose(Log(t[::3], y[::3], u[::3]))


def test_files_and_frames_are_learnt_and_diagnosed(monitor: Monitor, tmp_path: Path) -> None:
    for seed in (1, 2):
        write_log(tmp_path / f"{seed}.csv", monitor.plant, *made(seed))
    found = Monitor.fit([tmp_path / "1.csv", str(tmp_path / "2.csv")], inputs=["load"], false_alarm="1/day")
    assert found.channels.names == monitor.channels.names and found.healthy[1][0] == "2.csv"
    write_log(tmp_path / "data.csv", monitor.plant, *LOGS["faults"])
    import pandas as pd

    of_file, of_frame = (found.diagnose(s) for s in (tmp_path / "data.csv", pd.read_csv(tmp_path / "data.csv")))
    assert repr(of_file.events) == repr(of_frame.events) and of_file.state is Verdict.SENSOR
    write_log(tmp_path / "3.csv", monitor.plant, *made(3, skipped=0.4))
    write_log(tmp_path / "4.csv", monitor.plant, *made(4, skipped=0.4))
    gappy = [tmp_path / "3.csv", tmp_path / "4.csv"]
    at_once = Monitor.fit(gappy, inputs=["load"])
    later = Monitor.fit(gappy[:1], inputs=["load"]).update(gappy[1:])
    assert later.channels.names == at_once.channels.names  # skipped rows are not missing readings
    np.testing.assert_array_equal(later.learnt.limits.limit, at_once.learnt.limits.limit)
    with pytest.raises(ValueError, match="no column 'loads'"):
        Monitor.fit(tmp_path / "1.csv", inputs=["loads"])
    with pytest.raises(ValueError, match="there are no healthy logs"):
        Monitor.fit([])
