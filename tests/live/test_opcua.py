"""A watch on a real OPC UA server in its own process, which is killed and comes back."""

from __future__ import annotations

import asyncio
import json
import socket
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import changed, readings, tanks

from fusion_sfdia.cli.main import main
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.device_health import DeviceHealth
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live import opcua
from fusion_sfdia.live.nodes import load_nodes
from fusion_sfdia.live.saving import SavedWatch

pytest.importorskip("asyncua")

HELPERS = Path(__file__).resolve().parents[1] / "helpers"
PATIENCE = 120  # s, after which the test fails instead of hanging
NODES = """
period = 0.001
status = "ns=2;s=watch"
max_lag = inf
retry = 0.01
uncertain = "missing"

[read]
l1 = "ns=2;s=l1"
l2 = "ns=2;s=l2"
q12 = "ns=2;s=q12"
q2 = "ns=2;s=q2"
inflow = "ns=2;s=inflow"

[write]
verdict = "ns=2;s=verdict"
alarm = "ns=2;s=alarm"
l1 = { value = "ns=2;s=l1.value", sigma = "ns=2;s=l1.sigma", verdict = "ns=2;s=l1.verdict", health = "ns=2;s=l1.health" }
"""


class EndedError(Exception):
    """The last row was diagnosed."""


class Server:
    """The server as a process, always on one port."""

    def __init__(self, rows: Path) -> None:
        with socket.socket() as found:
            found.bind(("127.0.0.1", 0))
            self.port = found.getsockname()[1]
        self.rows, self.process = rows, None
        self.url = f"opc.tcp://127.0.0.1:{self.port}/"

    def start(self, first: int) -> None:
        command = [sys.executable, str(HELPERS / "opcua_plant.py"), str(self.port), str(self.rows), str(first)]
        self.process: Any = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout.readline() == "ready\n"

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate(timeout=PATIENCE)

    def end(self) -> dict[str, Any]:
        """End it in order; what was written to it last."""
        out, _ = self.process.communicate(timeout=PATIENCE)
        written: dict[str, Any] = json.loads(out.splitlines()[-1])
        return written


def detector() -> LeaveOneOutBank:
    return LeaveOneOutBank(tanks(), window=1)


def recorded(path: Path, steps: int) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Rows with a bias of l1 from 20 on and a broken and an inaccurate q2, in a file for the server; those that count."""
    t, _, y, u = readings(tanks(), steps, 1, seed=4)
    y, u = y[:, 0].copy(), u[:, 0]
    y[20:, 0] += 0.3
    quality = np.zeros((steps, 5), int)
    quality[5:8, 3], quality[10, 3] = 2, 1
    np.savez(path, t=t, values=np.concatenate([y, u], axis=1), quality=quality)
    y[quality[:, :4] > 0] = np.nan
    return list(zip((t - t[0]).tolist(), y, u, strict=True))


def lines_of(rows: list[Any]) -> list[str]:
    found: list[str] = []
    saved = SavedWatch(Watch(detector(), at_sample=True), found.append)
    for row in rows:
        saved.update(*row)
    return found


def without_stamps(line: str) -> dict[str, Any]:
    return {name: value for name, value in json.loads(line).items() if "time" not in name and name != "text"}


def watched(server: Server, tmp_path: Path, at: Callable[[dict[str, Any]], None], remarks: list[str]) -> list[dict[str, Any]]:
    """Watch the server until `at`, called with each sample, raises EndedError; the events."""
    (tmp_path / "nodes.toml").write_text(NODES)
    found: list[dict[str, Any]] = []

    def write(line: str) -> None:
        known = without_stamps(line)
        at(known) if known["event"] == "sample" else found.append(known)

    watch = Watch(detector(), at_sample=True, refused=remarks.append)
    saved = SavedWatch(watch, write, samples=True)
    running = opcua.watch_server(saved, server.url, load_nodes(tmp_path / "nodes.toml", tanks()))
    with pytest.raises(EndedError):
        asyncio.run(asyncio.wait_for(running, PATIENCE))
    return found


@pytest.mark.slow
def test_nodes_are_rows_and_a_server_that_is_killed_and_comes_back_is_a_gap(tmp_path: Path) -> None:
    steps, killed, back = 40, 29, 33
    rows = recorded(tmp_path / "rows.npz", steps)
    server, remarks = Server(tmp_path / "rows.npz"), []
    server.start(0)

    def at(sample: dict[str, Any]) -> None:
        if sample["t"] == rows[killed][0]:
            server.kill()
            server.start(back)
        elif sample["t"] == rows[-2][0]:
            ends.append(sample)
        elif sample["t"] == rows[-1][0]:
            raise EndedError

    ends: list[dict[str, Any]] = []
    found = watched(server, tmp_path, at, remarks)
    expected = [without_stamps(line) for line in lines_of(rows[: killed + 1] + rows[back:])]
    assert found == expected and {"l1"} <= {e["hypothesis"] for e in found}
    written = server.end()  # with the last row but one: the test has ended the last
    assert written["l1.verdict"] == "isolated" and "l1" in written["verdict"] and written["alarm"] is True
    assert written["l1.value"] == ends[0]["values"]["l1"] != rows[-2][1][0]
    assert written["l1.health"] == DeviceHealth.OFF_SPEC == DeviceHealth[ends[0]["device_health"]["l1"]]
    assert written["l1.sigma"] == ends[0]["sigma"]["l1"] and 0 < written["l1.sigma"] != 0.01
    assert "no connection" in remarks[0] and remarks[1].endswith("connected again") and len(remarks) == 2


@pytest.mark.slow
def test_without_readings_the_verdict_is_no_verdict_and_numbers_are_of_bad_quality(tmp_path: Path) -> None:
    rows, server = recorded(tmp_path / "rows.npz", 30), Server(tmp_path / "rows.npz")
    with np.load(tmp_path / "rows.npz") as file:
        known = dict(file)
    known["quality"][24:, :4] = 2
    np.savez(tmp_path / "rows.npz", **known)
    server.start(0)

    def at(sample: dict[str, Any]) -> None:
        verdicts.append(sample["verdict"])
        if sample["t"] == rows[-1][0]:
            raise EndedError

    verdicts: list[str] = []
    found = watched(server, tmp_path, at, [])
    written = server.end()
    assert verdicts[22:] == ["sensor", "sensor", *["blind"] * 6] and "blind" in [e["event"] for e in found]
    assert (
        written["verdict"] == "no verdict: no sensor has a reading; isolated before: l1" and written["l1.verdict"] == "missing"
    )
    assert written["alarm"] is None and written["l1.sigma"] is not None
    assert written["l1.health"] == DeviceHealth.OFF_SPEC  # the event stands
    assert written["watch"] == "no verdict: no sensor has a reading"


def test_times_of_a_plant_of_fixed_steps_are_put_on_its_grid(tmp_path: Path) -> None:
    (tmp_path / "nodes.toml").write_text(NODES)
    plant = changed(tanks(), fixed_dt=True)
    nodes = load_nodes(tmp_path / "nodes.toml", plant)
    watch, start = Watch(LeaveOneOutBank(plant, window=1)), datetime(2026, 3, 1, tzinfo=UTC)
    bridge = opcua.OpcuaBridge(SavedWatch(watch, print), "", nodes)
    for seconds in (0.0, 5.2, 9.9):
        watch.update(bridge.values.on_grid(start + timedelta(seconds=seconds)), [1.0, 1.0, 6e-4, 6e-4], [6e-4])
    assert watch.t == 10.0


def test_a_file_of_nodes_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "nodes.toml"
    for change, message in (
        (("period = 0.001", "period = -1"), "period is -1; expected a positive number of seconds"),
        (("period = 0.001", "perod = 1"), "unknown name 'perod'; known: .*read, write"),
        (('"missing"', '"bad"'), "uncertain is 'bad'; expected 'use' or 'missing'"),
        (('"ns=2;s=l1"', '"l1"'), "l1 is 'l1'; expected the id of a node"),
        (("l2 =", "l3 ="), r"\[read\]: unknown name 'l3'; known: l1, l2"),
        (("inflow =", "#"), "nothing for the inputs inflow"),
        (("{ value =", "{ size ="), r"\[write.l1\]: unknown name 'size'"),
        (("[read]", "[read"), "is not TOML"),
        (("max_lag = inf", 'max_lag = "inf"'), "max_lag is 'inf'; expected a number"),
        (('"ns=2;s=l1"', '{ node = "ns=2;s=l1", unit = "bar" }'), "unit 'bar' does not convert to 'm'"),
        (('"ns=2;s=l1"', '{ node = "ns=2;s=l1", scale = 2 }'), "l1: unknown name 'scale'; known: node, unit, states"),
        (('"ns=2;s=l1"', '{ unit = "mm" }'), "l1: node is None; expected the id of a node"),
        (('"ns=2;s=alarm"', '"s=q2;ns=2"'), r"\[read\] q2 and \[write\] alarm both have the address"),
        (('"ns=2;s=l1.sigma"', '"ns=2;s=inflow"'), r"\[read\] inflow and \[write.l1\] sigma both have the address"),
        (('"ns=2;s=q12"', '"ns=2;s=l2"'), "sensor l2 and sensor q12 are both read from 'ns=2;s=l2'"),
        (
            ('"ns=2;s=l1.value", sigma = "ns=2;s=l1.sigma"', '"i=7", sigma = "ns=0;i=7"'),
            "value and .* sigma both have the address",
        ),
        (('"ns=2;s=q12"', '"ns=2; s=inflow"'), "sensor q12 and input inflow are both read from"),
        (("[write]", "user = 1\n[write]"), r"\[read\]: unknown name 'user'"),
    ):
        path.write_text(NODES.replace(*change, 1))
        with pytest.raises(ValueError, match=message):
            load_nodes(path, tanks())
    path.write_text(NODES.replace("ns=2;s=l1", "x=y"))
    with pytest.raises(ValueError, match="'x=y' is not the id of a node"):
        opcua.OpcuaBridge(SavedWatch(Watch(detector()), print), "", load_nodes(path, tanks()))


def test_the_command_needs_both_and_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["watch", "--plant", "two-tanks", "--detector", "loo-chi2", "--opcua", "opc.tcp://127.0.0.1:1"]
    assert main(command) == 2 and "--opcua needs --nodes" in capsys.readouterr().err
    (tmp_path / "nodes.toml").write_text(NODES)
    monkeypatch.setitem(sys.modules, "asyncua", None)
    assert main([*command, "--nodes", str(tmp_path / "nodes.toml")]) == 1
    assert "pip install 'fusion-sfdia[opcua]'" in capsys.readouterr().err


def test_nodes_that_the_server_does_not_have_are_said(tmp_path: Path) -> None:
    from asyncua import ua

    (tmp_path / "nodes.toml").write_text(NODES)
    remarks: list[str] = []
    watch = Watch(detector(), refused=remarks.append)
    bridge = opcua.OpcuaBridge(SavedWatch(watch, print), "", load_nodes(tmp_path / "nodes.toml", tanks()))
    good = ua.DataValue(Value=ua.Variant(1.0), SourceTimestamp=datetime(2026, 3, 1))
    bridge.check([good, ua.DataValue(StatusCode=ua.StatusCode(ua.StatusCodes.BadNodeIdUnknown)), good, good, good])
    assert remarks == ["l2: its node ns=2;s=l2 has no value (BadNodeIdUnknown)"]
    bridge.check([ua.DataValue(Value=ua.Variant(1.0))] * 5)
    assert remarks[1] == "no node has a time stamp: there are no rows"
