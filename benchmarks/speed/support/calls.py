"""Timed calls, their time and memory, and the rows."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

from fusion_sfdia.core.detector import Detector
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.metrics import NOTHING
from fusion_sfdia.evaluation.results import Row, row_of
from fusion_sfdia.evaluation.simulate import simulate
from fusion_sfdia.experiments.timing import Timing

Call = Callable[[], object]

SETTLED = 16  # steps before the one that is timed: the window of the likelihood ratios is full
QUIET, ALARMING = 10.0, 1e-9  # thresholds in sigma of the sensors: never crossed and always crossed


def repeated_step(detector: Detector) -> Call:
    """A call that repeats one step of the detector, on healthy readings, always from the same settled state."""
    plant = detector.plant
    healthy = simulate(plant, SETTLED + 1, [1], truth="model")
    y, u = healthy.y[:, 0], healthy.u_of_runs[:, 0]
    state = detector.init((), float(healthy.t[0]) - plant.dt)
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


def time_row(
    part: str,
    plant: Plant,
    detector: str,
    quantity: str,
    metric: str,
    time: Timing,
    factor: float = 1.0,
    *,
    condition: str = "",
) -> Row:
    """The row of a time, or of a number in its place, times a factor."""
    found = NOTHING._replace(value=time.best * factor, n=time.calls)
    return row_of(plant.name, f"bench/{part}", detector, "none", quantity, metric, found, condition=condition)
