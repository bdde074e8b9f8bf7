"""Draws choices.svg, what the detectors to choose from achieve, for the README: python docs/results/choices_figure.py.

The file ends with a digest of the numbers that it shows, by which a test notices that it has to be drawn again.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from fusion_sfdia.report.figure_files import figure_svg

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import comparison  # noqa: E402  (beside this file)
import pages  # noqa: E402

FILE = HERE / "choices.svg"
MARKERS = ("o", "s", "^", "D")  # of the plants
Numbers = dict[str, dict[str, list[float]]]


def numbers(rows: Sequence[comparison.Row]) -> Numbers:
    """The values of each detector on the plants, by panel; NaN where it does not apply."""
    found: Numbers = {title: {} for title in pages.MEASURES}
    for _, detector, _ in pages.CHOICES:
        for title, cells in zip(pages.MEASURES, pages.measured(rows, detector), strict=True):
            found[title][detector] = [float("nan") if cell == "-" else float(cell) for cell in cells]
    return found


def draw(found: Numbers) -> Figure:
    """A panel a measure, a row a detector, a marker a plant."""
    figure = Figure(figsize=(10.0, 3.6), layout="constrained", facecolor="white")
    panels = figure.subplots(1, len(found), sharey=True)
    for axes, (title, of) in zip(panels, found.items(), strict=True):
        for k, (plant, marker) in enumerate(zip(comparison.PLANTS, MARKERS, strict=True)):
            values = [each[k] for each in of.values()]
            at = [-row - 0.18 * (k - 1.5) for row in range(len(of))]
            axes.plot(values, at, marker, markersize=6, label=plant, clip_on=False)
        for row in range(len(of) - 1):
            axes.axhline(-row - 0.5, color="0.85", linewidth=0.8)
        axes.set_title(title, fontsize=10)
        axes.set_xlim(0.5 if title == pages.MEASURES[0] else 0.0, 1.0)
        axes.set_ylim(0.5 - len(of), 0.5)
        axes.grid(axis="x", color="0.9")
        axes.grid(False, axis="y")
    panels[0].set_yticks([-row for row in range(len(pages.CHOICES))], [detector for _, detector, _ in pages.CHOICES])
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def main() -> None:
    """Write the figure."""
    found = numbers(comparison.load(HERE / "comparison.csv"))
    FILE.write_text(figure_svg("choices", lambda: draw(found)) + comparison.mark(found), encoding="utf-8")


if __name__ == "__main__":
    main()
