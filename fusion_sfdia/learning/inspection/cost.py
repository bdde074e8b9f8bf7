"""What the model costs: the time of its step and of the Jacobian, which each reading of a stream takes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from fusion_sfdia.learning.inspection.plant_findings import REMARK, PlantFinding
from fusion_sfdia.plant.plant import Plant

SLOW = 1e-3  # s for a reading
TIMES = 5


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
