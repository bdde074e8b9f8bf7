"""The numbers that the five papers publish beside ours: the rule by which one is met, the page and its figures.

Why a value is missed is in published_reasons.toml; what has no reason there is unexplained.
"""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import partial
from math import isfinite
from pathlib import Path
from textwrap import fill
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.report.figure_files import figure_svg
from fusion_sfdia.report.results import AT_MOST, MORE_THAN, Row, rounded, write_rows

REASONS = Path(__file__).with_name("published_reasons.toml")
NUMBERS, PAGE = "published.csv", "published.md"
DIGITS = 4
WIDTH = 128
NEAR = 2.0  # a factor
PAPERS = {  # key: how its sources begin, title
    "shaheen2024": (("Shaheen 2024",), "Shaheen 2024, gas pipeline"),
    "kougiatsos2024": (("Kougiatsos 2024", "K24"), "Kougiatsos 2024, marine engine"),
    "kougiatsos2022": (("Kougiatsos 2022", "K22"), "Kougiatsos 2022, marine engine"),
    "virtual2022": (("Kougiatsos and Reppa 2022", "V22"), "Kougiatsos and Reppa 2022, virtual sensors"),
    "boem2018": (("Boem 2018", "B18"), "Boem 2018, power network"),
}
UNEXPLAINED = "unexplained"
READINGS = (  # parts of conditions: how a paper is read
    *("lit", "small", "as printed", "intersected", "interval alone"),
    *("readings every 1 ms", "readings every 0.3 ms"),
    *("interval arithmetic", "set inversion", "(30) as printed", "the paper's own timeline"),
)
METRICS = {"minimum_detectable_percent": "without noise", "smallest_detected_percent": "in a run"}  # two readings of one
DEFAULT = {"shaheen2024": "federated, 0.9 sigma"}  # the reading without a name, "ours" of other papers, which stands first
RULE = (
    f"Met: within our interval and, as a wide interval proves nothing, ours within a factor {NEAR:g} of it; or within 0.5 % "
    "of it; a bound, where ours is not shown to be beyond it."
)
BOUNDS = {AT_MOST: "at most ", MORE_THAN: "more than "}
FURTHEST = 1000.0  # a factor, at which what is further away is drawn
COLUMNS = 4  # more readings stand in one column


class Value(NamedTuple):
    """A published number, and ours for it by reading of the paper, the default one first."""

    paper: str
    source: str
    what: str
    published: float
    ours: dict[str, Row]

    @property
    def own(self) -> Row:
        """Ours as the paper is read by default."""
        return next(iter(self.ours.values()))

    @property
    def met_by(self) -> list[str]:
        """The readings that meet it, see `_meets`."""
        return [name for name, row in self.ours.items() if _meets(row, self.published)]

    @property
    def by_default(self) -> bool:
        """Whether ours as the paper is read by default meets it."""
        return next(iter(self.ours)) in self.met_by

    @property
    def near(self) -> bool:
        """Whether ours is within a factor `NEAR` by one reading."""
        return any(_near(row.value, self.published) for row in self.ours.values())


class Counts(NamedTuple):
    """How many numbers there are, are met, are near, and are missed with a reason and without."""

    numbers: int
    by_default: int
    by_some: int
    near: int
    explained: int
    unexplained: int


def _near(value: float, published: float) -> bool:
    return min(published / NEAR, published * NEAR) <= value <= max(published / NEAR, published * NEAR)


def _meets(row: Row, published: float) -> bool:
    """Whether the published value is within our interval, which counts only where ours is near; or equal to three digits."""
    if row.source.endswith(MORE_THAN):
        return row.value > published if row.agrees is None else row.agrees
    close = isfinite(row.value) and abs(row.value - published) <= 5e-3 * abs(published)
    return close or (bool(row.agrees) and (row.source.endswith(AT_MOST) or _near(row.value, published)))


def paper_of(source: str) -> str:
    """The key of the paper; ValueError for a source of none."""
    for key, (beginnings, _) in PAPERS.items():
        if source.startswith(beginnings):
            return key
    raise ValueError(f"source {source!r} is of no paper; known: {', '.join(b for bs, _ in PAPERS.values() for b in bs)}")


def stated(rows: Iterable[Row], paper: str | None = None) -> list[Row]:
    """The rows with a published number, of one paper if it is named, as results are committed: of a row that comes again the
    first, rounded to `DIGITS` digits.
    """
    first: dict[tuple[str, ...], Row] = {}
    for row in rows:
        if row.published is not None and paper in (None, paper_of(row.source)):
            key = (row.scenario, row.detector, row.fault, row.quantity, row.condition, row.metric, row.source)
            first.setdefault(key, rounded(row, DIGITS))
    return list(first.values())


def values_of(rows: Iterable[Row]) -> list[Value]:
    """The published numbers, in the order of the rows: each once, with ours by how the paper is read."""
    found: dict[tuple[str, ...], Value] = {}
    for row in rows:
        if row.published is None or (row.scenario == "engine/sensitivity" and "Table V" in row.source):
            continue  # the same as of engine/minimum-fault
        paper = paper_of(row.source)
        detector, _, mode = row.detector.partition(":")
        parts = [part for part in row.condition.split(", ") if part]
        of_reading = parts[1:] if paper == "shaheen2024" else [part for part in parts if part in READINGS]
        condition = [part for part in parts if part not in of_reading]
        metric = "smallest fault, percent" if row.metric in METRICS else row.metric.replace("_", " ")
        names = (detector, row.fault if row.fault != "none" else "", row.quantity, *condition, metric)
        key = (paper, row.source, row.scenario, *names)
        if key not in found:
            found[key] = Value(paper, row.source, ", ".join(n for n in names if n and n != "all"), row.published, {})
        reading = ", ".join(part for part in (mode, METRICS.get(row.metric, ""), *of_reading) if part)
        ours = found[key].ours
        ours[reading or DEFAULT.get(paper, "ours")] = row
        if not reading:  # the default reading stands first
            found[key] = found[key]._replace(ours={name: ours[name] for name in sorted(ours, key=lambda n: ours[n] is not row)})
    return list(found.values())


def reasons() -> list[tuple[str, re.Pattern[str], str]]:
    """(paper, pattern of source and what, reason), the first that fits counts."""
    with REASONS.open("rb") as file:
        return [(r["paper"], re.compile(r["where"]), r["why"]) for r in tomllib.load(file)["reason"]]


def readings() -> dict[str, str]:
    """By paper, what it leaves open and how it is read here."""
    with REASONS.open("rb") as file:
        return dict(tomllib.load(file)["reading"])


def reason_of(value: Value, known: Sequence[tuple[str, re.Pattern[str], str]]) -> str:
    """Why a value is missed."""
    text = f"{value.source}: {value.what}"
    return next((why for paper, where, why in known if paper == value.paper and where.search(text)), UNEXPLAINED)


def shown(number: float) -> str:
    """A number with four digits at most."""
    return "-" if not isfinite(number) else f"{number:.4g}"


def cell(row: Row | None) -> str:
    """A number with its interval."""
    if row is None:
        return ""
    return shown(row.value) + (f" [{shown(row.low)}, {shown(row.high)}]" if isfinite(row.low) else "")


def table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "\n".join("| " + " | ".join(line) + " |" for line in (header, ["---"] * len(header), *lines))


def counts(values: Sequence[Value]) -> Counts:
    """How many values have which outcome."""
    known = reasons()
    missed = Counter(reason_of(v, known).startswith(UNEXPLAINED) for v in values if not v.met_by)
    met = sum(v.by_default for v in values), sum(bool(v.met_by) for v in values), sum(v.near for v in values)
    return Counts(len(values), *met, missed[False], missed[True])


def _by_paper(values: Sequence[Value]) -> list[tuple[str, list[Value]]]:
    """The papers that there are values of, by title."""
    return [(title, own) for key, (_, title) in PAPERS.items() if (own := [v for v in values if v.paper == key])]


def counts_table(values: Sequence[Value]) -> str:
    """The `counts` of each paper."""
    header = (
        *("paper", "numbers", "met as read by default", "met by some reading", f"within a factor {NEAR:g} by some"),
        *("missed, with a reason", "missed, unexplained"),
    )
    return table(header, [(title, *map(str, counts(own))) for title, own in _by_paper(values)])


def render(values: Sequence[Value], see: str = "") -> str:
    """The page in Markdown; see: a sentence that ends its first paragraph."""
    known = reasons()
    parts = [
        "# Published numbers beside ours",
        fill(
            "Each number that one of the five papers states for something that a scenario measures, with ours beside it, from "
            f"`fusion-sfdia papers`, in brackets the 95 % interval; n: the runs, trials or entries behind a number. {RULE} "
            f"A miss has its reason, as known from full runs, or is unexplained. {see}",
            WIDTH,
        ),
        counts_table(values),
    ]
    for title, own in _by_paper(values):
        parts.append(f"## {title}")
        if (read := readings().get(own[0].paper)) is not None:
            parts.append(fill(read, WIDTH))
        parts.append(f"![Ours over the published number, {title}]({_figure(own[0].paper)}.svg)")
        for source in dict.fromkeys(_table_of(v.source) for v in own):
            parts.append(f"### {source}")
            of_source = [v for v in own if _table_of(v.source) == source]
            parts.append(_sizes(of_source))
            parts.append(_lines(of_source, known))
    return "\n\n".join(parts) + "\n"


def _table_of(source: str) -> str:
    """The source without what differs within a table: `Shaheen 2024, Table IV` of `Shaheen 2024, Table IV, low SNR`."""
    found = re.match(r"[^,]+, (Table|Fig\.|sec\.) [\w().-]+", source)
    return found[0] if found else source.partition(":")[0]


def _sizes(own: Sequence[Value]) -> str:
    """From which scenarios numbers are, and how many runs, trials or entries are behind each."""
    sizes: dict[str, set[int]] = {}
    for row in (row for v in own for row in v.ours.values() if row.n):
        sizes.setdefault(row.scenario, set()).add(row.n)
    found = (f"`{name}`, n {' to '.join(f'{n}' for n in sorted({min(of), max(of)}))}" for name, of in sizes.items())
    return f"From {'; '.join(found)}."


def _lines(own: Sequence[Value], known: Sequence[tuple[str, re.Pattern[str], str]]) -> str:
    readings = list(dict.fromkeys(reading for v in own for reading in v.ours))
    apart = len(readings) <= COLUMNS
    header = ("what", "published", *(readings if apart else ("ours, by reading",)), "met", "why not")
    lines = []
    for v in own:
        cells = [cell(v.ours.get(reading)) for reading in readings] if apart else [_joined(v)]
        met = ("yes" if v.by_default else f"by {v.met_by[0]}") if v.met_by else "no"
        lines.append((v.what, _stated(v), *cells, met, _why(v, known)))
    return table(header, lines)


def _stated(v: Value) -> str:
    """The published number, a bound as one."""
    bound = next((sign for end, sign in BOUNDS.items() if v.source.endswith(end)), "")
    return bound + shown(v.published)


def _joined(v: Value) -> str:
    return "<br>".join(f"{name}: {cell(row)}" for name, row in v.ours.items())


def _why(v: Value, known: Sequence[tuple[str, re.Pattern[str], str]]) -> str:
    """Why it is missed as the paper is read by default."""
    if v.by_default:
        return ""
    return "the paper can be read in several ways, and does not state which" if v.met_by else reason_of(v, known)


def draw(own: Sequence[Value]) -> Figure:
    """Ours over the published number, on a logarithmic scale, by table; misses are crosses."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    axes = figure.subplots()
    groups = list(dict.fromkeys(_table_of(v.source) for v in own))
    for at, group in enumerate(groups):
        values = [(v, v.ours[v.met_by[0]] if v.met_by else v.own) for v in own if _table_of(v.source) == group]
        for k, (v, row) in enumerate(values):
            x = at + 0.8 * ((k + 0.5) / len(values) - 0.5)
            ratio = _ratio(row.value, v.published)
            if isfinite(row.low):
                axes.plot([x, x], [_ratio(row.low, v.published), _ratio(row.high, v.published)], color="0.6", linewidth=1)
            axes.plot(x, ratio, "o" if v.met_by else "x", color="tab:green" if v.met_by else "tab:red", markersize=4)
    axes.axhline(1.0, color="0.3", linewidth=0.8)
    axes.axhspan(1 / NEAR, NEAR, color="0.93", zorder=0)
    axes.set_yscale("log")
    axes.set_xticks(range(len(groups)), [g.partition(", ")[2] or g for g in groups], rotation=20, ha="right")
    axes.set_ylabel("ours / published")
    axes.set_title(
        f"circles: met by a reading, with its interval; crosses: missed, default reading; grey: factor {NEAR:g}; "
        f"at {FURTHEST:g} and {1 / FURTHEST:g}: beyond, or one of both is 0",
        fontsize=8,
    )
    return figure


def _ratio(ours: float, published: float) -> float:
    """Ours over the published number, between 1 / `FURTHEST` and `FURTHEST`, which stand for a 0 of one of both."""
    if ours == published:
        return 1.0
    ratio = ours / published if published else np.inf
    return float(np.clip(ratio, 1 / FURTHEST, FURTHEST))


def figures(values: Sequence[Value]) -> dict[str, str]:
    """The figure of each paper as SVG, by its name."""
    return {name: figure_svg(name, partial(draw, own)) for _, own in _by_paper(values) if (name := _figure(own[0].paper))}


def _figure(paper: str) -> str:
    return f"published-{paper}"


def write_page(folder: Path, rows: Sequence[Row], see: str = "") -> list[Value]:
    """Write the numbers of `stated` rows, the page and its figures into a folder, and return the values on the page."""
    values = values_of(rows)
    texts = {PAGE: render(values, see)} | {f"{name}.svg": svg for name, svg in figures(values).items()}
    write_rows(folder / NUMBERS, rows)
    for name, text in texts.items():
        with atomic_write(folder / name) as file:
            file.write(text)
    return values
