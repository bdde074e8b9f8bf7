"""The figures of a scenario, drawn on all cores: drawing takes as long as many a piece of work."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from fusion_sfdia.report.content import Figure
from fusion_sfdia.report.figure_files import write_figure
from fusion_sfdia.report.on_screen import on_screen
from fusion_sfdia.report.page import ShownFigure
from fusion_sfdia.study.experiments.workers import in_processes


class _Asked(NamedTuple):
    """A figure, and the files folder/slug.svg and folder/slug.png to be written."""

    folder: Path
    slug: str
    figure: Figure


class _Drawn(NamedTuple):
    """A figure, or the error that ended it."""

    slug: str
    shown: ShownFigure
    error: str | None


def draw_figures(
    folder: Path, scenario: str, figures: Sequence[Figure], workers: int
) -> tuple[dict[str, ShownFigure], dict[str, str]]:
    """Write the figures into a folder; those drawn by the names of their files, and errors by the names of their figures.

    Files have the same bytes for any number of workers. RuntimeError where a process is killed.
    """
    slugs = {figure.name: f"{scenario.replace('/', '-')}-{figure.name}" for figure in figures}
    asked = [_Asked(folder, slugs[figure.name], figure) for figure in figures]
    drawn = {found.slug: found for found in in_processes(_draw, asked, workers)}
    shown = {slug: drawn[slug].shown for slug in slugs.values() if drawn[slug].error is None}
    return shown, {name: error for name, slug in slugs.items() if (error := drawn[slug].error) is not None}


def _draw(asked: _Asked) -> _Drawn:
    """A figure, where it is drawn; an error is reported, not raised."""
    plots: list[str] = []
    try:
        svg = write_figure(asked.folder, asked.slug, asked.figure.draw, laid_out=lambda figure: plots.append(on_screen(figure)))
        return _Drawn(asked.slug, ShownFigure(svg, plots[0]), None)
    except Exception as problem:
        return _Drawn(asked.slug, ShownFigure("", ""), f"{type(problem).__name__}: {problem}")
