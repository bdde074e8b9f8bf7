"""Compiled code that is not on disk yet: lines on stderr, and a second process that compiles the detector's meanwhile."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from time import thread_time
from typing import Any

from fusion_sfdia.study.experiments.provenance import cores

OWN = "fusion_sfdia."
MANY, FEW = 40, 4  # sensors with which the code for large plants is compiled, and then what small ones need beside


@contextmanager
def announced(detector: str | None = None) -> Iterator[None]:
    """Within the block, report each module of which numba compiles something; what it loads from its cache is not compiled.

    detector: the name of one that will be needed. Once something is compiled, usually of the plant, another process compiles
    that detector's part, if there are two cores, and a cache on disk through which this process gets it; where nothing is
    compiled yet, from the beginning. Meanwhile no garbage is collected, which would take a fifth of the time: the compiler
    makes many objects, and keeps them.
    """
    begin = cache(lambda: start(detector) if detector and cores() > 1 else None)  # once
    if detector and nothing_compiled():
        begin()
    from numba.core import event

    class CompiledModules(event.Listener):  # type: ignore[misc]
        def __init__(self) -> None:
            self.announced: set[str] = set()
            self.deep = 0  # one function is compiled within another

        def on_start(self, event: Any) -> None:
            self.deep += 1
            gc.disable()
            dispatcher = event.data["dispatcher"]
            module = str(dispatcher.py_func.__module__)
            if module not in self.announced and not module.startswith("numba."):
                self.announced.add(module)
                print(f"fusion-sfdia: compiling, once: {module.removeprefix(OWN)}", file=sys.stderr, flush=True)
            if dispatcher.stats.cache_path:
                begin()

        def on_end(self, event: Any) -> None:
            self.deep -= 1
            if not self.deep:
                gc.enable()

    with event.install_listener("numba:compile", CompiledModules()):
        yield


def start(detector: str) -> None:
    """Start a process that compiles what a registered detector calls; it may end some seconds after this one."""
    code = f"from fusion_sfdia.cli.compiling import compile_detector; compile_detector({detector!r})"
    paths = os.pathsep.join(path for path in sys.path if path)
    with suppress(OSError):
        subprocess.Popen(
            (sys.executable, "-P", "-c", code),
            env={**os.environ, "PYTHONPATH": paths},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )


def nothing_compiled() -> bool:
    """Whether compiled code will be kept, and none is there yet."""
    from fusion_sfdia.common.files import compiled_code_folder

    named = os.environ.get("NUMBA_CACHE_DIR")
    kept = Path(named) if named else compiled_code_folder() or Path(__file__).parents[1] / "plant"  # always needed
    return (not kept.exists() or os.access(kept, os.W_OK)) and not any(kept.glob("**/*.nbi"))


def compile_detector(name: str) -> None:
    """Compile what a registered detector calls in a step, by steps on plants that are not compiled; in a process of its own.

    First what takes longest to compile, of what takes as long what the step calls last: the command, which compiles what it
    lacks in the order of the calls, then finds most of it done, and both seldom compile the same. Then what can run as Python
    meanwhile, first what takes longest so, of what takes as long to compile.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    gc.disable()
    import numpy as np

    from fusion_sfdia.derivatives.equation import AsPython
    from fusion_sfdia.detectors import registry
    from fusion_sfdia.plant.linear import linear_plant
    from fusion_sfdia.plant.signals import Sensor

    AsPython.patient = False
    for many in (MANY, FEW):
        one, covariance = np.eye(many), np.ones(many)
        sensors = [Sensor(f"y_{i}", f"x_{i}", "1", sigma=1.0) for i in range(many)]
        plant = linear_plant(
            "stand-in", one / 2, one, sensors, dt=1.0, x0=0 * covariance, initial_cov=covariance, process_cov=covariance
        )
        with warnings.catch_warnings(), suppress(Exception):  # one that does not apply to it; the command reports the rest
            warnings.simplefilter("ignore")
            detector = registry.detector(name, plant)
            with postponed() as wanted:
                detector.step(detector.init((), 0.0), 1.0, np.zeros(many), np.zeros(0))
            longest = {of: seconds / length(of[0]) if waits(of[0]) else length(of[0]) for of, seconds in wanted.items()}
            for function, signature in sorted(reversed(wanted), key=lambda of: (waits(of[0]), -longest[of])):
                if function.stats.cache_path:  # the others become part of these
                    function.compile(signature)


def waits(function: Any) -> bool:
    """Whether a function runs as Python until it is compiled."""
    from fusion_sfdia.derivatives.equation import AsPython

    return isinstance(function._compile_for_args, AsPython)


def length(function: Any) -> int:
    """Bytes of Python of a compiled function and of those that it calls: the more, the longer it takes to compile."""
    code, known = function.py_func.__code__, function.py_func.__globals__
    called = [known[name] for name in code.co_names if hasattr(known.get(name), "py_func")]
    return len(code.co_code) + sum(length(one) for one in called)


@contextmanager
def postponed() -> Iterator[dict[tuple[Any, Any], float]]:
    """Within the block nothing is compiled; what would have been, in order: function and signature, its seconds as Python."""
    from numba.core import dispatcher

    kind: Any = dispatcher.Dispatcher
    wanted: dict[tuple[Any, Any], float] = {}

    def run_as_python(function: Any, signature: Any) -> Any:
        def timed(*args: Any) -> Any:
            start = thread_time()
            found = function.py_func(*args)
            wanted[function, signature] = thread_time() - start
            return found

        return timed

    compiler, kind.compile = kind.compile, run_as_python
    try:
        yield wanted
    finally:
        kind.compile = compiler
