"""Figures that the scenarios share. Colours that colour-blind readers can tell apart; files with the same bytes each time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.ticker import LogFormatter
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock

Array = NDArray[Any]

# Okabe and Ito, Color Universal Design (2008)
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
DASHES = ("-", "--", "-.", ":")

STYLE: dict[Any, Any] = {
    "axes.prop_cycle": cycler(color=COLOURS),
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "figure.dpi": 100,
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "lines.linewidth": 1.5,
    "savefig.facecolor": "white",
    "text.parse_math": False,  # a title with two $ is no formula
}


class Bars(NamedTuple):
    """A group of bars: values with intervals (NaN for none), and published values beside them (NaN for none)."""

    label: str
    value: Sequence[float]
    low: Sequence[float]
    high: Sequence[float]
    published: Sequence[float]


class _WallClockLocator(AutoDateLocator):
    """Ticks of the wall clock, each once: an hour that the clock leaves out in spring would be the next one again."""

    def __call__(self) -> Any:
        return np.unique(super().__call__())  # type: ignore[no-untyped-call]


class TimeAxis(NamedTuple):
    """How times t (s) are drawn: wall-clock times, or in a unit of so many seconds, minutes, hours or days."""

    clock: Clock
    seconds: float
    unit: str
    label: str

    def __call__(self, t: Any) -> Any:
        """Times (s), a number or (K,), as places on the axis."""
        if self.clock.start is None:
            return np.asarray(t) / self.seconds
        return float(date2num(self.clock.start)) + np.asarray(t) / 86400  # type: ignore[no-untyped-call]

    def label_on(self, axes: Axes) -> None:
        """Name the axis, with wall-clock times where there are any."""
        axes.set_xlabel(self.label)
        if self.clock.start is not None:
            zone = self.clock.start.tzinfo
            locator = _WallClockLocator(tz=zone, minticks=3, maxticks=7)  # type: ignore[no-untyped-call]
            axes.xaxis.set_major_locator(locator)
            formatter: Any = ConciseDateFormatter(locator, tz=zone, show_offset=False)  # type: ignore[no-untyped-call]
            formatter.formats[-1] = "%H:%M:%S.%f"  # of seconds, of which it leaves out zeros
            axes.xaxis.set_major_formatter(formatter)


MINUTES = TimeAxis(Clock(), 60.0, "min", "time (min)")


@contextmanager
def style(salt: str = "fusion-sfdia", text: str = "path") -> Iterator[None]:
    """Within the block, figures have the project's style, whatever the user's own; salt fixes the names inside an SVG, text
    states how its texts are written. With "none", for a page, lines keep their points: a reader may zoom.
    """
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update({**STYLE, "svg.hashsalt": salt, "svg.fonttype": text, "path.simplify": text != "none"})
        yield


def panels(titles: Sequence[str], *, columns: int = 2, width: float = 7.2, height: float = 2.8) -> tuple[Figure, list[Axes]]:
    """Return a figure of titled panels, left to right and down; width of the figure and height of a panel in inches."""
    columns = min(columns, len(titles))
    rows = -(-len(titles) // columns)
    figure = Figure(figsize=(width if columns > 1 else width * 0.75, height * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, title in zip(grid, titles, strict=False):
        axes.set_title(title, fontsize=10, loc="left")
    for spare in grid[len(titles) :]:
        spare.remove()
    return figure, list(grid[: len(titles)])


def entry(name: str | None) -> str | None:
    """A name as the label of an entry of a legend, from which matplotlib leaves out what begins with an underscore."""
    return f"\u2009{name}" if name is not None and name.startswith("_") else name


def roc_curves(axes: Axes, curves: Mapping[str, tuple[Array, Array]]) -> None:
    """Detection against false-alarm probability: {label: (false alarms (n,), detections (n,))}, with the diagonal of chance."""
    for i, (label, (false_alarm, detection)) in enumerate(curves.items()):
        axes.plot(
            false_alarm, detection, color=COLOURS[i % len(COLOURS)], linestyle=DASHES[i % len(DASHES)], label=entry(label)
        )  # fmt: skip
    chance = np.append(0.0, np.geomspace(1e-6, 1.0, 200))  # a curve, where an axis is logarithmic
    axes.plot(chance, chance, color="0.6", linewidth=0.8)
    axes.set(xlabel="false-alarm probability", ylabel="detection probability", xlim=(-0.01, 1.01), ylim=(-0.01, 1.01))
    axes.set_aspect("equal")
    if curves:
        axes.legend(loc="lower right")


def isolation_matrix(axes: Axes, counts: Array, *, boundaries: Mapping[str, int] | None = None) -> None:
    """What was isolated (columns) against what was faulty (rows), each row in shares of its sum; index 0 is none.

    Rows without a count are grey.
    counts (N + 1, N + 1); boundaries: {quantity: first index of it}, drawn as lines with names.
    """
    total = counts.sum(axis=1, keepdims=True)
    share = np.divide(counts, total, out=np.full(counts.shape, np.nan), where=total > 0)
    colours = matplotlib.colormaps["viridis"].with_extremes(bad="0.8")
    image = axes.imshow(share, cmap=colours, vmin=0, vmax=1, interpolation="nearest")
    for first in (boundaries or {}).values():
        axes.axhline(first - 0.5, color="white", linewidth=0.6)
        axes.axvline(first - 0.5, color="white", linewidth=0.6)
    if boundaries:
        starts = [*boundaries.values(), counts.shape[0]]
        middles = [(a + b - 1) / 2 for a, b in pairwise(starts)]
        axes.set_xticks(middles, list(boundaries), fontsize=7)
        axes.set_yticks(middles, list(boundaries), fontsize=7, rotation=90, va="center")
        axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.set(xlabel="isolated", ylabel="faulty")
    axes.figure.colorbar(image, ax=axes, shrink=0.8, label="share of the row")


def bars(axes: Axes, groups: Sequence[str], series: Sequence[Bars], *, ylabel: str, log: bool = False) -> None:
    """Bars of several series over groups, their 95 % intervals, and the published values as hollow diamonds.

    The legend is left to `legend_above`, once all panels are drawn.
    """
    width = 0.8 / max(len(series), 1)
    labelled = False  # the published values
    for i, one in enumerate(series):
        x = np.arange(len(groups)) + (i - (len(series) - 1) / 2) * width
        value = np.asarray(one.value, dtype=float)
        spread = np.stack([value - np.asarray(one.low, dtype=float), np.asarray(one.high, dtype=float) - value])
        axes.bar(x, value, width * 0.9, color=COLOURS[i % len(COLOURS)], label=entry(one.label))
        known = np.all(np.isfinite(spread), axis=0)
        if known.any():
            axes.errorbar(
                x[known], value[known], np.maximum(spread[:, known], 0), fmt="none", ecolor="0.25", elinewidth=1, capsize=2
            )  # fmt: skip
        published = np.asarray(one.published, dtype=float)
        if np.isfinite(published).any():
            label = None if labelled else "published"
            labelled = True
            look: dict[str, Any] = {"linestyle": "none", "marker": "D", "markersize": 4.5, "mfc": "white", "mec": "black"}
            axes.plot(x, published, label=label, gid=f"{one.label}, published", **look)
    axes.set_xticks(np.arange(len(groups)), list(groups))
    axes.set_ylabel(ylabel)
    if log:
        axes.set_yscale("log")
        number_decades(axes.yaxis)
    axes.grid(visible=False, axis="x")


class _BetweenDecades(LogFormatter):
    """Plain numbers between powers of ten, where decades are few."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def number_decades(axis: Axis) -> None:
    """Numbers at the ticks of a logarithmic axis, between powers of ten too where it spans few."""
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(_BetweenDecades(minor_thresholds=(1.5, 0.5)))


def legend_above(figure: Figure) -> None:
    """One legend for all panels of a figure, above them: each label once."""
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(str(label), handle)
    if entries:
        figure.legend(list(entries.values()), list(entries), loc="outside upper center", ncols=len(entries), fontsize=8)


def shade(axes: Axes, spans: Sequence[tuple[float, float]], **look: Any) -> None:
    """Shade spans of the horizontal axis from bottom to top, all as one outline: a log may have thousands of events."""
    if spans:
        corners = np.array([[(a, 0.0), (a, 1.0), (b, 1.0), (b, 0.0)] for a, b in spans])
        outline = Outline.make_compound_path_from_polys(corners)
        axes.add_artist(PathPatch(outline, transform=axes.get_xaxis_transform(), **look))


def time_series(
    axes: Axes,
    t: Array,
    series: Mapping[str, Array],
    *,
    ylabel: str,
    spans: Sequence[tuple[float, float]] = (),
    levels: Mapping[str, float] | None = None,
    at: TimeAxis = MINUTES,
) -> None:
    """Signals (K,) over t (K,) in s; spans (s): when a fault acts; levels: horizontal lines by name; at: how t is drawn."""
    for i, (label, values) in enumerate(series.items()):
        axes.plot(at(t), values, color=COLOURS[i % len(COLOURS)], linestyle=DASHES[i % len(DASHES)], label=entry(label))
    for i, (name, level) in enumerate((levels or {}).items()):
        axes.axhline(level, color="black", linestyle=DASHES[-1 - i % len(DASHES)], linewidth=1, label=entry(name))
    shade(axes, [(float(at(start)), float(at(end))) for start, end in spans], color="0.85", zorder=0, label="fault acts")
    axes.set_ylabel(ylabel)
    at.label_on(axes)
    axes.legend(fontsize=8)
