"""Writes paper-items.md from the files in paper-items/: python docs/results/paper_items.py

A file is a paper; an item is a numbered equation, a proposition, an algorithm, an assumption, a table, a figure or a claim.
"""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from textwrap import fill
from typing import NamedTuple

from fusion_sfdia.study.published_numbers import PAPERS, WIDTH, paper_of, table

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
ITEMS, PAGE = HERE / "paper-items", HERE / "paper-items.md"
KINDS = ("equation", "proposition", "algorithm", "assumption", "table", "figure", "claim")
OUTCOMES = {
    "as printed": "the code does what is printed, and a test holds it",
    "met": "the number or claim is reproduced",
    "read": "the paper leaves it open; the note says how it is read here",
    "corrected": "what is printed is wrong; the note says what holds, and a test shows it",
    "missed": "not reproduced, for the reason in the note",
    "unexplained": "not reproduced; the note says what was tried",
    "untested": "the code does it, and no test would notice if it did not",
    "absent": "not done, for the reason in the note",
}
SAID = ("as printed", "met")  # what needs no note


class Item(NamedTuple):
    """An item of a paper and what stands for it here: code and tests as `path:name`, sources of published numbers."""

    item: str
    kind: str
    says: str
    outcome: str
    code: Sequence[str] = ()
    test: Sequence[str] = ()
    numbers: Sequence[str] = ()
    note: str = ""


class Paper(NamedTuple):
    """A paper's items; `equations`: the highest number of an equation."""

    key: str
    title: str
    equations: int
    items: Sequence[Item]


def load(folder: Path = ITEMS) -> list[Paper]:
    """The papers in the order of the page of published numbers."""
    found = {}
    for path in sorted(folder.glob("*.toml")):
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
        if raw["paper"] not in PAPERS:
            raise ValueError(f"{path.name}: paper {raw['paper']!r} is unknown; expected one of {', '.join(PAPERS)}")
        found[raw["paper"]] = Paper(raw["paper"], raw["title"], raw["equations"], [Item(**one) for one in raw["item"]])
    return [found[key] for key in PAPERS]


def numbered(items: Iterable[Item]) -> set[int]:
    """The equation numbers that the items name, `(1)-(3)` being three."""
    found: set[int] = set()
    for one in items:
        for first, _, last in re.findall(r"\((\d+)[a-z]?\)(\s*(?:-|to)\s*\((\d+)[a-z]?\))?", one.item):
            found |= set(range(int(first), int(last or first) + 1))
    return found


def _links(places: Sequence[str]) -> str:
    return ", ".join(f"[`{name}`](../../{path})" for path, _, name in (place.partition(":") for place in places))


def _numbers(sources: Sequence[str]) -> str:
    papers = {paper_of(source) for source in sources}
    return ", ".join(f"[numbers](published.md#{_anchor(PAPERS[key][1])})" for key in sorted(papers))


def _anchor(title: str) -> str:
    return re.sub(r"[^\w -]", "", title).lower().replace(" ", "-")


def _line(one: Item) -> tuple[str, ...]:
    shown = ", ".join(part for part in (_links(one.test), _numbers(one.numbers)) if part)
    return tuple(text.replace("|", "\\|") for text in (one.item, one.says, _links(one.code), shown, one.outcome, one.note))


def render(papers: Sequence[Paper]) -> str:
    """The page."""
    counts = [(PAPERS[p.key][1], Counter(one.outcome for one in p.items)) for p in papers]
    parts = [
        "# Every item of the papers",
        fill(
            "Each numbered equation, proposition, algorithm, assumption, table, figure and claim of the five papers, with what "
            "stands for it here and what shows it. All numbers: [published numbers beside ours](published.md). Errors of the "
            "papers in full: [misprints](../explanations/misprints.md).",
            WIDTH,
        ),
        "\n".join(f"- {name}: {what}." for name, what in OUTCOMES.items()),
        table(
            ("paper", "items", *OUTCOMES),
            [(title, str(found.total()), *(str(found[name]) for name in OUTCOMES)) for title, found in counts],
        ),
    ]
    for paper in papers:
        parts += [f"## {PAPERS[paper.key][1]}", f"{paper.title}"]
        for kind in KINDS:
            if own := [one for one in paper.items if one.kind == kind]:
                parts += [f"### {PAPERS[paper.key][1].partition(',')[0]}: {kind}s"]
                parts += [table((kind, "what it says", "code", "test, numbers", "outcome", "note"), map(_line, own))]
    return "\n\n".join(parts) + "\n"


def main() -> None:
    """Write the page."""
    PAGE.write_text(render(load()), encoding="utf-8")


if __name__ == "__main__":
    main()
