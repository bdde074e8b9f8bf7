"""bench engine: step_time of all ten modules for one run of a batch, and of the bounds of the seven algebraic ones by codac.

speedup is the time of codac over that of this package for one step: of all seven calls, and of the quickest (condition
`one call`).
"""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec

from fusion_sfdia.benchmarks.speed.support.calls import time_row
from fusion_sfdia.benchmarks.speed.support.engine_modules import RUNS, codac_calls, detector, step_call
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.experiments.timing import Timing, best_times

TOLERANCES = (0.1, 0.01)  # of set inversion, in noise bounds


def measure(seconds: float) -> list[Row]:
    """The engine's modules, and the bounds of its algebraic variables by codac where it is installed."""
    row = partial(time_row, "engine", detector().plant, "adaptive-threshold")
    time = best_times({"ours": step_call()}, seconds)["ours"]
    one = time.best / RUNS
    rows = [row("all modules", "step_time", time, 1 / RUNS)]
    for tolerance in TOLERANCES if find_spec("codac") else ():
        times = best_times(codac_calls(tolerance), seconds)
        every = Timing(sum(t.best for t in times.values()), min(t.calls for t in times.values()))
        where = f"{tolerance:g} noise bounds"
        rows += [
            row("codac", "step_time", every, condition=where),
            row("codac", "speedup", every, 1 / one, condition=where),
            row("codac", "speedup", min(times.values()), 1 / one, condition=f"{where}, one call"),
        ]
    return rows
