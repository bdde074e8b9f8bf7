"""bench lorenz: step_time of single filters on Lorenz-96 with 63 states, of this package and of filterpy, and their ratio."""

from __future__ import annotations

from fusion_sfdia.benchmarks.speed.support.calls import time_row, timed, timed_rows
from fusion_sfdia.benchmarks.speed.support.lorenz_96 import MODELS, lorenz_96, pairs
from fusion_sfdia.report.results import Row


def measure(seconds: float) -> list[Row]:
    """Single filters on Lorenz-96, by the source of its right-hand side as condition."""
    rows = []
    for source in MODELS:
        plant = lorenz_96(source)
        for kind in ("kf", "ukf", "enkf"):
            ours, theirs = pairs(kind, source)
            times = timed({"ours": ours, "filterpy": theirs}, seconds)
            for q, time in times.items():
                rows += timed_rows("lorenz", plant.name, kind, q, time, condition=source)
            faster, calls = times["filterpy"].best / times["ours"].best, times["filterpy"].calls
            rows.append(time_row("lorenz", plant.name, kind, "filterpy", "speedup", faster, calls, condition=source))
    return rows
