"""bench roofline: what a step of each detector computes at least, and the least time for it on this machine.

Each detector is stepped on each plant on which it applies, with thresholds that nothing reaches, in a batch of healthy runs
after SETTLED samples. Its arithmetic is counted (`support.arithmetic`) with 2 and with 4 runs: the difference is what a run
costs, the rest what all runs share. The rates of the machine are measured in the same run: products of matrices of 256 x 256,
and polynomials of numbers that stay in the first cache, in double and in single precision, and copies of 64 MB.

As in a roofline (Williams, Waterman and Patterson 2009) the least time is the larger one of all arithmetic at these rates, and
of the state, once read and once written, at the rate of copies. It bounds the operations as they are, not the diagnosis: fewer
operations may do the same. A state that stays in a cache may take less than its time. New arrays do not count, as they may stay
in a cache, too.

step_time: `batch of 32`, a run's share of a measured step; `least`, the least time, and as conditions its parts. `ratio`: of
the measured time to the product of 256, and to the least time. With the detector `none`: least seconds of each kind of work.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.speed.support.arithmetic import arithmetic
from fusion_sfdia.benchmarks.speed.support.calls import COPY, Call, reference, repeated_step, time_row, timed, timed_rows
from fusion_sfdia.benchmarks.speed.support.processes import printed
from fusion_sfdia.common.alike import single
from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.derivatives.equation import compiled
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.silent import silent
from fusion_sfdia.detectors.state import State, leaves
from fusion_sfdia.report.results import Row

Array = NDArray[Any]

RUNS, FEW, MANY = 32, 2, 4
PART = 0.1  # of the seconds: of each detector
SIZE, COPIED = 256, 2 * 64e6  # of the references: rows and columns of the product; bytes that a copy reads and writes
NUMBERS, REPEATS = 1024, 100  # of polynomials in the first cache, and how often
LEAST = "least time"
COMMAND = (
    "import json, sys; from fusion_sfdia.benchmarks.speed.support.arithmetic import install; install(); "
    "from fusion_sfdia.benchmarks.speed.roofline import print_work; print_work(*json.loads(sys.argv[1]))"
)


class Work(NamedTuple):
    """Multiply-adds of matrices, other operations, and bytes of state that are read and written."""

    products: float
    single_products: float
    operations: float
    single_operations: float
    state: float


class Least(NamedTuple):
    """Least seconds of work."""

    products: float
    operations: float
    state: float

    @property
    def all(self) -> float:
        return max(self.products + self.operations, self.state)


@compiled
def polynomials(x: Array, y: Array, repeats: int) -> None:
    """Eight multiply-adds a number, read and written once, so many times."""
    for _ in range(repeats):
        for i in range(x.size):
            v = x[i]
            y[i] = (((((((v * v + v) * v + v) * v + v) * v + v) * v + v) * v + v) * v + v) * v + v


def rates(seconds: float) -> Work:
    """Least seconds on this machine of each kind of work."""
    square = np.full((SIZE, SIZE), 0.5, np.float32)
    double, short = np.full(NUMBERS, 0.5), np.full(NUMBERS, 0.5, np.float32)
    calls: dict[str, Call] = {
        "single_products": partial(np.matmul, square, square, out=np.empty_like(square)),
        "operations": partial(polynomials, double, np.empty_like(double), REPEATS),
        "single_operations": partial(polynomials, short, np.empty_like(short), REPEATS),
        "state": reference(COPY),
    }
    times = timed(calls, seconds)  # the reference is the product in double precision
    best = {"products": times["state"].base} | {what: time.best for what, time in times.items()}
    amount = Work(SIZE**3, SIZE**3, 16 * NUMBERS * REPEATS, 16 * NUMBERS * REPEATS, COPIED)
    return Work(**{what: best[what] / of for what, of in amount._asdict().items()})


def least(work: Work, rate: Work) -> Least:
    """The least seconds of work at rates (seconds of each kind)."""
    product, single_product, operation, single_operation, state = np.multiply(work, rate)
    return Least(product + single_product, operation + single_operation, state)


def pairs(plants: list[str], detectors: list[str]) -> Iterator[tuple[str, str, Detector]]:
    """Detectors with thresholds that nothing reaches, on the plants on which they apply."""
    for plant in plants:
        built = registry.plant(plant)
        for name in detectors:
            try:
                yield plant, name, silent(registry.detector(name, built))
            except NotApplicableError:
                continue


def moved(state: State) -> float:
    """Bytes of a state that are read and written; what all runs share, once."""
    return 2.0 * sum(single(a).nbytes for a in leaves(state))


def work_of(detector: Detector) -> tuple[Work, Work]:
    """What all runs of a batch share in a step, and what each adds, in a process in which `install` was called."""
    found = []
    for runs in (FEW, MANY):
        call = repeated_step(detector, runs)
        found.append(np.array([*arithmetic(call), moved(call()[0])]))
    own = (found[1] - found[0]) / (MANY - FEW)
    return Work(*np.maximum(found[0] - FEW * own, 0.0).tolist()), Work(*own.tolist())


def print_work(plants: list[str], detectors: list[str]) -> None:
    """Print what all runs share and what each adds, of all pairs that apply, as JSON."""
    print(json.dumps([(plant, name, *work_of(detector)) for plant, name, detector in pairs(plants, detectors)]))


def counted_work(plants: list[str], detectors: list[str]) -> dict[tuple[str, str], tuple[Work, Work]]:
    """What all runs share and what each adds, by plant and detector, counted in a process of its own."""
    found = printed(COMMAND, json.dumps([plants, detectors]))
    return {(plant, name): (Work(*shared), Work(*own)) for plant, name, shared, own in found}


def measure(seconds: float) -> list[Row]:
    """All registered detectors but slow references on all plants on which they apply; a tenth of the seconds for each."""
    plants = list(registry.plants())
    detectors = [name for name, entry in registry.detectors().items() if not entry.reference]
    work, rate, rows = counted_work(plants, detectors), rates(seconds), []
    for what, value in rate._asdict().items():
        rows.append(time_row("roofline", "-", "none", LEAST, "step_time", value, 1, condition=what))
    for plant, name, detector in pairs(plants, detectors):
        shared, own = work[plant, name]
        bound = least(Work(*(np.array(shared) / RUNS + own)), rate)
        time = timed({"step": repeated_step(detector, RUNS)}, PART * seconds)["step"]
        rows += timed_rows("roofline", plant, name, f"batch of {RUNS}", time, 1 / RUNS)
        over_least = time._replace(base=RUNS * bound.all, reference=LEAST)
        rows += timed_rows("roofline", plant, name, f"batch of {RUNS}", over_least)[1:]
        for what, value in {"": bound.all, **bound._asdict()}.items():
            rows.append(time_row("roofline", plant, name, "least", "step_time", value, 1, condition=what))
    return rows
