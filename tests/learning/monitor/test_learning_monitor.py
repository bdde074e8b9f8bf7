"""A monitor from healthy logs: what it names, what it does not, and that it can be kept."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import fusion_sfdia as sfdia
from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.verdicts import Verdict
from fusion_sfdia.diagnosis.events import Event, GroupEvent, RecorderEvent, StillEvent
from fusion_sfdia.diagnosis.sentences import Wording, sentence
from fusion_sfdia.learning.monitor.causes import OK, RECORDER
from fusion_sfdia.learning.monitor.channels import pieces_of, read
from fusion_sfdia.learning.monitor.monitor import Monitor
from fusion_sfdia.learning.monitor.row_verdicts import OutsideEvent
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

DT, ROWS = 10.0, 1200
SENSORS = (*(Signal(f"s{i}", "bar") for i in range(6)), Signal("alone", "K"), Signal("still", "K"))
LOAD = Signal("load", "kW")
C = np.random.default_rng(1).standard_normal((6, 2))
STEP = 3.0


def made(seed: int, rows: int = ROWS, process: slice = slice(0), skipped: float = 0.0) -> Log:
    """Six readings of two factors, one of which follows the load; one that nothing else explains; one that never moves.

    process: rows in which the two factors act on the sensors in exchanged roles.
    """
    rng = np.random.default_rng(seed)
    u, f, alone, n = np.zeros((rows, 1)), np.zeros((rows, 2)), np.zeros(rows), rng.standard_normal((rows, 4))
    for k in range(1, rows):
        u[k] = 0.98 * u[k - 1] + 0.2 * n[k, 0]
        f[k] = 0.95 * f[k - 1] + 0.3 * n[k, 1:3] + [0.05 * u[k, 0], 0.0]
        alone[k] = 0.9 * alone[k - 1] + 0.4 * n[k, 3]
    y = f @ C.T
    y[process] = f[process] @ C[::-1].T + 2.0 * np.sign(C[:, 0])
    y = np.column_stack([y + 0.3 * rng.standard_normal((rows, 6)), alone, np.full(rows, 4.0)])
    kept = rng.random(rows) >= skipped
    return Log(DT * np.arange(rows)[kept], y[kept], u[kept])


@pytest.fixture(scope="module")
def monitor() -> Monitor:
    return Monitor.of_logs(SENSORS, [made(1), made(2)], inputs=[LOAD])


def events(monitor: Monitor, log: Log) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for e in monitor.diagnose(log).events:
        found.setdefault(f"{e.kind} {e.hypothesis}", []).append(e)
    return found


def test_a_healthy_log_is_accused_in_no_more_rows_than_stated(monitor: Monitor) -> None:
    shares = [np.mean(monitor.judge(made(seed))[0].causes.alarm) for seed in range(10, 20)]
    assert np.mean(shares) <= 0.015 and max(shares) <= 0.02


def test_a_bias_is_named_with_its_size_from_its_row_to_its_end(monitor: Monitor) -> None:
    t, y, u = made(21)
    y[500:800, 2] += STEP
    found = monitor.diagnose(Log(t, y, u))
    (bias,) = [e for e in found.events if e.kind == "sensor" and e.end - e.start > 300]
    assert bias.hypothesis == "s2" and abs(bias.start - 5000) <= 4 * DT and abs(bias.end - 8000) <= 64 * DT
    assert bias.size == pytest.approx(STEP, abs=0.3) and found.state is Verdict.SENSOR
    assert "s2" in found.verdict and not bias.open


def test_freezes_and_dropouts_are_named_and_the_others_judged_on(monitor: Monitor) -> None:
    t, y, u = made(22)
    y[300:420, 0] = y[300, 0]
    y[600:700, 1] = np.nan
    y[350:420, 4] += STEP
    found = events(monitor, Log(t, y, u))
    assert found["sensor s0"][0].fault == "freeze" and found["sensor s1"][0].fault == "dropout"
    assert abs(found["sensor s4"][0].start - 3500) <= 4 * DT


def test_what_only_one_sensor_measures_is_sensor_or_process_and_its_freeze_a_sensor(monitor: Monitor) -> None:
    t, y, u = made(23)
    y[500:900, 6] += 12.0
    found = events(monitor, Log(t, y, u))
    assert "undecided alone or the process" in found and "sensor alone" not in found
    y = made(23).y
    y[500:900, 6] = y[500, 6]
    assert "sensor alone" in events(monitor, Log(t, y, u))
    assert "no other channel measures it" in next(line for line in str(monitor).splitlines() if line.startswith("alone"))


def test_of_two_sensors_that_only_explain_each_other_it_is_one_or_the_other() -> None:
    def twins(seed: int) -> Log:
        t, y, u = made(seed)
        rng = np.random.default_rng(100 + seed)
        slow = y[:, 6] * 2.0
        return Log(t, np.column_stack([y, slow + 0.2 * rng.standard_normal(ROWS)]), u)

    monitor = Monitor.of_logs((*SENSORS, Signal("twin", "K")), [twins(1), twins(2)], inputs=[LOAD])
    t, y, u = twins(3)
    y[500:800, 8] += 2.0
    causes = monitor.judge(Log(t, y, u))[0].causes
    names = monitor.channels.names
    a, b = names.index("alone"), names.index("twin")
    assert (causes.suspect[500:800, a] & causes.suspect[500:800, b]).mean() > 0.9
    assert causes.named[500:800, a].mean() < 0.03


def test_a_fault_of_the_process_names_no_sensor(monitor: Monitor) -> None:
    found = monitor.diagnose(made(24, process=slice(500, 800)))
    assert {e.kind for e in found.events} & {"process", "outside"}
    named = found.decisions.isolated[500:800].any(axis=1)
    assert named.mean() <= 0.02 and found.state in (Verdict.PROCESS, Verdict.OUTSIDE)


def test_all_columns_that_stop_at_once_are_the_recorder(monitor: Monitor) -> None:
    t, y, u = made(25)
    y[600:], u[600:] = y[600], u[600]
    (verdicts,) = monitor.judge(Log(t, y, u))
    assert (verdicts.causes.kind[625:] == RECORDER).all() and not verdicts.causes.named[600:].any()
    assert "outside recorder" in events(monitor, Log(t, y, u))
    y = made(25).y
    y[600:] = np.nan
    assert (monitor.judge(Log(t, y, u))[0].causes.kind[625:] == RECORDER).all()


def test_a_fault_since_the_first_row_is_found(monitor: Monitor) -> None:
    t, y, u = made(26)
    y[:, 3] += STEP
    named = monitor.diagnose(Log(t, y, u)).decisions.isolated
    assert named[:, 3].mean() > 0.8 and not np.delete(named, 3, axis=1).any(axis=1).mean() > 0.01


def test_an_operation_that_was_not_learnt_is_outside_and_no_sensor_is_named(monitor: Monitor) -> None:
    t, y, u = made(27)
    found = monitor.diagnose(Log(t, np.column_stack([y[:, :6] + 8 * C[:, 0], y[:, 6:]]), u))
    assert found.state is Verdict.OUTSIDE and not found.decisions.isolated.any(axis=1).mean() > 0.02
    assert "outside what was learnt" in found.verdict


def test_skipped_rows_are_rows_without_readings_when_learning_and_when_judging() -> None:
    gappy = Monitor.of_logs(SENSORS, [made(1, skipped=0.3), made(2, skipped=0.3)], inputs=[LOAD])
    shares = [np.mean(gappy.judge(made(seed, skipped=0.3))[0].causes.alarm) for seed in range(30, 36)]
    assert np.mean(shares) <= 0.01 and max(shares) <= 0.02
    t, y, u = made(37, skipped=0.3)
    y[400:, 2] += STEP
    assert gappy.diagnose(Log(t, y, u)).decisions.isolated[600:, 2].mean() > 0.6  # of all rows, those skipped too


def test_a_channel_that_cannot_be_learnt_is_left_out_and_the_others_stay(monitor: Monitor) -> None:
    def gappy(seed: int) -> Log:
        t, y, u = made(seed)
        lost = np.random.default_rng(seed).random(len(y)) < 0.6
        return Log(t, np.where(lost[:, None] & (np.arange(8) == 5), np.nan, y), u)

    found = Monitor.of_logs(SENSORS, [gappy(1), gappy(2)], inputs=[LOAD])
    assert "s5" not in found.channels.names and "misses " in found.channels.left_out["s5"]
    t, y, u = gappy(21)
    y[500:800, 2] += STEP
    assert "sensor s2" in events(found, Log(t, y, u))
    assert np.mean(found.judge(gappy(12))[0].causes.alarm) <= 0.02


def test_tags_that_are_written_each_at_its_own_time_are_gathered_on_a_grid_that_they_support() -> None:
    """Each reading in a row of its own, of three of five readings at most; a bias is found within some steps of the grid."""

    def scattered(seed: int, bias: float = 0.0) -> Log:
        t, y, u = made(seed, 2000)
        y[1000:1500, 2] += bias
        rng = np.random.default_rng(50 + seed)
        k, i = np.nonzero(rng.random((len(t), 7)) < 0.6)
        at = t[k] + rng.uniform(0, 9, k.size)
        order = np.argsort(at)
        v = np.full((k.size, 9), np.nan)
        v[np.arange(k.size), np.where(i < 6, i, 8)] = np.where(i < 6, y[k, np.minimum(i, 5)], u[k, 0])
        return Log(at[order], v[order, :8], v[order, 8:])

    log = scattered(1)
    found = Monitor.of_logs(SENSORS, [log, scattered(2)], inputs=[LOAD])
    assert 1.5 * DT < found.dt < 4 * DT and {"alone", "still"} == set(found.channels.left_out)
    (bias,) = [e for e in found.diagnose(scattered(3, STEP)).events if e.kind == "sensor" and e.end - e.start > 300]
    assert bias.hypothesis == "s2" and abs(bias.start - 10_000) <= 4 * found.dt and bias.size == pytest.approx(STEP, abs=0.3)
    assert np.mean(found.judge(scattered(4))[0].causes.alarm) <= 0.02


def test_a_column_that_is_written_on_change_keeps_its_last_reading_as_long_as_it_did_when_healthy() -> None:
    def seldom(seed: int) -> Log:
        t, y, u = made(seed)
        return Log(t, y, np.where((np.arange(len(u)) % 5 == 0)[:, None], u, np.nan))

    found = Monitor.of_logs(SENSORS, [seldom(1), seldom(2)], inputs=[LOAD])
    assert found.channels.hold.tolist() == [0.0] * 8 + [5.0] and "load (50 s)" in str(found)
    assert "load" in found.channels.names
    v = np.array([[1.0], [np.nan], [np.nan], [np.nan], [2.0]])
    assert read(v).held(np.array([2.0]))[:, 0].tolist()[:3] == [1.0, 1.0, 1.0] and np.isnan(read(v).held(np.array([2.0]))[3, 0])


def test_several_rows_at_one_step_count_by_their_mean_and_equal_ones_to_the_bit() -> None:
    t = np.array([0.0, 1.0, 2.0, 10.0, 11.0, 12.0, 30.0])
    y = np.array([0.1, 0.1, 0.1, 1.0, 2.0, np.nan, 7.0])[:, None]
    (piece,) = pieces_of(Log(t, y, np.empty((7, 0))), 10.0)
    assert piece.v[:, 0].tolist()[:2] == [0.1, 1.5] and np.isnan(piece.v[2, 0]) and piece.v[3, 0] == 7.0
    assert piece.rows.tolist() == [2, 5, -1, 6] and piece.t.tolist() == [0.0, 10.0, 20.0, 30.0]
    two = pieces_of(Log(np.array([0.0, 10.0, 1000.0]), np.ones((3, 1)), np.empty((3, 0))), 10.0)
    assert [p.t.tolist() for p in two] == [[0.0, 10.0], [1000.0]]


def test_a_sensor_that_never_moved_is_reported_when_it_moves(monitor: Monitor) -> None:
    assert "still: never moved when healthy, always 4" in str(monitor)
    t, y, u = made(28)
    y[900:, 7] = 4.5
    (moved,) = events(monitor, Log(t, y, u))["outside still"]
    assert moved.start == 9000.0 and moved.size == 0.5 and "never when healthy" in str(monitor.diagnose(Log(t, y, u)))


def test_verdicts_of_a_log_do_not_change_with_later_rows(monitor: Monitor) -> None:
    t, y, u = made(29)
    y[500:800, 2] += STEP
    whole = monitor.judge(Log(t, y, u))[0].causes
    for rows in (30, 510, 700, 850):
        part = monitor.judge(Log(t[:rows], y[:rows], u[:rows]))[0].causes
        assert np.array_equal(part.kind, whole.kind[:rows]) and np.array_equal(part.named, whole.named[:rows])


def test_a_saved_monitor_decides_as_before(monitor: Monitor, tmp_path: Path) -> None:
    monitor.save(tmp_path / "plant.sfdia")
    again = Monitor.load(tmp_path / "plant.sfdia")
    assert str(again) == str(monitor)
    t, y, u = made(21)
    y[500:800, 2] += STEP
    for a, b in zip(monitor.judge(Log(t, y, u))[0].causes, again.judge(Log(t, y, u))[0].causes, strict=True):
        assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")


def test_runs_of_their_own_are_saved_too(tmp_path: Path) -> None:
    monitor = Monitor.of_logs(SENSORS, [made(seed, 500) for seed in range(5)], inputs=[LOAD])
    assert monitor.learnt.absolute is not None
    monitor.save(tmp_path / "plant.sfdia")
    log = made(40, 500)
    a, b = (m.judge(log)[0].causes.kind for m in (monitor, Monitor.load(tmp_path / "plant.sfdia")))
    assert np.array_equal(a, b) and np.mean(a == OK) > 0.5


@pytest.mark.parametrize("damage", ["cut", "other", "empty", "version"])
def test_what_is_no_monitor_is_refused(monitor: Monitor, tmp_path: Path, damage: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "plant.sfdia"
    if damage == "version":
        monkeypatch.setattr("fusion_sfdia.learning.monitor.monitor.VERSION", 99)
    monitor.save(path)
    monkeypatch.undo()
    content = path.read_bytes()
    path.write_bytes({"cut": content[:-5], "other": json.dumps({}).encode(), "empty": b"", "version": content}[damage])
    with pytest.raises(ValueError, match="is no monitor"):
        Monitor.load(path)
    with pytest.raises(ValueError, match="cannot be read"):
        Monitor.load(tmp_path / "absent.sfdia")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"healthy": []}, "there are no healthy logs"),
        ({"healthy": [made(1, 40)]}, "40 rows in steps of 10 s; expected at least 64"),
        ({"sensors": SENSORS[:4]}, "expected 4 sensors and 1 inputs"),
        ({"false_alarm": 0.0}, "expected a positive number, such as 1/day"),
        ({"false_alarm": "1/moon"}, "such as 1/day"),
        ({"healthy": [made(1)._replace(t=np.zeros(ROWS))]}, "the times of healthy log 1 do not rise"),
        ({"healthy": [made(1)._replace(y=np.full((ROWS, 8), 1.0))]}, "expected two channels or more"),
    ],
)
def test_what_cannot_be_learnt_is_refused(changes: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"sensors": SENSORS, "healthy": [made(1)], "inputs": [LOAD]}
    with pytest.raises(ValueError, match=message):
        Monitor.of_logs(**{**given, **changes})


def test_a_log_of_other_columns_is_refused(monitor: Monitor) -> None:
    t, y, u = made(1)
    with pytest.raises(ValueError, match="give those of the healthy logs"):
        monitor.diagnose(Log(t, y[:, :3], u))


def test_the_result_is_plotted_and_reported_as_that_of_a_detector(monitor: Monitor, tmp_path: Path) -> None:
    t, y, u = made(21)
    y[500:800, 2] += STEP
    found = monitor.diagnose(Log(t, y, u))
    assert isinstance(found, sfdia.Result) and found.log.y.shape == y.shape
    assert [a.get_ylabel() for a in found.plot().axes]
    page = found.report(tmp_path / "found.html").read_text(encoding="utf-8")
    assert "By the monitor" in page and "Judged by healthy logs, without a model" in page and "s2" in page


@pytest.mark.parametrize(
    ("event", "said"),
    [
        (GroupEvent("process", 0.0, 60.0, np.nan, "", False, most=("F1", "T2")), "Readings moved together from 0 s to 60 s as"),
        (GroupEvent("process", 0.0, 60.0, np.nan, "", False, most=("F1", "T2")), "healthy logs, sensor F1, T2 most of all; no"),
        (
            GroupEvent("process", 0.0, 60.0, np.nan, "", True),
            "Readings have moved together since 0 s as never in the healthy logs;",
        ),
        (OutsideEvent("outside", 0.0, 60.0, np.nan, "", False), "Operation from 0 s to 60 s was unlike any healthy log"),
        (RecorderEvent("recorder", 0.0, 60.0, np.nan, "", False), "all from the same row on. Check the recorder and its link."),
        (StillEvent("F1", 0.0, 60.0, -2.5, "m3/h", False), "Sensor F1 moved by 2.5 m3/h from 0 s to 60 s, which it never did"),
    ],
)
def test_each_kind_of_event_is_a_sentence(event: Event, said: str) -> None:
    assert said in sentence(event, {"F1": Wording("sensor", "F1")}, Clock())
