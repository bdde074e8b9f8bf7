"""Progress on standard error, where that is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from fusion_sfdia.common.plain_text import acting

T = TypeVar("T")


def progress(steps: Iterable[T], what: str = "diagnosing", count: int | None = None) -> Iterable[T]:
    """The steps, with a bar and the time left while they last; count: how many there are, where they have no length."""
    if (console := _terminal()) is None:
        return steps
    from rich.progress import track

    return track(steps, what, count, console=console, transient=True)


@contextmanager
def working(what: str) -> Iterator[None]:
    """While work of unknown length lasts, a moving bar and the time that has passed."""
    if (console := _terminal()) is None:
        yield
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    with Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=console, transient=True) as bar:
        bar.add_task(what, total=None)
        yield


def _terminal() -> Any:
    """The console of standard error, None where that is no terminal or is set to be none."""
    if not sys.stderr.isatty():
        return None
    from rich.console import Console

    console = Console(file=acting(sys.stderr))
    return console if console.is_terminal else None
