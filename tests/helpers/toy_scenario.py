"""A scenario for tests: means of random numbers, with traps that break off the work."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.report.content import Chapter, Figure, ResultTable, Summary
from fusion_sfdia.report.plots import panels, time_series
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task, seed_blocks

NASTY = '<script>alert(1)</script> & "quotes" -->'


def tasks(settings: Settings, seeds: int) -> list[Task]:
    if settings["size"] < 1:
        raise ValueError(f"size is {settings['size']}; expected at least 1")
    return [
        {
            "size": settings["size"],
            "trap": settings["trap"],
            "detector": detector,
            "quantity": ["flow", "level"],
            "seeds": block,
        }
        for detector in ("a", "b")
        for block in seed_blocks(seeds, 2)
    ]


def work(task: Task) -> Arrays:
    """Products of matrices, so that the number of threads of the linear algebra could matter."""
    trap = Path(task["trap"])
    if task["trap"] and trap.exists() and task["detector"] == "b":
        what = trap.read_text()
        if what == "interrupt":
            raise KeyboardInterrupt
        if what == "die":
            os._exit(9)
        raise ArithmeticError(f"{NASTY} in seeds {task['seeds']}")
    size = task["size"]
    draws = np.stack([stream(s, "toy").standard_normal((size, size)) for s in task["seeds"]])
    return {"mean": (draws @ draws.mT).mean(axis=(1, 2)) + len(task["detector"])}


def summarise(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    rows, by_detector = [], {}
    for detector in ("a", "b"):
        found = [arrays["mean"] for task, arrays in results if task["detector"] == detector]
        if found:
            by_detector[detector] = values = np.concatenate(found)
            half = 1.96 * float(values.std()) / math.sqrt(values.size)
            mean = float(values.mean())
            published = {"published": mean + half / 2, "source": "Author 1999, Table I, p. 1"} if detector == "a" else {}
            rows.append(
                Row(
                    "toy/mean",
                    "none",
                    detector,
                    NASTY,
                    "pressure",
                    "mean",
                    mean,
                    mean - half,
                    mean + half,
                    values.size,
                    **published,
                )
            )
    rows.append(Row("toy/mean", "none", "a", "none", "all", "undefined", math.nan))

    def draw() -> Drawing:
        figure, (axes,) = panels(["means"])
        time_series(axes, np.arange(len(by_detector["a"])), by_detector, ylabel="mean", spans=[(0, 1)], levels={"one": 1.0})
        return figure

    def figures(name: str) -> list[Figure]:
        return [Figure(name, f"Means {NASTY}", NASTY, draw, NASTY)] if settings["figure"] else []

    with_intervals = tuple((r.detector, (r.value, r.low, r.high, r.n)) for r in rows)
    means = ResultTable("Means", ("detector", "mean"), with_intervals, method=f"Table's method {NASTY}")
    return Summary(
        rows,
        figures=figures("means"),
        tables=[ResultTable("As printed", ("detector", "mean"), tuple((r.detector, r.value) for r in rows))],
        highlights=[f"{len(rows)} rows."],
        remarks=[f"Nothing is published. {NASTY}"],
        chapters=[
            Chapter("toys", f"Toys {NASTY}", [NASTY], figures("again"), [means], method=[f"Chapter's method {NASTY}"]),
        ],
        method=[f"Method of all {NASTY}"],
    )


def toy(**changes: Any) -> Scenario:
    usual: dict[str, Any] = {
        "name": "toy/mean", "title": f"Means {NASTY}", "about": f"Means of products. {NASTY}",
        "settings": {"size": 40, "trap": "", "figure": True, "levels": ("high", "low"), "rate": 0.5},
        "seeds": 6, "full_seeds": 50, "tasks": tasks, "work": work, "summarise": summarise,
    }  # fmt: skip
    return Scenario(**{**usual, **changes})


TOY = toy()
