"""Figures of the engine's campaigns: shares of runs as matrices, and single runs in the layout of the papers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.engine.support.campaign import DRIVES
from fusion_sfdia.benchmarks.engine.support.decisions import draw_modules
from fusion_sfdia.models.marine_engine.plant import SENSORS
from fusion_sfdia.models.marine_engine.published import Experiment, PublishedOffset
from fusion_sfdia.report.content import Figure
from fusion_sfdia.report.plots import COLOURS, DASHES, legend_above, panels
from fusion_sfdia.study.experiments.scenario import Arrays, Settings

Array = NDArray[Any]


def share_matrix(axes: Axes, values: Array, rows: Sequence[str], columns: Sequence[str], *, ylabel: str = "") -> None:
    """Shares (R, C) as shades from white, 0, to dark, 1; values between are written into the cells."""
    axes.imshow(values, cmap="Blues", vmin=0, vmax=1, aspect="auto", interpolation="nearest")
    for i, j in zip(*np.nonzero((values > 0) & (values < 1)), strict=True):
        text = f"{values[i, j]:.2f}".removeprefix("0")
        axes.text(j, i, text, ha="center", va="center", fontsize=6, color="white" if values[i, j] > 0.6 else "black")
    axes.set_xticks(range(len(columns)), list(columns), rotation=90, fontsize=7)
    axes.set_yticks(range(len(rows)), list(rows), fontsize=7)
    for edge, count in (("x", len(columns)), ("y", len(rows))):
        getattr(axes, f"set_{edge}ticks")(np.arange(count - 1) + 0.5, minor=True)
    axes.grid(visible=False)
    axes.grid(visible=True, which="minor", color="0.85", linewidth=0.5)
    axes.tick_params(which="both", length=0)
    axes.set_ylabel(ylabel)


def run_figure(
    name: str, title: str, trace: Array, first: Array, settings: Settings, onsets: Sequence[tuple[str, float]], mark: str
) -> Figure:
    """One run: its trace (3, K, M) and first firings (M,); onsets: what begins, s, described by `mark` in the legend."""
    experiment = Experiment(
        tuple(PublishedOffset(what, at, 0.0) for what, at in onsets), settings["duration"], settings["noise"], {}, ""
    )
    begun = "; ".join(f"{what} from {at:g} s on" for what, at in onsets)
    return Figure(
        name,
        title,
        f"One run, one row per agent and one panel per module, as in K24's Fig. 4 ({begun}): residual in the sensor's unit, "
        "its two thresholds and the latched decision. Of each 0.1 s the samples nearest to either threshold are drawn. Right "
        "of a title: first alarm.",
        partial(draw_modules, trace, first, experiment, mark),
        "Ten panels, one per monitoring module, with its residual, adaptive thresholds and decision over time",
    )


DRAWN = {
    "S(2){3}": "torque",
    "S(3){1}": "receiver pressure",
    "S(4){1}": "charge-air pressure",
    "S(3){2}": "receiver temperature",
}


def drive_figure(drives: Mapping[str, Arrays], onset: float) -> Figure:
    """The engine's response in the DRIVES; drives: their u (K, 1) and signal (K, N), ten samples a second."""

    def draw() -> Drawing:
        figure, axes = panels([DRIVES[d] for d in drives], columns=3, width=10.0, height=2.8)
        for panel, arrays in zip(axes, drives.values(), strict=True):
            t = 0.1 * np.arange(len(arrays["u"]))
            panel.plot(t, 100 * arrays["u"][:, 0], color="black", linewidth=1, label="fuel setting")
            for j, (sensor, name) in enumerate(DRAWN.items()):
                values = arrays["signal"][:, list(SENSORS).index(sensor)]
                panel.plot(t, 100 * values / values[0], color=COLOURS[j], linestyle=DASHES[j % len(DASHES)], label=name)
            panel.axvline(onset, color="0.6", linewidth=1)
            panel.set(xlabel="time (s)", ylabel="% of full load", ylim=(60, 105))
        legend_above(figure)
        return figure

    return Figure(
        "drives",
        "The load step",
        "Fuel setting and true variables, over their values at full load. Grey line: onset of the sensor faults.",
        draw,
        "Time series of fuel setting, torque, pressures and a temperature for each kind of load change",
    )
