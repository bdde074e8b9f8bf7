"""Figures of network/attacks: answers and false isolation of sensors by fault."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.network.support.trials import PATIENCE
from fusion_sfdia.report.content import Figure
from fusion_sfdia.report.plots import panels

Array = NDArray[Any]


def answers_figure(cases: Mapping[str, tuple[Sequence[str], Mapping[str, Array]]]) -> Figure:
    """A panel for each case, {title: (options, {fault: answers (B,), places in options})}."""

    def draw() -> Drawing:
        figure, axes = panels(list(cases), width=10.0, height=3.3)
        for one, (options, answers) in zip(axes, cases.values(), strict=True):
            table = [np.bincount(a, minlength=len(options)) / max(a.size, 1) for a in answers.values()]
            _shares(one, np.array(table), list(answers), options, "answer at the end")
        return figure

    return Figure(
        "answers",
        "Answers by fault",
        f"Share of the runs with each answer {PATIENCE} s after the detection, or at the end of the run. No hypothesis is the "
        "slow governor or the lost load: there the correct answer is none of these.",
        draw,
        "Matrices of fault against answer, with the shares written into the cells",
    )


def false_isolation_figure(cases: Mapping[str, Mapping[str, Array]], own: Mapping[str, int], detector: str) -> Figure:
    """A panel for each case, {title: {fault: isolated (B, sensors)}}; own: places of the area's sensors by name."""

    def draw() -> Drawing:
        figure, axes = panels(list(cases), width=9.0, height=3.3)
        places = list(own.values())
        for one, by_fault in zip(axes, cases.values(), strict=True):
            table = [
                [*b[:, places].mean(axis=0), np.delete(b, places, axis=1).any(axis=1).mean(), b.any(axis=1).mean()]
                for b in by_fault.values()
            ]
            _shares(one, np.array(table), list(by_fault), [*own, "another", "any"], "sensor isolated")
        return figure

    return Figure(
        "false-isolation",
        "False isolation of sensors under faults of the area",
        f"Share of the runs in which the detector {detector}, which assumes sensor faults only, isolates a sensor at some time "
        "after the onset. None of the sensors is faulty.",
        draw,
        "Matrices of fault against isolated sensor, with the shares written into the cells",
    )


def _shares(axes: Axes, table: Array, rows: Sequence[str], columns: Sequence[str], xlabel: str) -> None:
    """A matrix of shares (rows, columns), written into its cells where they are not 0."""
    axes.imshow(table, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    axes.set_xticks(range(len(columns)), columns, rotation=30, ha="right", fontsize=8)
    axes.set_yticks(range(len(rows)), rows, fontsize=8)
    axes.grid(visible=False)
    axes.set_xlabel(xlabel)
    for (i, j), value in np.ndenumerate(table):
        if value > 0:
            axes.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=7, color="white" if value > 0.55 else "black")
