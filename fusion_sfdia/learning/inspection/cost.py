"""What the model costs: the time of its step and of the Jacobian, which each reading of a stream takes, and how long a
diagnosis of a large plant takes, before a user waits for it, and what would make it faster.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from fusion_sfdia.common.rate import lasting
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.steady_gains import LARGE, can_rest, most_kept
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.learning.inspection.plant_findings import REMARK, PlantFinding
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

SLOW = 1e-3  # s for a reading
TIMES = 5
PATIENCE = 60.0  # s, from which on a user wants to know before
DAY = 86400.0  # s
AREAS = 1000  # states from which on matrices of all of them are too large for any change of readings
TRIES = 2
KEPT = 40  # bytes that a diagnosis keeps of a row, for each state and each sensor
AT_REST = 15.0  # over the number of states: of the time of a row what one takes whose gains rest (chains of 200 to 1000)


class Cost(NamedTuple):
    """Seconds of a step of one state, of its Jacobian, and of a step of n + 1 states as a batch."""

    step: float
    jacobian: float
    batch: float


def cost(plant: Plant, clock: Callable[[], float] = perf_counter) -> Cost:
    """The least of TIMES measurements each, at x0."""
    x, u, n = plant.x0, plant.input_at(0.0), len(plant.states)
    many, over = np.tile(x, (n + 1, 1)), np.tile(u, (n + 1, 1))
    calls: tuple[Callable[[], Any], ...] = (
        partial(plant.step, 0.0, x, u, plant.dt),
        partial(plant.step_jacobian_at, 0.0, x, u, plant.dt),
        partial(plant.step, 0.0, many, over, plant.dt),
    )
    return Cost(*(min(_seconds(call, clock) for _ in range(TIMES)) for call in calls))


def _seconds(call: Callable[[], Any], clock: Callable[[], float]) -> float:
    start = clock()
    call()
    return clock() - start


def of_cost(plant: Plant, found: Cost) -> Iterator[PlantFinding]:
    """That a stream or a long log will be slow, and why."""
    total = found.step + found.jacobian
    if total < SLOW:
        return
    n, given = len(plant.states), plant.jacobians[0] is not None
    if not given and found.batch > (n + 1) / 2 * found.step:
        cause = (
            f"a batch of {n + 1} states takes {found.batch / found.step:.0f} times as long as one, and a Jacobian takes "
            "a batch: write the step with operations on x (..., n), without a loop over states of the batch, or state "
            "numerics.step_jacobian"
        )
    elif given and found.jacobian > found.step:
        cause = "most of it is the Jacobian that the plant states: None in its place takes the complex step"
    else:
        cause = (
            "most of it are calls of NumPy or Python: write loops over the elements of a state as operations on "
            "arrays, or give the equations to `discretise`, which compiles them, substeps included"
        )
    yield PlantFinding(
        REMARK,
        "speed",
        f"a step takes {1e3 * found.step:.2g} ms and its Jacobian {1e3 * found.jacobian:.2g} ms, so that a stream has at most "
        f"{1 / total:.2g} rows a second; {cause}",
    )


class Waiting(NamedTuple):
    """Seconds that a row takes with the default detector, bytes of its state, and the rows of the log, or of a day."""

    row: float
    memory: int
    rows: int
    of_log: bool


def waiting(plant: Plant, log: Log | None = None, clock: Callable[[], float] = perf_counter) -> Waiting | None:
    """The least of TRIES rows after the first one; None for a plant on which nobody waits and of which there is no log."""
    if log is None and len(plant.states) + len(plant.sensors) < LARGE:
        return None
    found = registry.detector(registry.DEFAULT_DETECTOR, plant)
    state, u = found.init(), plant.input_at(0.0)
    y, took = plant.output(plant.dt, plant.x0, u), []
    for k in range(1, TRIES + 2):
        start = clock()
        state, _ = found.step(state, k * plant.dt, y, u)
        took.append(clock() - start)
    memory = sum(np.asarray(array).nbytes for array in leaves(state))
    return Waiting(min(took[1:]), memory, int(DAY / plant.dt) if log is None else len(log.t), log is not None)


def of_waiting(plant: Plant, found: Waiting | None) -> Iterator[PlantFinding]:
    """That a diagnosis will take long, or that a stream cannot keep up, and what makes it faster."""
    if found is None:
        return
    n, rests = len(plant.states), can_rest(plant)
    usual = found.row * min(AT_REST / n, 1.0) if rests else found.row
    if usual * found.rows < PATIENCE and found.row < plant.dt / 2:
        return
    rows = f"the {found.rows} rows of this log" if found.of_log else f"{found.rows} rows, a day,"
    behind = "cannot keep up" if usual >= plant.dt / 2 else "falls behind then"
    late = "" if found.row < plant.dt / 2 else f"; a stream with a row every {plant.dt:g} s {behind}"
    size = f"{n} states and {len(plant.sensors)} sensors"
    if rests:
        text = (
            f"{rows} take some {_time(usual * found.rows)} with {registry.DEFAULT_DETECTOR} and {size}, at {_time(usual)} a "
            f"row while its gains rest, as the model is linear, and {_time(found.row)} a row before, at the start and when a "
            f"sensor drops out, is isolated or is used again{late}; its state takes {_size(found.memory)}, gains up to "
            f"{_size(int(most_kept(n)))}, what it decides {_size(found.rows * KEPT * (n + len(plant.sensors)))}"
        )
    else:
        text = (
            f"{rows} take up to {_time(found.row * found.rows)} with {registry.DEFAULT_DETECTOR}, at {_time(found.row)} a row "
            f"with {size}, and {_size(found.memory)} for its state{late}; {_faster(plant)}"
        )
    yield PlantFinding(REMARK, "time", text)


def _faster(plant: Plant) -> str:
    """What makes a diagnosis faster."""
    n = len(plant.states)
    if n + len(plant.sensors) >= LARGE and _is_linear(plant):
        return (
            "step and output are linear, but the plant does not say so: state numerics.step_jacobian and "
            "numerics.output_jacobian, which return F and H, and the gains are kept once they have come to rest"
        )
    if n >= AREAS:
        return "describe parts that share few signals as plants of their own, one for each area, and diagnose each"
    return "`loo-chi2` takes less, as it has no windows, and finds small faults later"


def _is_linear(plant: Plant) -> bool:
    """Whether step and output have the same derivatives at x0 and at a point beside it, and no state has a limit."""
    u, beside = plant.input_at(0.0), plant.x0 + plant.state_scale
    same = (
        np.allclose(at(0.0, plant.x0, *given), at(0.0, beside, *given), rtol=1e-6, atol=0.0)
        for at, given in ((plant.step_jacobian_at, (u, plant.dt)), (plant.output_jacobian_at, (u,)))
    )
    return not np.any(np.isfinite(plant.state_limits)) and all(same)


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms" if seconds < 1 else lasting(seconds)


def _size(memory: int) -> str:
    return "less than 1 MB" if memory < 1e6 else f"{memory / 1e6:.3g} MB"
