"""Fills the tables of the results pages, of the README and of docs/paper: python docs/results/pages.py.

People write a page but for its tables: what stands between `<!-- table: NAME -->` and `<!-- end -->` is made from
the CSV files beside this one, and a test makes it again. papers.csv holds the numbers of the papers' own
experiments that no paper publishes, as they are shown: columns page, table, row, column, value, low, high; in LISTS `column` is
the scenario, command or test that gives the number. Those that a paper publishes are in published.csv.
"""

from __future__ import annotations

import csv
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import comparison  # noqa: E402  (beside this file)
import findings  # noqa: E402
import paper_numbers  # noqa: E402
import real_logs  # noqa: E402
import real_logs_page  # noqa: E402
import robustness  # noqa: E402

from fusion_sfdia.report.results import read_rows  # noqa: E402
from fusion_sfdia.study import published_numbers  # noqa: E402

PAGES = (
    *(HERE / f"{name}.md" for name in ("README", *comparison.PLANTS)),
    HERE.parents[1] / "README.md",
    HERE.parent / "paper" / "paper.md",
)
MARKED = re.compile(r"(<!-- table: ([\w-]+) -->\n\n)(.*?)(\n\n<!-- end -->)", re.DOTALL)
LISTS = ("further", "speed")  # tables with one column of numbers

# situation, detector, what it needs
CHOICES = (
    ("**the model may be wrong, or the process may fail**", "robust-glr", "model, and what is uncertain in it"),
    ("model error below the noise level; small, slow or large faults", "loo-glr", "model"),
    ("the same; large or very short faults", "loo-chi2", "model"),
    ("inputs (valves, loads, demand) not known well", "uio", "model"),
    ("no model; recordings of all normal operating conditions", "dynamic-pca", "recordings"),
    ("no model; steady operation", "limits-ewma", "recordings"),
    ("model error above the noise level; large faults", "chebyshev", "model"),
    ("bounded noise, no false alarm allowed; large faults", "adaptive-threshold", "model, noise bounds"),
)
MEASURES = ("AUC, bias of 3 sigma", "exact isolation, 10 sigma", "false isolation, model mismatch")


def short(text: str) -> str:
    """The value of a cell without its interval and its explanation; "-" for one that does not apply."""
    return "-" if text == comparison.ABSENT else f"{float(text.split()[0]):.2f}"


def measured(rows: Sequence[comparison.Row], detector: str) -> tuple[list[str], ...]:
    """Of a detector its values on the plants, a list for each of MEASURES."""
    index = comparison.index_of(rows)

    def values(fault: str, metric: str) -> list[str]:
        return [short(comparison.interval(index.get((p, detector, fault, "all", metric)))) for p in comparison.PLANTS]

    mismatch = [short(comparison.worst(rows, p, detector, mismatch=True)) for p in comparison.PLANTS]
    return values("bias-3-sigma", "auc"), values("graded-10-sigma", "exact_isolation"), mismatch


def situations(rows: Sequence[comparison.Row] = ()) -> str:
    """Which detector for which situation, what each needs and, given the comparison, what it achieves on the plants."""
    lines = [
        (
            *(situation, f"`{detector}`" + " (default)" * (detector == robustness.DEFAULT), needs),
            *(map(" / ".join, measured(rows, detector)) if rows else ()),
        )
        for situation, detector, needs in CHOICES
    ]
    return comparison.table(("situation", "detector", "needs", *(MEASURES if rows else ())), lines)


def of_plant(rows: Sequence[comparison.Row], plant: str) -> str:
    """The detectors of a plant by exact isolation: detection, isolation, and false isolation in the worst cases."""
    index = comparison.index_of(rows)

    def cell(detector: str, fault: str, metric: str) -> str:
        return comparison.interval(index.get((plant, detector, fault, "all", metric)))

    there = [d for d in dict.fromkeys(r["detector"] for r in rows) if (plant, d, "bias-3-sigma", "all", "auc") in index]
    there.sort(key=lambda d: -float(index[plant, d, "graded-10-sigma", "all", "exact_isolation"]["value"]))
    lines = [
        (
            *(f"`{d}`", cell(d, "bias-3-sigma", "auc"), cell(d, "graded-10-sigma", "exact_isolation")),
            *(comparison.worst(rows, plant, d, mismatch=mismatch) for mismatch in (True, False)),
        )
        for d in there
    ]
    header = ("detector", "AUC, bias of 3 sigma", "exact isolation, 10 sigma")
    return comparison.table((*header, "false isolation, worst model mismatch", "false isolation, worst process fault"), lines)


def shown(row: Mapping[str, str]) -> str:
    """A value with its interval."""
    return row["value"] + (f" [{row['low']}, {row['high']}]" if row["low"] else "")


def of_papers(rows: Sequence[Mapping[str, str]]) -> str:
    """A table of papers.csv: rows down, columns across; one with a command for each number shows it behind."""
    columns = list(dict.fromkeys(row["column"] for row in rows))
    names = list(dict.fromkeys(row["row"] for row in rows))
    cells = {(row["row"], row["column"]): shown(row) for row in rows}
    if rows[0]["table"] in LISTS:
        return comparison.table(("what", "value", "from"), [(r["row"], shown(r), f"`{r['column']}`") for r in rows])
    return comparison.table(("", *columns), [(name, *(cells.get((name, column), "") for column in columns)) for name in names])


def tables() -> dict[str, str]:
    """All tables by name."""
    rows = comparison.load(HERE / "comparison.csv")
    trust = robustness.trust(robustness.read_rows(robustness.NUMBERS))
    found = {
        "choices": situations(),
        "findings": findings.findings(rows),
        "trust": trust,
        "paper": paper_numbers.table(),
        "recorded": real_logs_page.of_readme(real_logs.load()),
    } | {f"comparison-{plant}": of_plant(rows, plant) for plant in comparison.PLANTS}
    with (HERE / "papers.csv").open(encoding="utf-8", newline="") as file:
        papers = list(csv.DictReader(file))
    values = published_numbers.values_of(read_rows(HERE / published_numbers.NUMBERS))
    for plant in dict.fromkeys(v.own.plant for v in values):
        found[f"published-{plant}"] = published_numbers.counts_table([v for v in values if v.own.plant == plant])
    for page, name in dict.fromkeys((row["page"], row["table"]) for row in papers):
        found[f"{page}-{name}"] = of_papers([row for row in papers if (row["page"], row["table"]) == (page, name)])
    return found


def filled(page: str, found: Mapping[str, str]) -> str:
    """A page with its tables as they are; KeyError for one that is not known."""
    return MARKED.sub(lambda m: m[1] + found[m[2]] + m[4], page)


def main() -> None:
    """Write the tables of all pages."""
    found = tables()
    for path in PAGES:
        path.write_text(filled(path.read_text(encoding="utf-8"), found), encoding="utf-8")


if __name__ == "__main__":
    main()
