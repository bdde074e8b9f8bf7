"""Figures as files: laid out once, as SVG and PNG."""

from __future__ import annotations

import gc
import io
from collections.abc import Callable
from pathlib import Path

from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from fusion_sfdia.core.files import atomic_write
from fusion_sfdia.report.plots import style

SVG_DPI = 72  # of matplotlib's SVG, whose unit is the point


def write_figure(folder: Path, name: str, draw: Callable[[], Figure]) -> str:
    """Draw a figure, write folder/name.svg and folder/name.png, and return the SVG's text."""
    png = io.BytesIO()
    svg = figure_svg(name, draw, png)
    for kind, content in (("svg", svg.encode()), ("png", png.getvalue())):
        with atomic_write(folder / f"{name}.{kind}", "wb") as file:
            file.write(content)
    return svg


def figure_svg(name: str, draw: Callable[[], Figure], png: io.BytesIO | None = None) -> str:
    """Draw a figure and return its SVG; png: where its PNG is written to, too."""
    svg = io.BytesIO()
    with style(name):
        figure = draw()
        _lay_out(figure)
        figure.savefig(svg, format="svg", metadata={"Date": None})
        if png is not None:
            figure.savefig(png, format="png", dpi=160)
    del figure
    gc.collect(0)  # thousands of objects that refer to each other, and a picture of megabytes
    return svg.getvalue().decode()


def _lay_out(figure: Figure) -> None:
    """Place the parts of a figure for good, as its SVG would have them: to save it would draw it once more for that."""
    if (engine := figure.get_layout_engine()) is not None:
        FigureCanvasSVG(figure)
        dpi, figure.dpi = figure.dpi, SVG_DPI
        engine.execute(figure)
        figure.dpi = dpi
        figure.set_layout_engine(None)
