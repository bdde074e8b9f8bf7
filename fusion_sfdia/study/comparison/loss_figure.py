"""The figure that ranks detectors: their losses by plant, each bar in its parts."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.report.content import Figure
from fusion_sfdia.report.plots import panels
from fusion_sfdia.study.comparison.figures import Cells, legend_columns, of_plant
from fusion_sfdia.study.comparison.loss import DELAY, FALSE, FALSE_IF_WRONG, MISSED, loss_parts
from fusion_sfdia.study.comparison.ranking import LOSS
from fusion_sfdia.study.comparison.result_tables import EVERY, Standings, cost_words
from fusion_sfdia.study.experiments.scenario import Settings

COLOURS = {MISSED: "#0072B2", FALSE: "#E69F00", FALSE_IF_WRONG: "#D55E00", DELAY: "0.7"}
Losses = Mapping[str, Mapping[str, Mapping[str, float]]]  # plant, detector, part


def loss_figure(settings: Settings, cells: Cells, standings: Standings) -> Figure:
    """All detectors in the order of their loss, one panel per plant."""
    losses = {
        plant: {
            d: {part: float(v.mean()) for part, v in loss_parts(c, settings).items()} for d, c in of_plant(cells, plant).items()
        }
        for plant in dict.fromkeys(plant for plant, _ in cells)
    }
    best = {plant: [d for d, s in of[LOSS].items() if s.rank == 1] for plant, of in standings.items() if plant != EVERY}
    return Figure(
        "loss",
        "What each detector costs",
        f"Shorter is better; bold: no detector costs less beyond chance. {cost_words(settings)}",
        lambda: draw_loss(losses, best),
        "Bars of the loss of every detector by plant, the least on top, each divided into missed faults, false isolation with "
        "the right and with a wrong model, and delay",
    )


def draw_loss(losses: Losses, best: Mapping[str, Collection[str]]) -> Drawing:
    """Bars of the parts of the loss, the least on top. best: the detectors by plant that none beats, in bold."""
    most = max(map(len, losses.values()))
    figure, axes = panels(list(losses), columns=2, width=11.5, height=1.0 + 0.19 * most)
    for axis, (plant, of) in zip(axes, losses.items(), strict=True):
        order = sorted(of, key=lambda d: sum(of[d].values()))
        left = np.zeros(len(order))
        for part, colour in COLOURS.items():
            width = np.array([of[d][part] for d in order])
            axis.barh(range(len(order)), width, left=left, color=colour, label=part, height=0.75)
            left += width
        axis.set_yticks(range(len(order)), order, fontsize=7)
        for label, name in zip(axis.get_yticklabels(), order, strict=True):
            label.set_fontweight("bold" if name in best[plant] else "normal")
        axis.set_ylim(most - 0.5, -0.5)  # bars are equally thick in all panels
        axis.grid(visible=False, axis="y")
        axis.set_xlabel("loss")
    legend_columns(figure, columns=4)
    return figure
