"""Lines on stderr for compiled code that is not on disk yet: the first use of a plant waits for it once."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

OWN = "fusion_sfdia."


@contextmanager
def announced() -> Iterator[None]:
    """Within the block, report each module of which numba compiles something; what it loads from its cache is not compiled.

    Meanwhile no garbage is collected, which would take a fifth of the time: the compiler makes many objects, and keeps them.
    """
    from numba.core import event

    class Modules(event.Listener):  # type: ignore[misc]
        def __init__(self) -> None:
            self.told: set[str] = set()
            self.deep = 0  # one function is compiled within another

        def on_start(self, event: Any) -> None:
            self.deep += 1
            gc.disable()
            module = str(event.data["dispatcher"].py_func.__module__)
            if module not in self.told and not module.startswith("numba."):
                self.told.add(module)
                print(f"fusion-sfdia: compiling, once: {module.removeprefix(OWN)}", file=sys.stderr, flush=True)

        def on_end(self, event: Any) -> None:
            self.deep -= 1
            if not self.deep:
                gc.enable()

    with event.install_listener("numba:compile", Modules()):
        yield
