"""Compiled code that is not on disk yet: lines on stderr, and a second process that compiles the detector's meanwhile."""

from __future__ import annotations

import gc
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from fusion_sfdia.study.experiments.provenance import cores

OWN = "fusion_sfdia."
MANY = 16  # sensors, with which the code for large plants is compiled: of small ones it is the plant that takes long


@contextmanager
def announced(detector: str | None = None) -> Iterator[None]:
    """Within the block, report each module of which numba compiles something; what it loads from its cache is not compiled.

    detector: the name of one that will be needed. Once something is compiled, usually of the plant, another process compiles
    that detector's part, if there are two cores, and a cache on disk through which this process gets it; where nothing is
    compiled yet, from the beginning. Meanwhile no garbage is collected, which would take a fifth of the time: the compiler
    makes many objects, and keeps them.
    """
    helper = started(detector) if detector and cores() > 1 and nothing_compiled() else None
    from numba.core import event

    class CompiledModules(event.Listener):  # type: ignore[misc]
        def __init__(self) -> None:
            self.announced: set[str] = set()
            self.deep = 0  # one function is compiled within another
            self.helper = helper

        def on_start(self, event: Any) -> None:
            self.deep += 1
            gc.disable()
            dispatcher = event.data["dispatcher"]
            module = str(dispatcher.py_func.__module__)
            if module not in self.announced and not module.startswith("numba."):
                self.announced.add(module)
                print(f"fusion-sfdia: compiling, once: {module.removeprefix(OWN)}", file=sys.stderr, flush=True)
            if detector and not self.helper and dispatcher.stats.cache_path and cores() > 1:
                self.helper = started(detector)

        def on_end(self, event: Any) -> None:
            self.deep -= 1
            if not self.deep:
                gc.enable()

    modules = CompiledModules()
    try:
        with event.install_listener("numba:compile", modules):
            yield
    finally:
        if modules.helper:
            modules.helper.terminate()
            modules.helper.join()


def started(detector: str) -> Any:
    """A process that compiles what a registered detector calls."""
    helper = get_context("spawn").Process(target=compile_detector, args=(detector,), daemon=True)
    helper.start()
    return helper


def nothing_compiled() -> bool:
    """Whether compiled code will be kept beside the modules, or in the folder set for it, and none is there yet."""
    own, beside = os.environ.get("NUMBA_CACHE_DIR"), Path(__file__).parents[1] / "plant"  # every diagnosis compiles some of it
    return bool(own or os.access(beside, os.W_OK)) and not any(Path(own or beside).glob("**/*.nbi"))


def compile_detector(name: str) -> None:
    """Compile what a registered detector calls in a step, by one on a plant that is not compiled; in a process of its own.

    What takes longest is compiled first, of what takes as long what the step calls last: the command, which compiles what it
    lacks in the order of the calls, then finds most of it done, and both seldom compile the same.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    gc.disable()
    import numpy as np

    from fusion_sfdia.detectors import registry
    from fusion_sfdia.plant.linear import linear_plant
    from fusion_sfdia.plant.signals import Sensor

    one = np.eye(MANY)
    sensors = [Sensor(f"y_{i}", f"x_{i}", "1", sigma=1.0) for i in range(MANY)]
    covariance = np.ones(MANY)
    plant = linear_plant(
        "stand-in", one / 2, one, sensors, dt=1.0, x0=0 * covariance, initial_cov=covariance, process_cov=covariance
    )
    with warnings.catch_warnings(), suppress(Exception):  # one that does not apply to this plant; the command reports the rest
        warnings.simplefilter("ignore")
        detector = registry.detector(name, plant)
        with postponed() as wanted:
            detector.step(detector.init((), 0.0), 1.0, np.zeros(MANY), np.zeros(0))
        for function, signature in sorted(reversed(wanted), key=lambda one: -length(one[0])):
            if function.stats.cache_path:  # the others become part of these
                function.compile(signature)


def length(function: Any) -> int:
    """Bytes of Python of a compiled function and of those that it calls: the more, the longer it takes to compile."""
    code, known = function.py_func.__code__, function.py_func.__globals__
    called = [known[name] for name in code.co_names if hasattr(known.get(name), "py_func")]
    return len(code.co_code) + sum(length(one) for one in called)


@contextmanager
def postponed() -> Iterator[dict[tuple[Any, Any], None]]:
    """Within the block nothing is compiled, functions run as Python; what would have been, in order: function, signature."""
    from numba.core import dispatcher

    kind: Any = dispatcher.Dispatcher
    wanted: dict[tuple[Any, Any], None] = {}

    def run_as_python(function: Any, signature: Any) -> Any:
        wanted[function, signature] = None
        return function.py_func

    compiler, kind.compile = kind.compile, run_as_python
    try:
        yield wanted
    finally:
        kind.compile = compiler
