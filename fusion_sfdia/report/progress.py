"""Progress on standard error, where that is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from fusion_sfdia.core.plain_text import acting

T = TypeVar("T")


def progress(steps: Iterable[T], what: str = "diagnosing", count: int | None = None) -> Iterable[T]:
    """The steps, with a bar and the time left while they last; count: how many there are, where they have no length."""
    if not sys.stderr.isatty():
        return steps
    from rich.console import Console
    from rich.progress import track

    console = Console(file=acting(sys.stderr))  # which may be told that a terminal is none
    return track(steps, what, count, console=console, transient=True) if console.is_terminal else steps


@contextmanager
def working(what: str) -> Iterator[None]:
    """While work of unknown length lasts, a moving bar and the time that has passed."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(file=acting(sys.stderr))
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        bar.add_task(what, total=None)
        yield
