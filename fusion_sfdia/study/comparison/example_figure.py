"""The figure of the example: readings, reconstructions, residuals over thresholds and alarms over the same time."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure as Drawing
from matplotlib.patches import Patch
from numpy.typing import NDArray

from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.content import Figure
from fusion_sfdia.report.plots import entry, number_decades
from fusion_sfdia.study.comparison.cell import ComparisonCell
from fusion_sfdia.study.comparison.example import PREFIX, SIGMAS
from fusion_sfdia.study.comparison.looks import GREY, OTHERS, looks, prominent
from fusion_sfdia.study.comparison.metric_rows import exact_isolation
from fusion_sfdia.study.experiments.scenario import Settings

Array = NDArray[Any]

VERDICTS = ("no alarm", "alarm, no sensor isolated", "only the faulty sensor isolated", "a healthy sensor isolated")
COLOURS = ("#F2F2F2", "#E69F00", "#0072B2", "#A02020")
LEAST_SCORE = 1e-2  # shown


def example_figure(settings: Settings, cells: Mapping[str, ComparisonCell]) -> Figure:
    """The example of a plant; cells by detector."""
    some = next(iter(cells.values()))
    sensor = some.model.sensor_names[int(some[f"{PREFIX}sensor"])]
    examples = {d: {k: v for k, v in c.arrays.items() if k.startswith(PREFIX)} for d, c in cells.items()}
    named = prominent({d: exact_isolation(settings, c).value for d, c in cells.items()})
    return Figure(
        f"{some.subject.slug}-example",
        f"An example: one faulty run, {some.plant}",
        f"Which detectors isolate the fault, how soon, and what they reconstruct. {sensor}, the middle one of the "
        f"plant's sensors, has a bias of {SIGMAS:g} sigma; thresholds are those of the common rate of false alarms. "
        "Reconstructions are cut off where they leave the range of the readings.",
        partial(draw_example, some.model, examples, named),
        f"Readings of {sensor} on {some.plant}, reconstructions, residuals over thresholds and alarms of {len(cells)} "
        "detectors over the same time",
    )


def draw_example(plant: Plant, examples: Mapping[str, Mapping[str, Array]], named: Collection[str]) -> Drawing:
    """Four panels over one time axis. examples: by detector, the arrays of `example`; named: those not drawn in grey."""
    some, look_of = next(iter(examples.values())), looks(list(examples))
    t, sensor = some[f"{PREFIX}t"], plant.sensors[int(some[f"{PREFIX}sensor"])]
    figure = Drawing(figsize=(11.5, 6.6 + 0.21 * len(examples)), layout="constrained")
    heights = (1.5, 1.5, 1.7, 0.4 + 0.16 * len(examples))
    readings, restored, scores, verdicts = figure.subplots(4, 1, sharex=True, gridspec_kw={"height_ratios": heights})
    unit = f"{sensor.name} ({sensor.unit})"

    readings.plot(t, some[f"{PREFIX}y"], color="black", linewidth=1.0, label="reading")
    readings.plot(t, some[f"{PREFIX}signal"], color="0.55", linestyle="--", label="without noise and fault")
    titled(readings, f"Readings of {sensor.name}, with a bias of {SIGMAS:g} sigma in the grey time", unit)
    restored.plot(t, some[f"{PREFIX}signal"], color="0.55", linestyle="--", label="without noise and fault")
    titled(restored, "Reconstruction by each detector", unit)
    titled(scores, "Largest residual over its threshold: an alarm above 1", "residual / threshold")
    for name, one in sorted(examples.items(), key=lambda item: item[0] in named):  # the named on top
        look = {k: v for k, v in look_of[name].items() if k in ("color", "linestyle")} if name in named else {"color": GREY}
        label = entry(name) if name in named else None
        restored.plot(t, one[f"{PREFIX}reconstruction"], linewidth=1.3, label=label, gid=name, **look)
        scores.plot(t, np.maximum(one[f"{PREFIX}score"], LEAST_SCORE), linewidth=1.3, label=label, gid=name, **look)
    if set(examples) - set(named):
        scores.plot([], [], color=GREY, label=OTHERS)
    scores.axhline(1.0, color="black", linewidth=1.0)
    scores.set_yscale("log")
    number_decades(scores.yaxis)
    for axis in (readings, restored, scores):
        acting = t[some[f"{PREFIX}active"] > 0]
        if acting.size:
            axis.axvspan(acting[0], acting[-1], color="0.93", zorder=0)
    limit_to(restored, [some[f"{PREFIX}y"], some[f"{PREFIX}signal"]])
    for axis in (readings, scores):
        axis.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))

    names = list(examples)
    rows = np.array([examples[name][f"{PREFIX}verdict"] for name in names])
    step = t[1] - t[0] if t.size > 1 else 1.0
    sides = (float(t[0] - step / 2), float(t[-1] + step / 2), len(names) - 0.5, -0.5)
    colours, levels = ListedColormap(COLOURS), BoundaryNorm(np.arange(len(COLOURS) + 1) - 0.5, len(COLOURS))
    image = verdicts.imshow(rows, cmap=colours, norm=levels, extent=sides, aspect="auto", interpolation="nearest")
    image.format_cursor_data = lambda code: VERDICTS[int(code)]
    verdicts.set_yticks(np.arange(len(names)), names, fontsize=7)
    verdicts.grid(visible=False)
    verdicts.tick_params(axis="y", length=0)
    titled(verdicts, "Alarm and isolation", "")
    verdicts.set_xlabel("time (s)")
    shown = [Patch(facecolor=colour, edgecolor="0.6", label=label) for colour, label in zip(COLOURS, VERDICTS, strict=True)]
    verdicts.legend(handles=shown, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def titled(axis: Axes, title: str, label: str) -> None:
    """A panel's title and the label of its vertical axis."""
    axis.set_title(title, fontsize=10, loc="left")
    axis.set_ylabel(label)


def limit_to(axis: Axes, values: list[Array]) -> None:
    """The vertical range of some values, with a margin: what leaves it is cut off."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = 0.25 * max(high - low, abs(high) * matplotlib.rcParams["axes.ymargin"] * 1e-3)
    axis.set_ylim(low - margin, high + margin)
