"""Processes of their own: seconds on the clock and the largest memory of commands, and what a piece of Python prints."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import fusion_sfdia

PACKAGE = str(Path(fusion_sfdia.__path__[0]).parent)
LAUNCHER = """
import json, resource, subprocess, sys, time
start = time.perf_counter()
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
seconds = time.perf_counter() - start
most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
print(json.dumps([done.returncode, seconds, most]))
"""  # a small process: the memory of one that starts another counts as that of the other, too


class Process(NamedTuple):
    """Seconds that a process took, and its largest resident memory in bytes."""

    seconds: float
    memory: float


def timed_process(arguments: Sequence[str], variables: Mapping[str, str] | None = None) -> Process:
    """Run Python with arguments to its end, its output left out; RuntimeError with what it printed where it fails.

    variables: of the environment, beside those of this process; the package is that of this process.
    """
    paths = os.pathsep.join((PACKAGE, os.environ.get("PYTHONPATH", ""))).strip(os.pathsep)
    done = subprocess.run(
        [sys.executable, "-c", LAUNCHER, sys.executable, *arguments],
        env={**os.environ, "PYTHONPATH": paths, **(variables or {})},
        capture_output=True,
        text=True,
        check=True,
    )
    code, seconds, memory = json.loads(done.stdout)
    if code:
        raise RuntimeError(f"{' '.join(arguments)} ended with {code}: {done.stderr.strip()[-500:]}")
    return Process(seconds, float(memory))


def printed(code: str, *arguments: str) -> Any:
    """What Python code prints as JSON, given arguments (sys.argv[1:]); CalledProcessError where it fails."""
    return json.loads(subprocess.run((sys.executable, "-c", code, *arguments), stdout=subprocess.PIPE, check=True).stdout)


def command(*arguments: str) -> list[str]:
    """The arguments of Python for a command of fusion-sfdia."""
    return ["-m", "fusion_sfdia", *arguments]
