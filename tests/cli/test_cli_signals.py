"""A campaign that is ended by a signal: finished parts stay, no worker remains."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import os, signal, sys
import numpy as np
from toy_scenario import toy
from fusion_sfdia import scenarios
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


def read(pipe: int, size: int) -> bytes:
    """The next bytes of a pipe; none when every writer has ended."""
    assert select.select([pipe], [], [], PATIENCE)[0], "the workers neither began nor ended"
    return os.read(pipe, size)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize(
    ("sent", "code", "message"), [(signal.SIGTERM, 130, "repeat the same command"), (signal.SIGKILL, -9, "")]
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
