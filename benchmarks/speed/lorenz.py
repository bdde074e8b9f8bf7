"""bench lorenz: step_time of single filters on Lorenz-96 with 63 states, of this package and of filterpy, and their ratio."""

from __future__ import annotations

from fusion_sfdia.benchmarks.speed.support.calls import time_row
from fusion_sfdia.benchmarks.speed.support.lorenz_96 import MODELS, lorenz_96, pairs
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.experiments.timing import best_times


def measure(seconds: float) -> list[Row]:
    """Single filters on Lorenz-96, by the source of its right-hand side as condition."""
    rows = []
    for source in MODELS:
        plant = lorenz_96(source)
        for kind in ("kf", "ukf", "enkf"):
            ours, theirs = pairs(kind, source)
            times = best_times({"ours": ours, "filterpy": theirs}, seconds)
            rows += [time_row("lorenz", plant, kind, q, "step_time", time, condition=source) for q, time in times.items()]
            ratio = 1 / times["ours"].best
            rows.append(time_row("lorenz", plant, kind, "filterpy", "speedup", times["filterpy"], ratio, condition=source))
    return rows
