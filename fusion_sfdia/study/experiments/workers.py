"""Pieces of work on all cores, each kept on disk as soon as it is done.

Every piece runs with one thread for linear algebra, in this process or in another, so that its bits do not depend on the
number of workers.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple, TypeVar

from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import BrokenProcessPool
from scipy import linalg  # noqa: F401  # its linear algebra is limited to one thread too, once it is loaded
from threadpoolctl import threadpool_limits

from fusion_sfdia.derivatives.equation import AsPython
from fusion_sfdia.study.experiments.parts import write_part
from fusion_sfdia.study.experiments.scenario import Arrays, Task

T = TypeVar("T")
R = TypeVar("R")


class Piece(NamedTuple):
    """A piece of work to do, and the file for its arrays."""

    path: Path
    work: Callable[[Task], Arrays]
    task: Task


class Done(NamedTuple):
    """A piece that was done, or the error that ended it, and the seconds it took."""

    path: Path
    seconds: float
    error: str | None


def work_off(pieces: Sequence[Piece], workers: int) -> Iterator[Done]:
    """Do the pieces in at most `workers` processes and yield each when it is done, in any order.

    Raises RuntimeError where a process is killed.
    """
    return in_processes(_do, pieces, workers)


def in_processes(function: Callable[[T], R], of: Sequence[T], workers: int) -> Iterator[R]:
    """The function of each in at most `workers` processes, as they are done, in any order; RuntimeError where one is killed."""
    # one that has grown by 300 MB, of which much is kept for the next piece, is replaced between two pieces: nothing is lost
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
    parallel = Parallel(n_jobs=min(workers, max(len(of), 1)), return_as="generator_unordered", batch_size=1, max_nbytes=None)
    try:
        yield from parallel(delayed(_followed)(function, one, os.getpid()) for one in of)
    except BrokenProcessPool as error:
        raise RuntimeError(
            "a worker process was killed, usually for lack of memory; finished pieces are kept: run the same command "
            f"again with fewer workers than {workers}"
        ) from error


def _followed(function: Callable[[T], R], of: T, parent: int) -> R:
    AsPython.patient = False  # long work is compiled at once
    if os.getpid() != parent:
        _follow(parent)
    return function(of)


def _do(piece: Piece) -> Done:
    """One piece, where it is run; its arrays go to disk and an error is reported, not raised."""
    arrays, seconds, error = timed(piece.work, piece.task)
    if error is None:
        try:
            write_part(piece.path, arrays)
        except Exception as problem:
            error = f"{type(problem).__name__}: {problem}"
    return Done(piece.path, seconds, error)


def timed(work: Callable[[Task], Arrays], task: Task) -> tuple[Arrays, float, str | None]:
    """Return the arrays of a piece of work, the seconds it took, and the error that ended it, which is not raised."""
    start = time.perf_counter()
    arrays: Arrays = {}
    error = None
    try:
        with threadpool_limits(1):
            arrays = work(task)
    except Exception as problem:
        error = f"{type(problem).__name__}: {problem}"
    return arrays, time.perf_counter() - start, error


@cache
def _follow(parent: int) -> None:
    """In a worker, once: leave Ctrl-C to the parent, and end when the parent has ended, even if it could not send a signal."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
