"""How long a diagnosis of a large plant takes, before a user waits for it, and what would make it faster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from time import perf_counter
from typing import NamedTuple

import numpy as np

from fusion_sfdia.common.rate import lasting
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.steady_gains import LARGE, SETTLED, can_rest, most_kept
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.learning.inspection.plant_findings import REMARK, PlantFinding
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

PATIENCE = 60.0  # s, from which on a user wants to know before
DAY = 86400.0  # s
AREAS = 1000  # states from which on matrices of all of them are too large for any change of readings
TIMES = 2


class Waiting(NamedTuple):
    """Seconds that a row takes with the default detector, bytes of its state, and the rows of the log, or of a day."""

    row: float
    memory: int
    rows: int
    of_log: bool


def waiting(plant: Plant, log: Log | None = None, clock: Callable[[], float] = perf_counter) -> Waiting | None:
    """The least of TIMES rows after the first one; None for a plant on which nobody waits and of which there is no log."""
    if log is None and len(plant.states) + len(plant.sensors) < LARGE:
        return None
    found = registry.detector(registry.DEFAULT_DETECTOR, plant)
    state, u = found.init(), plant.input_at(0.0)
    y, took = plant.output(plant.dt, plant.x0, u), []
    for k in range(1, TIMES + 2):
        start = clock()
        state, _ = found.step(state, k * plant.dt, y, u)
        took.append(clock() - start)
    memory = sum(np.asarray(array).nbytes for array in leaves(state))
    return Waiting(min(took[1:]), memory, int(DAY / plant.dt) if log is None else len(log.t), log is not None)


def of_waiting(plant: Plant, found: Waiting | None) -> Iterator[PlantFinding]:
    """That a diagnosis will take long, or that a stream cannot keep up, and what makes it faster."""
    if found is None or (found.row * found.rows < PATIENCE and found.row < plant.dt / 2):
        return
    rows = f"the {found.rows} rows of this log" if found.of_log else f"{found.rows} rows, a day,"
    late = "" if found.row < plant.dt / 2 else f"; a stream with a row every {plant.dt:g} s cannot keep up"
    yield PlantFinding(
        REMARK,
        "time",
        f"{rows} take up to {_time(found.row * found.rows)} with {registry.DEFAULT_DETECTOR}, at {_time(found.row)} a row with "
        f"{len(plant.states)} states and {len(plant.sensors)} sensors, and {_size(found.memory)} for its state{late}; "
        f"{_faster(plant)}",
    )


def _faster(plant: Plant) -> str:
    """What makes a diagnosis faster."""
    n = len(plant.states)
    if can_rest(plant):
        return (
            f"they take less once the same sensors have been read for {SETTLED} rows and more, as the model is linear and its "
            "gains come to rest; gains are computed again whenever a sensor drops out or is isolated, and those that are kept "
            f"take up to {_size(int(most_kept(n)))}"
        )
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
