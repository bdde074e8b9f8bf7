"""The figure of the page real-logs.md: events named right against the rate of false alarms that was held."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure
from real_logs_page import ALL, MONITOR, PROMISED, methods_in, with_events

from fusion_sfdia.report.figure_files import figure_svg
from fusion_sfdia.report.plots import COLOURS, legend_above, panels

NAME = "real-logs"
LEAST = 5e-4  # share of rows at which lower ones are drawn
MARKS = "osD^v<>P"


def draw(cells: Mapping[tuple[str, str, str, str], float]) -> Figure:
    """A panel for each set in which some sensor can be named, a mark for each method."""
    sets = [of for of in with_events(cells) if any(cells[of, m, ALL, "named right"] for m in methods_in(cells, of))]
    methods = list(dict.fromkeys(m for of in sets for m in methods_in(cells, of)))
    figure, axes = panels([of[0].upper() + of[1:] for of in sets], columns=4, width=11.0, height=2.6)
    for axis, of in zip(axes, sets, strict=True):
        axis.axvline(PROMISED, color="0.6", linewidth=0.8)
        for method, mark, colour in zip(methods, MARKS, COLOURS, strict=False):
            if method in methods_in(cells, of):
                held, right = (cells[of, method, ALL, what] for what in ("alarm", "named right"))
                size = 9 if method == MONITOR else 6
                axis.plot([max(held, LEAST)], [right], mark, color=colour, markersize=size, label=method, clip_on=False)
        axis.set(xscale="log", xlim=(LEAST, 1), ylim=(0, 1), xlabel="healthy rows in alarm", ylabel="named right")
    legend_above(figure)
    return figure


def svg(cells: Mapping[tuple[str, str, str, str], float]) -> str:
    """The figure as SVG."""
    return figure_svg(NAME, lambda: draw(cells))
