"""Timed calls, their time and memory, their ratio to a reference that is timed with them, and the rows."""

from __future__ import annotations

import math
import statistics
import tracemalloc
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import cache, partial
from time import perf_counter
from typing import NamedTuple, TypeVar

import numpy as np

from fusion_sfdia.common.run_statistics import NOTHING
from fusion_sfdia.detectors.detector import Decision, Detector
from fusion_sfdia.detectors.state import State
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.report.results import Row, row_of
from fusion_sfdia.study.experiments.timing import turns_of

Call = Callable[[], object]
Key = TypeVar("Key", bound=Hashable)

PRODUCT, COPY = "product of 256", "copy of 64 MB"  # references
GROUPS = 5  # of turns, whose ratios show how uncertain the ratio is

SETTLED = 16  # steps before the one that is timed: the window of the likelihood ratios is full
QUIET, ALARMING = 10.0, 1e-9  # thresholds in sigma of the sensors: never crossed and always crossed


def repeated_step(
    detector: Detector, runs: int | None = None, settled: int = SETTLED, *, noise: bool = True
) -> Callable[[], tuple[State, Decision]]:
    """A call that repeats one step of the detector, on healthy readings, always from the same state after `settled` steps.

    runs: of a batch, each with noise of its own; None for a single run. noise: False for readings without it.
    """
    plant = detector.plant
    healthy = simulate(plant, settled + 1, range(1, (runs or 1) + 1), truth="model")
    of = 0 if runs is None else slice(None)
    y, u = (healthy.y if noise else healthy.signal)[:, of], healthy.u_of_runs[:, of]
    state = detector.init(() if runs is None else (runs,), float(healthy.t[0]) - plant.dt)
    for time, reading, applied in zip(healthy.t[:-1], y[:-1], u[:-1], strict=True):
        state, _ = detector.step(state, float(time), reading, applied)
    last = float(healthy.t[-1])
    return lambda: detector.step(state, last, y[-1], u[-1])


def peak_memory(call: Call) -> float:
    """Bytes that a call allocates at its peak, of what Python and NumPy allocate."""
    call()
    tracemalloc.start()
    call()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return float(peak)


@cache
def reference(name: str) -> Call:
    """A call of NumPy: the product of two matrices of 256 x 256, or copyto of 64 MB, more than processors keep in caches."""
    if name == PRODUCT:
        square = np.random.default_rng(0).standard_normal((256, 256))
        return partial(np.matmul, square, square, out=np.empty_like(square))
    source = np.ones(8_000_000)
    return partial(np.copyto, np.empty_like(source), source)


class Timed(NamedTuple):
    """Least seconds of a single call, of so many timed, and of the reference; the spread of the logarithm of their ratio."""

    best: float
    calls: int
    base: float
    spread: float
    reference: str

    @property
    def ratio(self) -> float:
        return self.best / self.base


def timed(
    calls: Mapping[Key, Call],
    seconds: float,
    of: str = PRODUCT,
    against: Call | None = None,
    clock: Callable[[], float] = perf_counter,
) -> dict[Key, Timed]:
    """Time calls, taking turns with each other and with a reference: `against`, or `reference(of)`.

    Spread: standard deviation between GROUPS of turns, each with the least times of its own.
    """
    turns = turns_of({None: against or reference(of), **calls}, seconds, clock)
    base = [min(turn) for turn in turns.pop(None)]
    return {key: _timed(each, base, of) for key, each in turns.items() if key is not None}


def _timed(turns: list[list[float]], base: list[float], of: str) -> Timed:
    own = [min(turn) for turn in turns]
    count = min(len(own), len(base))  # turns in which both were called
    groups = [slice(g, count, GROUPS) for g in range(min(GROUPS, count))]
    logs = [math.log(min(own[g]) / min(base[g])) for g in groups]
    return Timed(min(own), sum(map(len, turns)), min(base), statistics.stdev(logs), of)


def together(parts: Sequence[Timed]) -> Timed:
    """The sum of calls that were timed with one reference."""
    first, *_ = parts
    return first._replace(
        best=sum(p.best for p in parts), calls=min(p.calls for p in parts), spread=max(p.spread for p in parts)
    )


def time_row(
    part: str, plant: str, detector: str, quantity: str, metric: str, value: float, calls: int, *, condition: str = ""
) -> Row:
    """The row of a number that was found in so many calls."""
    found = NOTHING._replace(value=value, n=calls)
    return row_of(plant, f"bench/{part}", detector, "none", quantity, metric, found, condition=condition)


def timed_rows(
    part: str, plant: str, detector: str, quantity: str, time: Timed, factor: float = 1.0, *, condition: str = ""
) -> list[Row]:
    """The rows of a time and of its ratio to the reference with a 95 % interval, both times a factor."""
    wide = math.exp(1.96 * time.spread)
    ratio = factor * time.ratio
    found = NOTHING._replace(value=ratio, low=ratio / wide, high=ratio * wide, n=time.calls)
    where = ", ".join(filter(None, (condition, time.reference)))
    names = (plant, f"bench/{part}", detector, "none", quantity)
    return [
        time_row(part, plant, detector, quantity, "step_time", factor * time.best, time.calls, condition=condition),
        row_of(*names, "ratio", found, condition=where),
    ]
