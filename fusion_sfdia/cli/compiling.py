"""A line on stderr when compiled code is not on disk yet: the first use of a plant waits for it once."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def announced() -> Iterator[None]:
    """Within the block, report the first function that numba compiles; what it loads from its cache is not compiled."""
    from numba.core import event

    class Once(event.Listener):  # type: ignore[misc]
        def __init__(self) -> None:
            self.done = False

        def on_start(self, event: Any) -> None:
            if not self.done:
                self.done = True
                print("fusion-sfdia: compiling, once (up to a minute)", file=sys.stderr, flush=True)

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Once()):
        yield
