"""Figures as files: laid out as matplotlib lays them out, and gone from memory once they are saved."""

from __future__ import annotations

import gc
import io
import weakref

import numpy as np
from matplotlib.figure import Figure

from fusion_sfdia.report.figure_files import figure_svg
from fusion_sfdia.report.plots import panels, style


def curves() -> Figure:
    """Panels with a label, a legend outside and a colour bar, which all take room."""
    figure, axes = panels(["one", "two"])
    for each in axes:
        each.plot(np.arange(5), label="rising")
        each.set_ylabel("level [m]")
    figure.colorbar(axes[0].imshow(np.eye(3)), ax=axes[0])
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside upper center")
    return figure


def test_a_figure_is_laid_out_as_matplotlib_does_when_it_saves_it() -> None:
    own, png = io.BytesIO(), io.BytesIO()
    text = figure_svg("one", curves, png)
    with style("one"):
        figure = curves()
        figure.savefig(own, format="svg", metadata={"Date": None})
    assert text.encode() == own.getvalue() and png.getvalue().startswith(b"\x89PNG")


def test_of_a_figure_that_is_saved_nothing_stays_in_memory() -> None:
    """Where garbage is collected seldom, as in a command."""
    drawn: list[weakref.ref[Figure]] = []

    def draw() -> Figure:
        figure = curves()
        drawn.append(weakref.ref(figure))
        return figure

    gc.disable()
    try:
        figure_svg("one", draw, io.BytesIO())
        assert drawn[0]() is None
    finally:
        gc.enable()
