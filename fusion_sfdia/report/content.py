"""What a report shows, as data: figures, tables, chapters, and the summary of a scenario made of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fusion_sfdia.report.results import Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

NAME = "[a-z0-9]+(-[a-z0-9]+)*"


@dataclass(frozen=True)
class Figure:
    """A figure of the report: draw() returns it, alt states in words what it shows. name: letters, digits, hyphens."""

    name: str
    title: str
    caption: str
    draw: Callable[[], Drawing]
    alt: str

    def __post_init__(self) -> None:
        require_name("figure", self.name, NAME)


Interval = tuple[float, float, float, int]  # a value, its 95 % interval, and the n runs or trials behind it


@dataclass(frozen=True)
class ResultTable:
    """A table laid out as in a paper; cells are text, numbers (shown with 4 digits) or numbers with their interval.

    caption: what to see; method: how it was made, which the reader has to open. folded: whether that holds for the table, too.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str | float | Interval, ...], ...]
    caption: str = ""
    folded: bool = False
    method: str = ""


@dataclass(frozen=True)
class Chapter:
    """A part of a scenario's section in the report, with an entry in its contents. name: letters, digits, hyphens.

    text: what was found; method: how, which the reader has to open.
    """

    name: str
    title: str
    text: Sequence[str] = ()
    figures: Sequence[Figure] = ()
    tables: Sequence[ResultTable] = ()
    method: Sequence[str] = ()

    def __post_init__(self) -> None:
        require_name("chapter", self.name, NAME)


@dataclass(frozen=True)
class Summary:
    """What a scenario shows: rows of metrics.csv, figures, tables, chapters.

    highlights: sentences for the top of the report. remarks: what to know of the numbers. method: how they were made, which
    the reader has to open.
    """

    rows: Sequence[Row]
    figures: Sequence[Figure] = ()
    tables: Sequence[ResultTable] = ()
    highlights: Sequence[str] = ()
    remarks: Sequence[str] = ()
    chapters: Sequence[Chapter] = ()
    method: Sequence[str] = ()

    @property
    def every_figure(self) -> list[Figure]:
        """The figures, those of chapters too."""
        return [*self.figures, *(figure for chapter in self.chapters for figure in chapter.figures)]


def require_name(what: str, name: str, pattern: str) -> None:
    """Raise ValueError for a name that cannot be part of a file name."""
    if not re.fullmatch(pattern, name):
        raise ValueError(f"{what} {name!r}: expected a name of lower-case letters, digits and hyphens")
