"""Steps of long work, which a caller may wrap to show progress."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

Each = Callable[[Sequence[Any], str], Iterable[Any]]  # steps, and what they are, to the same steps


def in_silence(steps: Sequence[Any], what: str) -> Iterable[Any]:
    """The steps as they are: no progress is shown."""
    return steps
