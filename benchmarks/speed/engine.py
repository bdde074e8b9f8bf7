"""bench engine: step_time of all ten modules for one run of a batch, and of the bounds of the seven algebraic ones by codac.

speedup is the time of codac over that of this package for one step: of all seven calls, and of the quickest (condition
`one call`).
"""

from __future__ import annotations

from importlib.util import find_spec

from fusion_sfdia.benchmarks.speed.support.calls import time_row, timed, timed_rows, together
from fusion_sfdia.benchmarks.speed.support.engine_modules import RUNS, codac_calls, detector, step_call
from fusion_sfdia.report.results import Row

TOLERANCES = (0.1, 0.01)  # of set inversion, in noise bounds


def measure(seconds: float) -> list[Row]:
    """The engine's modules, and the bounds of its algebraic variables by codac where it is installed."""
    names = ("engine", detector().plant.name, "adaptive-threshold")
    time = timed({"ours": step_call()}, seconds)["ours"]
    one = time.best / RUNS
    rows = timed_rows(*names, "all modules", time, 1 / RUNS)
    for tolerance in TOLERANCES if find_spec("codac") else ():
        times = timed(codac_calls(tolerance), seconds)
        every, quickest = together(list(times.values())), min(times.values())
        where = f"{tolerance:g} noise bounds"
        rows += [
            *timed_rows(*names, "codac", every, condition=where),
            time_row(*names, "codac", "speedup", every.best / one, every.calls, condition=where),
            time_row(*names, "codac", "speedup", quickest.best / one, quickest.calls, condition=f"{where}, one call"),
        ]
    return rows
