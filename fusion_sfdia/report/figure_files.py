"""Figures as files: laid out once, as SVG and PNG."""

from __future__ import annotations

import gc
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import Formatter, NullFormatter

from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.common.plain_text import plain
from fusion_sfdia.report.plots import style

SUPERSCRIPTS = str.maketrans("-.0123456789", "⁻·⁰¹²³⁴⁵⁶⁷⁸⁹")
SVG_DPI = 72  # of matplotlib's SVG, whose unit is the point


def write_figure(
    folder: Path, name: str, draw: Callable[[], Figure], laid_out: Callable[[Figure], object] = lambda figure: None
) -> str:
    """Draw a figure, write folder/name.svg and folder/name.png, and return the SVG's text. laid_out: as in `figure_svg`."""
    png = io.BytesIO()
    svg = figure_svg(name, draw, png, laid_out=laid_out)
    for kind, content in (("svg", svg.encode()), ("png", png.getvalue())):
        with atomic_write(folder / f"{name}.{kind}", "wb") as file:
            file.write(content)
    return svg


def figure_svg(
    name: str,
    draw: Callable[[], Figure],
    png: io.BytesIO | None = None,
    text: str = "path",
    laid_out: Callable[[Figure], object] = lambda figure: None,
) -> str:
    """Draw a figure and return its SVG; png: where its PNG is written to, too. text: "path" for outlines that look the same
    everywhere, "none" for text in the viewer's fonts, which takes less. laid_out: called with the figure once its parts are
    in their places.
    """
    svg = io.BytesIO()
    with style(name, text):
        figure = draw()
        _as_text(figure)
        _lay_out(figure)
        laid_out(figure)
        figure.savefig(svg, format="svg", metadata={"Date": None})
        if png is not None:
            figure.savefig(png, format="png", dpi=160)
    del figure
    gc.collect(0)  # thousands of objects that refer to each other, and a picture of megabytes
    return svg.getvalue().decode()


class _AsText(Formatter):
    """The labels of another formatter of ticks as `plain` text, powers of ten as 10⁻³, as no text is taken for a formula."""

    def __init__(self, of: Formatter) -> None:
        self.of = of
        self.set_axis(of.axis)

    def set_axis(self, axis: Any) -> None:
        super().set_axis(axis)
        self.of.set_axis(axis)

    def set_locs(self, locs: Any) -> None:
        self.of.set_locs(locs)

    def format_ticks(self, values: Any) -> list[str]:
        return [_plain_power(text) for text in self.of.format_ticks(values)]

    def __call__(self, x: float, pos: int | None = None) -> str:
        return _plain_power(self.of(x, pos))

    def get_offset(self) -> str:
        return self.of.get_offset()


def _plain_power(text: str) -> str:
    if (found := re.fullmatch(r"\$\\mathdefault\{([-0-9.e]*(\\times)?[0-9.]*(\^\{[-0-9.]+\})?)\}\$", text)) is None:
        return plain(text)
    known = found[1].replace(r"\times", "×")
    return re.sub(r"\^\{(-?[0-9.]+)\}", lambda power: power[1].translate(SUPERSCRIPTS), known)


def _as_text(figure: Figure) -> None:
    """Have every text of a figure drawn as it is, and characters on which a viewer acts by their numbers."""
    for text in figure.findobj(Text):
        if isinstance(text, Text) and (shown := plain(text.get_text())) != text.get_text():
            text.set_text(shown)
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if not isinstance(major := axis.get_major_formatter(), _AsText | NullFormatter):
                axis.set_major_formatter(_AsText(major))
            if not isinstance(minor := axis.get_minor_formatter(), _AsText | NullFormatter):
                axis.set_minor_formatter(_AsText(minor))


def _lay_out(figure: Figure) -> None:
    """Place the parts of a figure for good, as its SVG would have them: to save it would draw it once more for that."""
    if (engine := figure.get_layout_engine()) is not None:
        FigureCanvasSVG(figure)
        dpi, figure.dpi = figure.dpi, SVG_DPI
        engine.execute(figure)
        figure.dpi = dpi
        figure.set_layout_engine(None)
