"""Time and memory of a step of the robust banks of a network's areas."""

from __future__ import annotations

import tracemalloc
from functools import partial
from itertools import pairwise
from time import thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.kalman_banks.area_banks import RobustAreas
from fusion_sfdia.detectors.kalman_banks.hypotheses import SLOW_STEP
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.models.power_network.area_plant import local_areas
from fusion_sfdia.models.power_network.model import NetworkModel
from fusion_sfdia.models.power_network.simulation import run_network
from fusion_sfdia.study.experiments.scenario import Arrays
from fusion_sfdia.study.experiments.timing import best_times

Array = NDArray[Any]

TIMED = 6 * SLOW_STEP  # the step that is timed, in which both windows of onsets take a new one: it takes longest


def robust_step(model: NetworkModel, seconds: float) -> Arrays:
    """One core: processor time of a healthy step of the robust banks, and of the model; bytes () of the step."""
    areas = len(model.names)
    banks = RobustAreas(local_areas(model))
    *before, last = list(run_network(model, TIMED - 1, (0,), loads=partial(no_loads, areas)))
    state = banks.init((1,), -model.dt)
    for s in before:
        state, _ = banks.step(state, s.t, s.y, s.u)
    step = partial(banks.step, state, last.t, last.y, last.u)
    ahead = partial(model.step, last.x, last.reference, np.broadcast_to(last.load, last.reference.shape))
    times = best_times({"step": step, "model": ahead}, seconds, thread_time)
    tracemalloc.start()
    step()
    _, more = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    kept = sum(a.nbytes for each in state for a in leaves(each))
    return {"bytes": np.array(kept + more), **{name: np.array(time, dtype=float) for name, time in times.items()}}


def no_loads(areas: int, t: float) -> Array:
    """The loads (N,) of a network at its operating point."""
    return np.zeros(areas)


def growth(found: dict[int, Arrays]) -> str:
    """How the time of a step grows with the number of areas, and what it is beside a step of the model; "" for no size."""
    if not found:
        return ""
    sizes, largest = sorted(found), max(found)
    step = {n: float(found[n]["step"][0]) for n in sizes}
    exponents = [f"{np.log(step[b] / step[a]) / np.log(b / a):.2f} from {a} to {b} areas" for a, b in pairwise(sizes)]
    of_model = float(found[largest]["model"][0])
    return " ".join(
        [
            f"A step of the robust banks of {largest} areas takes {1e3 * step[largest]:.3g} ms of processor time, "
            f"{1e6 * step[largest] / largest:.3g} us an area, {step[largest] / of_model:.2g} times a step of the model.",
            *([f"It grows with the power {', '.join(exponents)}: 1 is linear."] if exponents else []),
        ]
    )
