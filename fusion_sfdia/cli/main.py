"""The command line: list names, run scenarios, compare detectors, simulate a log, diagnose a log, inspect a plant, bench."""

from __future__ import annotations

import argparse
import atexit
import errno
import gc
import io
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout

from fusion_sfdia import __version__
from fusion_sfdia.cli.audit import add_audit
from fusion_sfdia.cli.compiling import announced
from fusion_sfdia.cli.completion import add_completion
from fusion_sfdia.cli.fmu import add_fmu
from fusion_sfdia.cli.init import add_init
from fusion_sfdia.cli.inspect import add_inspect
from fusion_sfdia.cli.listing import add_list
from fusion_sfdia.cli.logs import add_check_log, add_diagnose, add_simulate
from fusion_sfdia.cli.monitor import add_monitor
from fusion_sfdia.cli.options import OnceParser, named_detector
from fusion_sfdia.cli.papers import add_papers
from fusion_sfdia.cli.scenarios import add_compare, add_run
from fusion_sfdia.cli.signals import handled
from fusion_sfdia.cli.speed import add_bench
from fusion_sfdia.cli.tune import add_tune
from fusion_sfdia.cli.watch import add_watch
from fusion_sfdia.common.plain_text import PlainStream
from fusion_sfdia.common.references import is_reference


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = OnceParser(
        prog="fusion-sfdia",
        description="Sensor-fault detection, isolation and accommodation.",
        epilog="Exit codes: 0 done, 1 some work failed or diverged, 2 input that does not fit, 3 found what --fail-on names, "
        "128 and its number by a signal.",
        allow_abbrev=False,
    )
    top.add_argument("--version", action="version", version=f"fusion-sfdia {__version__}")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    add_list(commands)
    add_run(commands)
    add_compare(commands)
    add_simulate(commands)
    add_init(commands)
    add_check_log(commands)
    add_diagnose(commands)
    add_watch(commands)
    add_tune(commands)
    add_inspect(commands)
    add_audit(commands)
    add_papers(commands)
    add_fmu(commands)
    add_monitor(commands)
    add_bench(commands)
    add_completion(commands, top)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; return its exit code (see the parser's epilog).

    Without arguments it is that of this process, which also reports that code is compiled.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without π shows \\u03c0
            stream.reconfigure(errors="backslashreplace")
    if arguments is None:
        _collect_less()
        os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy is imported: matrices are small, threads would wait
    with redirect_stdout(PlainStream(sys.stdout)), redirect_stderr(PlainStream(sys.stderr)):
        chosen = parser().parse_args(arguments)
        with handled() as interruption:
            chosen.interruption = interruption
            silent = chosen.command in ("list", "completion") or getattr(chosen, "quiet", False)
            return _interruptible(chosen, quiet=arguments is not None or silent)


def _interruptible(chosen: argparse.Namespace, *, quiet: bool) -> int:
    """The exit code of a command, or of the signal that has ended it."""
    interruption = chosen.interruption
    try:
        with nullcontext() if quiet else announced(detector_of(chosen)):
            code = _done(chosen)
        return int(interruption.code) if interruption.number else code
    except BaseException as error:  # whatever an import or a library has made of a signal
        if not (interruption.number or isinstance(error, KeyboardInterrupt)):
            raise
        interruption.acknowledge()
        resumes = "; repeat the same command to continue" if chosen.command in ("run", "compare") else ""
        print(f"fusion-sfdia: interrupted{resumes}", file=sys.stderr)
        return int(interruption.code)


@contextmanager
def _silent(chosen: argparse.Namespace) -> Iterator[None]:
    """Nothing is printed in the block but JSON, and neither warnings nor progress; errors are, after it."""
    with redirect_stderr(io.StringIO()), nullcontext() if chosen.json else redirect_stdout(io.StringIO()):
        yield


def detector_of(chosen: argparse.Namespace) -> str | None:
    """The registered detector that a command runs; None where it runs none, or a file names it."""
    if chosen.command not in ("diagnose", "tune", "watch") or getattr(chosen, "tuned", None):
        return None
    name = named_detector(chosen)
    return None if is_reference(name) else name


def _collect_less() -> None:
    """Look for garbage seldom, and not at the end: imports make hundreds of thousands of objects that stay, and to look through
    them again and again takes a tenth of a short command.
    """
    gc.set_threshold(100_000)
    atexit.register(gc.freeze)


def _done(chosen: argparse.Namespace) -> int:
    """The exit code of a command; errors that a user can act on are a line on standard error, unless a signal caused them."""
    try:
        quiet = getattr(chosen, "quiet", False)
        with _silent(chosen) if quiet else nullcontext():
            code: int = chosen.work(chosen)
        if quiet and code == 1:
            print("fusion-sfdia: the log could not be judged, or is misread: repeat without --quiet", file=sys.stderr)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader of the output has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, ArithmeticError, OSError, RuntimeError, MemoryError, ModuleNotFoundError) as error:
        if chosen.interruption.number:
            raise
        from fusion_sfdia.common.files import explained
        from fusion_sfdia.logs.problems import LogError

        text = str(error) if isinstance(error, LogError) else " ".join(explained(error).split())
        print(f"fusion-sfdia: {text}", file=sys.stderr)
        full = getattr(error, "errno", 0) in (errno.ENOSPC, errno.EDQUOT)
        at_fault = isinstance(error, ValueError | OverflowError | OSError) and not isinstance(error, ModuleNotFoundError)
        return 2 if at_fault and not full else 1
