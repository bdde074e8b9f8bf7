"""The page of a watch: what it shows, how much it keeps, who may read it, and that the watch never waits for it."""

from __future__ import annotations

import argparse
import json
import re
import socket
import threading
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import readings, tanks

from fusion_sfdia.cli.watch import _broker, _server
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live.nodes import Nodes
from fusion_sfdia.live.page import MOST_ROWS, POLL, LivePage
from fusion_sfdia.live.saving import SavedWatch
from fusion_sfdia.live.status import Answer, Status, served
from fusion_sfdia.live.topics import Topics
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.logs.conversion import conversion

PATIENCE = 60  # s, after which the test fails instead of hanging
PLANT = tanks()
T, _, Y, U = readings(PLANT, 60, 1, seed=0)
BIASED = Y[:, 0] + 20 * PLANT.sensor_sigma * np.outer(T > 150, np.arange(4) == 2)  # q12


class Ticks:
    """Seconds of a clock that a test sets."""

    def __init__(self) -> None:
        self.time = 0.0

    def __call__(self) -> float:
        return self.time


def made(ticks: Ticks, **settings: Any) -> tuple[LivePage, SavedWatch]:
    watch = Watch(LeaveOneOutBank(PLANT, false_alarm=1e-6), refused=print)
    status = Status(watch)
    page, saved = LivePage(watch, status, now=ticks, **settings), SavedWatch(watch, lambda line: None, status=status)
    saved.takers.append(page.taken)
    saved.outlets.append(lambda change, line: page.changed(change))
    return page, saved


def give(saved: SavedWatch, count: int, first: int = 0) -> None:
    for t, y, u in zip(T[first:count], BIASED[first:count], U[first:count, 0], strict=True):
        saved.update(float(t), y, u)


def test_before_the_first_row_events_that_stand_are_there() -> None:
    """As after a restart from a saved state: the page has no rows, the watch has its events."""
    _, saved = made(Ticks())
    give(saved, 60)
    watch = saved.watch
    parts = LivePage(watch, Status(watch), now=Ticks()).parts()
    assert "q12" in parts["findings"] and "No finding" not in parts["findings"] and parts["figures"] == ""


def test_it_shows_state_findings_and_figures() -> None:
    ticks = Ticks()
    page, saved = made(ticks)
    found = page.answer("/")
    assert found is not None and "No finding" in found.text and "Check function" in found.text  # no row yet
    ticks.time += POLL
    give(saved, 25)
    healthy = page.parts()
    assert "Normal" in healthy["state"] and "No finding" in healthy["findings"] and healthy["figures"].count("<svg") == 1
    give(saved, 60, first=25)
    assert page.parts()["findings"] == healthy["findings"]  # drawn a moment ago
    assert "Out of specification" in page.parts()["state"]  # which is always of now
    ticks.time += POLL
    shown = page.parts()
    assert re.search(r"Flow between the tanks q12 has read .* too high since 155 s", shown["findings"])
    assert shown["figures"].count("data-plot=") == shown["figures"].count("<svg") == 3
    answer = page.answer("/parts")
    assert answer is not None and json.loads(answer.text) == shown
    whole = page.answer("/")
    assert whole is not None and "q12" in whole.text and whole.text.count("<script>") == 1
    assert not re.search(r'(src|href)="(?!#|data:)', whole.text)  # nothing else is fetched
    assert page.answer("/etc/passwd") is None
    page.show_in([Source("FI12.PV [m3/h]", "q12", 2, False, "m3/h", conversion("m3/h", "m3/s"))])
    ticks.time += 100 * POLL
    shown = page.parts()
    assert re.search(r"Flow between the tanks FI12.PV has read 0\.4.* m3/h .*too high since 155 s", shown["findings"])
    assert "FI12.PV: out of specification" in shown["state"] and "[m3/h]" in shown["figures"]


@pytest.mark.parametrize(
    ("of", "read"),
    [
        ("opcua", 'q12 = { node = "ns=2;s=FI12.PV", unit = "m3/h" }\nl2 = "ns=2;s=LI2.PV"\ninflow = "ns=2;i=7"'),
        ("mqtt", 'q12 = { topic = "FI12.PV", unit = "m3/h" }\nl2 = "LI2.PV"\ninflow = "inflow"'),
    ],
)
def test_of_a_server_or_a_broker_it_shows_the_tags(of: str, read: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page, saved = made(Ticks())
    monkeypatch.setattr("fusion_sfdia.live.mqtt.watch_broker", lambda *_, **__: give(saved, 60))

    async def given(*_: Any, **__: Any) -> None:
        give(saved, 60)

    monkeypatch.setattr("fusion_sfdia.live.opcua.watch_server", given)
    path = tmp_path / "addresses.toml"
    path.write_text(f"[read]\n{read}\n", encoding="utf-8")
    chosen = argparse.Namespace(nodes=path, topics=path, opcua="opc.tcp://x", mqtt="mqtt://x", allow_plain_password=False)
    (_server if of == "opcua" else _broker)(chosen, saved, page)
    assert page.shown_in.tags == {"q12": "FI12.PV", "l2": "LI2.PV"}
    shown = page.parts()
    assert re.search(r"Flow between the tanks FI12.PV has read 0\.4.* m3/h .*too high since 155 s", shown["findings"])
    assert "FI12.PV: out of specification" in shown["state"]


def test_topics_with_several_values_are_told_apart_by_their_keys() -> None:
    topics = Topics({"l1": {"topic": "plant", "value": "upper"}, "l2": {"topic": "plant", "value": "lower"}, "q2": "flow"})
    assert [c.title for c in topics.columns(PLANT)] == ["plant upper", "plant lower", "flow"]
    assert [c.title for c in Nodes({"l1": "ns=2;i=7", "inflow": "ns=2;s=a=b;c"}).columns(PLANT)] == ["l1", "a=b;c"]


def test_rows_and_events_are_few_however_long_it_runs() -> None:
    page, saved = made(Ticks(), hours=100 / 3600)
    give(saved, 60)
    assert [row.t for row in page.rows] == [t for t in T if t >= T[-1] - 100]
    event = next(iter(page.events.values()))
    (sample,) = saved.update(float(T[-1] + 5), Y[-1, 0], U[-1, 0])
    page.span = 10.0 * MOST_ROWS
    for k in range(4 * MOST_ROWS):
        page.taken((sample._replace(t=400.0 + 5 * k),))
    assert len(page.rows) <= MOST_ROWS and np.all(np.diff([row.t for row in page.rows][-MOST_ROWS // 2 :]) == 10)
    (change, *_) = saved.watch.findings.reset(400.0, "a test", saved.watch.clock)
    for k in range(1000):
        page.changed(change._replace(id=100 + k, event=event.__class__(**{**vars(event), "open": False})))
    assert len(page.events) <= 100


def test_the_watch_goes_on_while_it_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    page, saved = made(Ticks())
    give(saved, 10)
    began, go_on = threading.Event(), threading.Event()

    def slow(*_: Any) -> dict[str, str]:
        began.set()
        assert go_on.wait(PATIENCE)
        return {"findings": "drawn", "figures": ""}

    monkeypatch.setattr(page, "_drawn", slow)
    asked = [threading.Thread(target=page.parts) for _ in range(3)]
    for one in asked:
        one.start()
    assert began.wait(PATIENCE)
    give(saved, 20, first=10)  # would wait for ever if drawing held the lock
    go_on.set()
    for one in asked:
        one.join(PATIENCE)
        assert not one.is_alive()
    assert page.parts()["findings"] == "drawn" and page.rows[-1].t == saved.watch.t == T[19]


def test_an_error_in_drawing_is_no_end() -> None:
    page, saved = made(ticks := Ticks())
    give(saved, 10)
    page._drawn, own = None, page._drawn  # type: ignore[assignment, method-assign]
    with pytest.raises(TypeError):
        page.parts()
    page._drawn = own  # type: ignore[method-assign]
    ticks.time += POLL
    assert page.parts()["figures"]


def test_only_this_machine_is_answered_and_a_port_in_use_is_named() -> None:
    with served("page", "127.0.0.1", 0, lambda path: Answer("text/plain", "here") if path == "/" else None) as port:
        for host, status in (("localhost", 200), (f"127.0.0.1:{port}", 200), ("127.0.0.1", 200), ("evil.example", 404)):
            asked = urllib.request.Request(f"http://127.0.0.1:{port}/?x=1", headers={"Host": host})
            try:
                with urllib.request.urlopen(asked, timeout=PATIENCE) as answer:
                    assert (answer.status, answer.read()) == (status, b"here")
            except urllib.error.HTTPError as error:
                assert error.code == status
        with pytest.raises(urllib.error.HTTPError, match="501"):  # it is read alone
            urllib.request.urlopen(f"http://127.0.0.1:{port}/", data=b"x", timeout=PATIENCE)
        expected = rf"--page: 127.0.0.1:{port} cannot be served \(.*\); name another port"
        with pytest.raises(ValueError, match=expected), served("page", "127.0.0.1", port, lambda path: None):
            pass
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port))


@pytest.mark.parametrize("hours", [0.0, -1.0, np.nan, np.inf])
def test_hours_that_are_none_are_refused(hours: float) -> None:
    with pytest.raises(ValueError, match=r"hours|the page goes back"):
        made(Ticks(), hours=hours)
