"""Commands that are ended by a signal: finished parts and states stay, no worker remains, and they end in time."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from toy_plants import readings, tanks

from fusion_sfdia.cli.signals import handled
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.logs.csv_log import write_log

PROGRAM = """
import os, signal, sys
import numpy as np
from toy_scenario import toy
from fusion_sfdia.study import scenarios
from fusion_sfdia.cli.main import main

def work(*arguments):
    if arguments[-1]["detector"] == "b":
        with open("alive", "w") as alive:  # open until this process has ended
            alive.write("x")
            alive.flush()
            signal.pause()
    return {"mean": np.zeros(2)}

SCENARIO = toy(work=work)
if __name__ == "__main__":
    scenarios.SCENARIOS = {"toy/mean": "program:SCENARIO"}
    sys.exit(main(["run", "toy/mean", "--workers", "2", "--out", "out"]))
"""
PATIENCE = 60  # s, after which the test fails instead of hanging


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Commands hear SIGINT, also where the tests run in the background of a shell, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def read(pipe: int, size: int) -> bytes:
    """The next bytes of a pipe; none when every writer has ended."""
    assert select.select([pipe], [], [], PATIENCE)[0], "the workers neither began nor ended"
    return os.read(pipe, size)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize(
    ("sent", "code", "message"), [(signal.SIGTERM, 143, "repeat the same command"), (signal.SIGKILL, -9, "")]
)
def test_no_worker_outlives_the_command(tmp_path: Path, root: Path, sent: int, code: int, message: str) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    os.mkfifo(tmp_path / "alive")
    pipe = os.open(tmp_path / "alive", os.O_RDONLY | os.O_NONBLOCK)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (tmp_path, root / "tests" / "helpers", root)))}
    command = subprocess.Popen(
        [sys.executable, "program.py"], cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert read(pipe, 1) + read(pipe, 1) == b"xx"  # both workers are at the second detector: the first one is done
    command.send_signal(sent)
    assert read(pipe, 1) == b""
    os.close(pipe)
    _, err = command.communicate(timeout=PATIENCE)
    assert command.returncode == code
    assert message in err and "Traceback" not in err
    assert len(list((tmp_path / "out" / "parts").glob("*.npz"))) == 3


DEAF = """
import signal, threading
from fusion_sfdia.cli.signals import SIGNALS, ended_in_time, handled

with handled() as interruption, ended_in_time(interruption):
    interruption.save = lambda: print("saved", flush=True)
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # of this thread, as in compiled code
    ready = False
    while True:
        try:
            if not ready:
                ready = True
                print("ready", flush=True)
            threading.Event().wait()
        except KeyboardInterrupt:  # that came before it waited: discarded, too
            pass
"""
ENDING = """
from fusion_sfdia.cli.signals import ended_in_time, handled
import signal
with handled() as interruption:
    try:
        with ended_in_time(interruption):
            print("ready", flush=True)
            try:
                signal.pause()
            except KeyboardInterrupt:  # once
                signal.pause()
    except KeyboardInterrupt:
        print("ended", flush=True)
        raise SystemExit(interruption.code)
"""
WITHOUT_THREADS = """
import signal
del signal.pthread_kill  # which Windows lacks
from fusion_sfdia.cli.signals import ended_in_time, handled

caught = 0
with handled() as interruption:
    try:
        with ended_in_time(interruption):
            print("ready", flush=True)
            while True:
                try:
                    while True:
                        pass
                except KeyboardInterrupt:  # the first is discarded, the second is sent by the guard
                    caught += 1
                    if caught == 2:
                        raise
    except KeyboardInterrupt:
        print("ended", flush=True)
        raise SystemExit(interruption.code)
"""


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize(("program", "last"), [(DEAF, "saved"), (ENDING, "ended"), (WITHOUT_THREADS, "ended")])
def test_a_signal_that_is_discarded_comes_again_and_then_ends_the_process(
    tmp_path: Path, root: Path, sent: int, program: str, last: str
) -> None:
    environment = {**os.environ, "PYTHONPATH": str(root)}
    command = subprocess.Popen(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True
    )
    assert command.stdout and command.stdout.readline() == "ready\n"
    command.send_signal(sent)
    out, _ = command.communicate(timeout=PATIENCE)
    assert command.returncode == 128 + sent and out.splitlines()[-1] == last


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("waits", [True, False], ids=["waiting", "at work"])
def test_a_watch_ends_by_a_signal_with_its_state_saved(tmp_path: Path, root: Path, sent: int, waits: bool) -> None:
    t, _, y, u = readings(tanks(), 400, 1, seed=1)
    write_log(tmp_path / "log.csv", tanks(), t, y[:, 0], u[:, 0])
    lines = (tmp_path / "log.csv").read_text().splitlines(keepends=True)
    command = [sys.executable, "-m", "fusion_sfdia", "watch", "--plant", "two-tanks", "--detector", "loo-chi2"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    environment = {**os.environ, "PYTHONPATH": str(root)}
    watch: subprocess.Popen[str] = subprocess.Popen(  # type: ignore[call-overload]
        [*command, "--samples", "--state", "w.state"], cwd=tmp_path, env=environment, text=True, **pipes
    )
    assert watch.stdin and watch.stdout
    watch.stdin.writelines(lines[: 30 if waits else 400])
    watch.stdin.flush()
    for _ in range(20):
        last = watch.stdout.readline()
    watch.send_signal(sent)
    out, err = watch.communicate(timeout=PATIENCE)
    assert watch.returncode == 128 + sent and "Traceback" not in err and "interrupted" in err
    last = (last + out).splitlines()[-1]
    found = Watch.load(tmp_path / "w.state", LeaveOneOutBank(tanks(), window=1), refused=print)
    assert found.t == json.loads(last)["t"]


def test_a_row_is_not_broken_by_a_signal_but_ended() -> None:
    with handled() as interruption:
        done = []
        with pytest.raises(KeyboardInterrupt), interruption.deferred():
            signal.raise_signal(signal.SIGTERM)
            done.append("the row")
        assert done == ["the row"] and interruption.code == 143
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        interruption.acknowledge()
        signal.raise_signal(signal.SIGTERM)  # while the state is saved
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
