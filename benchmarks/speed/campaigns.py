"""bench campaigns: pieces of long campaigns, of which the whole is a known number.

- `100 runs of 2 s`: of engine/noise at one level of noise, setting up included; 2 000 runs of 100 s are 1 000 of it.
- `8 seeds of two-tanks`: a cell of `compare` at its default size, one detector on one plant.

`compare` and the papers as a whole take minutes and are timed by their own runs: manifest.json has the seconds of each piece.
"""

from __future__ import annotations

from functools import partial

from fusion_sfdia.benchmarks.engine import noise
from fusion_sfdia.benchmarks.speed.support.calls import Call, timed, timed_rows
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.comparison import compare

RUNS, DURATION, LEVEL = 100, 2.0, 0.05
SEEDS = 8
DETECTORS = ("limits", "loo-glr")


def measure(seconds: float) -> list[Row]:
    """A piece of the engine's campaign, and cells of the comparison."""
    settings = {**noise.SCENARIO.settings, "levels": (LEVEL,), "onset": DURATION / 2, "duration": DURATION}
    (task,) = noise.SCENARIO.tasks(settings, RUNS)
    piece: Call = partial(noise.SCENARIO.work, task)
    name = f"{RUNS} runs of {DURATION:g} s"
    time = timed({name: piece}, seconds)[name]
    rows = timed_rows("campaigns", "marine-engine", str(settings["detector"]), name, time)
    chosen = {**compare.SCENARIO.settings, "plants": ("two-tanks",), "detectors": DETECTORS}
    cells: dict[str, Call] = {t["detector"]: partial(compare.SCENARIO.work, t) for t in compare.SCENARIO.tasks(chosen, SEEDS)}
    for detector, cell in timed(cells, seconds).items():
        rows += timed_rows("campaigns", "two-tanks", detector, f"{SEEDS} seeds of two-tanks", cell)
    return rows
