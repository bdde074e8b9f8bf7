"""The signs of life of a watch: a line, a JSON object, metrics, and blind where no row comes."""

from __future__ import annotations

import json
import socket
import threading
import urllib.error
import urllib.request
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from diagnosis_schema import require_line
from toy_plants import readings, tanks

from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.verdicts import Verdict
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live.saving import SavedWatch
from fusion_sfdia.live.status import Report, Status, beating, endpoint, metrics_at, served

START = datetime(2026, 3, 1, 14, 0, tzinfo=UTC)
PATIENCE = 60  # s, after which the test fails instead of hanging


class Wall:
    """A clock on the wall that a test sets."""

    def __init__(self) -> None:
        self.time = START

    def __call__(self) -> datetime:
        return self.time


def watched(steps: int, wall: Wall, *, seconds: bool = False, **settings: Any) -> tuple[Status, SavedWatch]:
    """A status after so many rows, each 2 s late; rows 10 to 19 lack one of four readings, l1 has a bias from 30 on."""
    t, _, y, u = readings(tanks(), steps, 1, seed=1)
    y = y[:, 0].copy()
    y[10:20, 1] = np.nan
    y[30:, 0] += 0.5
    watch = Watch(LeaveOneOutBank(tanks(), window=1), refused=print)
    status = Status(watch, now=wall, **settings)
    saved = SavedWatch(watch, lambda line: None, status=status)
    for s, row, given in zip(t - t[0], y, u[:, 0], strict=True):
        stamp = START + timedelta(seconds=float(s))
        wall.time = stamp + timedelta(seconds=2)
        saved.update(float(s) if seconds else stamp, row, given)
    return status, saved


def test_a_report_has_time_rows_missing_share_lag_and_verdict() -> None:
    wall = Wall()
    status, _ = watched(25, wall, remarks=lambda: 3)
    found = status.report()
    require_line("status", json.loads(found.json))
    require_line("status", json.loads(Status(Watch(LeaveOneOutBank(tanks()))).report().json))
    assert found.line == ("healthy; last row 2026-03-01 14:02:00+00:00, 25 rows, 10 % of readings missing, lag 2 s")
    assert json.loads(found.json) == {
        "status": "watching", "state": "healthy", "reason": "", "last_row": "2026-03-01 14:02:00+00:00",
        "rows": 25, "missing": 0.1, "lag": 2.0, "age": 0.0, "remarks": 3,
        "device_health": dict.fromkeys(tanks().sensor_names, "NORMAL"),
    }  # fmt: skip
    assert watched(40, Wall())[0].report().conclusion.verdict is Verdict.SENSOR
    alone = watched(25, Wall(), seconds=True)[0].report()
    assert alone.line.startswith("healthy; last row 120 s, 25 rows") and np.isnan(alone.lag)
    assert json.loads(alone.json)["lag"] is None


def test_without_rows_for_long_the_watch_is_blind_until_one_comes() -> None:
    wall = Wall()
    fresh = Status(Watch(LeaveOneOutBank(tanks())), now=wall)
    assert fresh.report().line == "no verdict: no row was judged yet; no row, 0 rows, 0 % of readings missing"
    wall.time += timedelta(seconds=51)  # more than ten steps of 5 s
    assert fresh.report().conclusion.reason == "no row for 51 s"
    status, saved = watched(25, wall)
    wall.time += timedelta(seconds=50)
    assert status.report().conclusion.verdict is Verdict.HEALTHY
    wall.time += timedelta(seconds=1)
    assert status.report().conclusion.text == "no verdict: no row for 51 s" and status.report().age == 51.0
    saved.update(START + timedelta(seconds=125), [1.0, 1.0, 6e-4, 6e-4], [6e-4])
    assert status.report().age == 0.0 and "no row for" not in status.report().line
    patient, _ = watched(25, wall, silent=1000.0)
    wall.time += timedelta(seconds=900)
    assert patient.report().conclusion.verdict is Verdict.HEALTHY


def test_listeners_hear_beats_and_changes_of_the_verdict() -> None:
    wall, heard = Wall(), []
    status, saved = watched(5, wall)
    status.listeners.append(heard.append)
    for k in range(5, 15):
        y = np.full(4, np.nan) if 8 <= k < 10 else tanks().output(0.0, tanks().x0, np.array([6e-4])) * (1 + 1e-4 * k)
        saved.update(START + timedelta(seconds=5.0 * k), y, [6e-4])
    assert [r.conclusion.verdict for r in heard] == [Verdict.BLIND, Verdict.HEALTHY]
    status.beat()
    assert heard[-1] == status.report()


def test_a_beat_comes_from_another_thread_until_the_end() -> None:
    came = threading.Event()
    with beating(0.001, came.set):
        assert came.wait(PATIENCE)
    with beating(0.0, lambda: pytest.fail("0 is never")):
        pass


def test_metrics_are_text_for_prometheus() -> None:
    status, _ = watched(40, Wall())
    with served("metrics", "127.0.0.1", 0, metrics_at(status)) as port:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=PATIENCE) as answer:
            body, kind = answer.read().decode(), answer.headers["Content-Type"]
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"http://127.0.0.1:{port}/other", timeout=PATIENCE)
    assert kind.startswith("text/plain; version=0.0.4") and body.endswith("\n") and body == status.report().metrics
    values = dict(line.rsplit(" ", 1) for line in body.splitlines() if not line.startswith("#"))
    assert values["fusion_sfdia_rows_total"] == "40" and values["fusion_sfdia_lag_seconds"] == "2.0"
    assert values["fusion_sfdia_last_row_timestamp_seconds"] == repr(START.timestamp() + 195.0)
    states = {name: value for name, value in values.items() if "state" in name}
    assert [name for name, value in states.items() if value == "1"] == ['fusion_sfdia_state{state="sensor"}']
    assert len(states) == len(Verdict) and "NaN" in Status(Watch(LeaveOneOutBank(tanks()))).report().metrics
    typed = {line.split()[2] for line in body.splitlines() if line.startswith("# TYPE")}
    assert {name.partition("{")[0] for name in values} == typed
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("9101", ("127.0.0.1", 9101)),
        ("0.0.0.0:9101", ("0.0.0.0", 9101)),
        ("[::1]:9101", ("::1", 9101)),
        (":80", ("127.0.0.1", 80)),
    ],
)
def test_a_port_alone_is_of_this_machine(text: str, expected: tuple[str, int]) -> None:
    assert endpoint(text) == expected


@pytest.mark.parametrize("text", ["", "x", "host:", "host:99999", "::1:9101", "1 2"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected a port, such as 9101, or HOST:PORT"):
        endpoint(text)


def test_a_report_is_a_value() -> None:
    assert Report(*watched(3, Wall())[0].report()).rows == 3
