"""report.html: one file that needs nothing else, with what a scenario measured beside what was published."""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.common.plain_text import plain
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.results import Row

OPEN_ROWS = 40  # a longer table is folded
MOST_ROWS = 5000  # of more the page would be slow: they are in metrics.csv alone
SORTED_ROWS = 8  # a table of at least so many can be sorted and filtered


class ShownFigure(NamedTuple):
    """A figure as SVG, and what figures.js needs to read and zoom it, see `on_screen`."""

    svg: str
    plot: str


@dataclass(frozen=True)
class Section:
    """A scenario as it was run: its name and texts, settings, numbers of seeds as run and in full, summary, figures by the
    names of their files, a line for each failure.
    """

    name: str
    title: str
    about: str
    settings: Mapping[str, Any]
    seeds: int
    full_seeds: int
    summary: Summary
    figures: dict[str, ShownFigure]
    failures: list[str]

    def drawn(self, figures: Iterable[Figure]) -> list[tuple[Figure, Markup, str]]:
        """Those of the figures that could be drawn, with their SVG for the page and what figures.js needs."""
        names = {f"{self.name.replace('/', '-')}-{f.name}": f for f in figures}
        drawn = [
            (f, f"f{zlib.crc32(name.encode()):x}", self.figures[name]) for name, f in names.items() if name in self.figures
        ]
        return [(f, inline(shown.svg, prefix, f.alt), shown.plot) for f, prefix, shown in drawn]

    @property
    def comparison(self) -> str:
        """How many published values lie within our intervals, in a sentence; empty where none is published."""
        stated = [r for r in self.summary.rows if r.published is not None]
        judged = [r.agrees for r in stated if r.agrees is not None]
        if not stated:
            return ""
        inside = f"{sum(judged)} of {len(judged)} lie within the 95 % interval of ours" if judged else "ours have no interval"
        return f"{len(stated)} published values: {inside}."


def write_report(path: Path, command: str, sections: list[Section], manifest: dict[str, Any]) -> None:
    """Write report.html, whole or not at all; every name and text is escaped."""
    environment = page_environment()
    environment.filters.update(number=number, interval=interval, setting=_setting, sort_key=_sort_key)
    page = environment.from_string(part("page.html.j2")).render(
        css=Markup(part("page.css")),
        command=command,
        sections=sections,
        manifest=manifest,
        failures=[line for section in sections for line in section.failures],
        open_rows=OPEN_ROWS,
        most_rows=MOST_ROWS,
        sorted_rows=SORTED_ROWS,
        sortable=Markup(part("sortable.min.js")),
        script=Markup(part("figures.js")),
    )
    with atomic_write(path) as file:
        file.write(page)


def page_environment() -> Environment:
    """How pages are made of templates: every text of others is escaped, and shown as `plain` text; Markup is our own."""
    return Environment(
        loader=FunctionLoader(part),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_finalized,
    )


def _finalized(value: Any) -> Any:
    return plain(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def part(name: str) -> str:
    """The text of a file of this folder: a template, a style sheet or a script."""
    return resources.files("fusion_sfdia.report").joinpath(name).read_text(encoding="utf-8")


def number(value: Any) -> str:
    """Return a number with 4 digits, "undefined" for NaN, with its interval where it has one; anything else as text."""
    if isinstance(value, tuple):
        return estimate(*value)
    if isinstance(value, bool) or not isinstance(value, float):
        return str(value)
    if math.isnan(value):
        return "undefined"
    text = f"{value:.4g}"
    mantissa, _, exponent = text.partition("e")
    return f"{mantissa}e{int(exponent)}" if exponent else text


def estimate(value: float, low: float, high: float, n: int) -> str:
    """Return "0.93 [0.88, 0.96]" with as many digits as tell the interval from its value, at least 2."""
    if math.isnan(value) or math.isnan(low) or math.isnan(high):
        return "none" if math.isnan(value) else f"{value:.3g}"
    width = max(high - low, abs(value) * 1e-3)
    digits = max(0, 1 - math.floor(math.log10(width))) if 0 < width < math.inf else 2
    if digits > 6 or max(abs(value), abs(high)) >= 1e6:
        return f"{value:.2g} [{low:.2g}, {high:.2g}]"
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def interval(row: Row) -> str:
    """Return the 95 % interval of a row as text; empty where none is stated."""
    if math.isnan(row.low) or math.isnan(row.high):
        return ""
    return f"{number(float(row.low))} to {number(float(row.high))}"


def _sort_key(value: float | tuple[float, ...]) -> str:
    """What a number is sorted by: with all its digits, empty for NaN."""
    if isinstance(value, tuple):
        value = value[0]
    return "" if math.isnan(value) else repr(float(value))


def _setting(value: Any) -> str:
    return ", ".join(map(_setting, value)) if isinstance(value, tuple | list) else str(value)


_FINE = re.compile(r"(\.\d\d)\d+")  # a hundredth of a point is less than can be seen


def inline(svg: str, name: str, alt: str) -> Markup:
    """Return an SVG file of matplotlib as an element of a page: scaled to its width, described, its names its own.

    name: put before the names within, thousands of them: short.
    """
    body = re.sub(r">\s+<", "><", svg[svg.index("<svg") :])
    body = re.sub(r' d="[^"]*"|translate\([^)]*\)| [xy]="[^"]*"', lambda found: _FINE.sub(r"\1", found[0]), body)
    body = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", body)
    head, rest = body.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]*"', "", head)
    described = Markup('{} role="img" aria-label="{}">{}').format(Markup(head), plain(alt), Markup(rest))
    return described
