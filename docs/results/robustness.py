"""Writes robustness.csv and when-the-model-is-wrong.md: python docs/results/robustness.py METRICS...

METRICS: metrics.csv of runs of the scenario robustness; of a variant in several of them the first counts. The page holds what
robustness.csv holds; a test renders it again.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import mean, median

from fusion_sfdia.comparison.protocol import HEALTHY
from fusion_sfdia.evaluation.results import Row, read_rows, rounded, write_rows
from fusion_sfdia.report.content import Table
from fusion_sfdia.robustness.aims import BIAS, DRIFT, EXACT, FALSE, SMALL_BIAS, found, mismatches, process_faults
from fusion_sfdia.robustness.report import METHOD, cases_table, findings
from fusion_sfdia.robustness.rows import SCENARIO, index_of, variants_of
from fusion_sfdia.robustness.tables import tables_of

HERE = Path(__file__).parent
NUMBERS, PAGE = HERE / "robustness.csv", HERE / "when-the-model-is-wrong.md"
LEFT_OUT = ("step_time", "threshold_scale", "diverged")  # metrics that the page does not show
DIGITS = 3

ABOUT = """# When the model is wrong

`fusion-sfdia run robustness`: no plant is its model. The tables show what detectors do with a model that is right, with one
that is wrong, under faults of the process and under slow drifts, and what commissioning on a healthy log of the real plant
changes. In brackets 95 % intervals over seeds: 24 of them for `loo-glr` and `robust-glr`, 6 or 12 for their rivals and
for `loo-glr` on the augmented pipeline and network."""

GAINS = """**What knowing more gains.** Commissioned on a healthy log, `robust-glr` isolates a healthy sensor in at most a few
percent of the samples, in any mismatch case and under any process fault of the four plants. Estimating what the
plant declares (on augmented) cures its rivals of most of the mismatch: most of them in the median case, and `uio`
in nearly all, at the price of small faults. Commissioning alone cures them where the log shows the mismatch, and
not of what changes after it. Neither helps against faults of the process, which all but `robust-glr` and, where an
input fails, `uio` attribute to sensors. From a log alone `robust-glr`, too, takes a process fault for a sensor
fault where it shows in the readings at once: without a declared cause nothing tells it from a bias."""


def load(paths: Sequence[Path]) -> list[Row]:
    """The rows that the page shows."""
    first: dict[tuple[str, ...], Row] = {}
    for path in paths:
        for row in read_rows(path):
            key = (row.plant, row.detector, row.fault, row.condition, row.metric)
            if row.scenario == SCENARIO and row.metric not in LEFT_OUT:
                first.setdefault(key, rounded(row, DIGITS))
    return list(first.values())


def cell(value: object) -> str:
    """A cell in Markdown: text, a number, or a number with its interval."""
    if isinstance(value, tuple):
        number, low, high, _ = value
        return f"{number:.{DIGITS}g}" + (f" [{low:.{DIGITS}g}, {high:.{DIGITS}g}]" if low == low else "")
    return f"{value:.{DIGITS}g}" if isinstance(value, float) else str(value).replace("|", "\\|")


def markdown(table: Table) -> str:
    """A table with its title and what is to be known of it."""
    lines = [table.header, ["---"] * len(table.header), *([cell(c) for c in row] for row in table.rows)]
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return "\n\n".join(part for part in (f"### {table.title}", table.caption, table.method, body) if part)


def overview(rows: Sequence[Row]) -> str:
    """Each variant on all plants: exact isolation on the right model, false isolation by mismatch and by process faults."""
    index, plants = index_of(rows), list(dict.fromkeys(row.plant for row in rows))
    lines = []
    for variant in dict.fromkeys(row.detector for row in rows):
        values: list[list[float]] = [[], [], [], []]
        for plant in plants:
            exact = found(index, plant, variant, EXACT, (BIAS,), ("",))
            wrong = [r.value for r in found(index, plant, variant, FALSE, (HEALTHY,), mismatches(plant))]
            faults = [r.value for r in found(index, plant, variant, FALSE, process_faults(plant), ("",))]
            one = ([r.value for r in exact], wrong and [median(wrong)], wrong and [max(wrong)], faults and [max(faults)])
            for column, number in zip(values, one, strict=True):
                column.append(*number) if number else column.append(float("nan"))
        lines.append((variant, *(" / ".join("-" if v != v else f"{v:.2f}" for v in column) for column in values)))
    header = (
        *("detector", "right model: exact isolation, bias 10 sigma", "mismatch: false isolation, median case"),
        *("mismatch: worst case", "process faults: worst case"),
    )
    return markdown(Table("All detectors", header, tuple(lines), caption=f"Four values: {', '.join(plants)}; - not tried."))


def render(rows: Sequence[Row]) -> str:
    """The page."""
    parts = [ABOUT, *METHOD, GAINS, overview(rows)]
    for plant in dict.fromkeys(row.plant for row in rows):
        if variants_of(rows, plant):
            parts += [f"## {plant}", "\n".join(f"- {line}" for line in findings(rows, plant))]
            parts += [markdown(table) for table in (*tables_of(rows, plant), cases_table(plant))]
    return "\n\n".join(parts) + "\n"


def summary(rows: Sequence[Row], detector: str, plants: Sequence[str]) -> tuple[list[float], ...]:
    """Of a detector on each plant: area under the ROC, the mean of exact isolation of bias and drift of 10 sigma, and the
    worst false isolation in any mismatch case.
    """
    index = index_of(rows)
    areas = [index[plant, detector, SMALL_BIAS, "", "auc"].value for plant in plants]
    exact = [mean(index[plant, detector, fault, "", EXACT].value for fault in (BIAS, DRIFT)) for plant in plants]
    false = [max(r.value for r in found(index, plant, detector, FALSE, (HEALTHY,), mismatches(plant))) for plant in plants]
    return areas, exact, false


def main(paths: Sequence[Path]) -> None:
    """Write both files."""
    rows = load(paths)
    write_rows(NUMBERS, rows)
    PAGE.write_text(render(rows), encoding="utf-8")


if __name__ == "__main__":
    main([Path(path) for path in sys.argv[1:]])
