"""Commands of the package in processes of their own: seconds on the clock and the largest memory."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import fusion_sfdia

PACKAGE = str(Path(fusion_sfdia.__path__[0]).parent)
KILOBYTES = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss


class Process(NamedTuple):
    """Seconds that a process took, and its largest resident memory in bytes."""

    seconds: float
    memory: float


def timed_process(arguments: Sequence[str], variables: Mapping[str, str] | None = None) -> Process:
    """Run Python with arguments to its end, its output left out; RuntimeError with what it printed where it fails.

    variables: of the environment, beside those of this process; the package is that of this process.
    """
    paths = os.pathsep.join((PACKAGE, os.environ.get("PYTHONPATH", ""))).strip(os.pathsep)
    start = perf_counter()
    with subprocess.Popen(
        [sys.executable, *arguments],
        env={**os.environ, "PYTHONPATH": paths, **(variables or {})},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stderr is not None
        printed = process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        seconds = perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(arguments)} ended with {process.returncode}: {printed.decode().strip()[-500:]}")
    return Process(seconds, float(usage.ru_maxrss * KILOBYTES))


def command(*arguments: str) -> list[str]:
    """The arguments of Python for a command of fusion-sfdia."""
    return ["-m", "fusion_sfdia", *arguments]
