"""Writes robustness.csv, robust-limits.csv and when-the-model-is-wrong.md: python docs/results/robustness.py METRICS...

METRICS: metrics.csv of runs of the scenarios robustness and acceptance; of a detector on a plant in several of them the first
counts. Files without rows of one of them leave its numbers as they are. Without METRICS the page is written again; a test
renders it again. In robust-limits.csv the detector BEFORE is `robust-glr` of commit 170c653d, on the same readings.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from fusion_sfdia.report.content import ResultTable
from fusion_sfdia.report.figure_files import figure_svg
from fusion_sfdia.report.results import Row, read_rows, rounded, write_rows
from fusion_sfdia.study import acceptance
from fusion_sfdia.study.acceptance import met, totals, verdict
from fusion_sfdia.study.audit import RIGHT_EVENT
from fusion_sfdia.study.robustness_report import (
    DEFAULT,
    FALSE,
    METHOD,
    NAME,
    RANDOM,
    RIGHT,
    about_table,
    beside_default,
    cases_table,
    draw_levels,
    false_isolation,
    overview,
    reliability_table,
    summary_numbers,
)

HERE = Path(__file__).parent
NUMBERS, LIMITS, PAGE = HERE / "robustness.csv", HERE / "robust-limits.csv", HERE / "when-the-model-is-wrong.md"
FIGURE = HERE / "reliability.svg"
DIGITS = 3
BEFORE = "robust-glr of 170c653d"

ABOUT = """# When the model is wrong

`fusion-sfdia run robustness`: no plant is as its model and its sensors are stated. The tables show what every detector, as it
is shipped, makes of noise of other kinds, starts away from rest, model errors, and one or two causes at a time, live from the
first row: whether it isolates healthy sensors, whether its verdict is right, undecided or wrong, and how far its confidence
can be believed. Three of the plants are drawn at random, and no setting was chosen on them. Events of detectors other than
`robust-glr` and `fusing-*` were counted while an event of one or two far readings still had its full confidence, and a late
sensor was a fault."""

IMPOSSIBLE = """## What no detector can tell

- **An offset since the first row is a bias, or the model errs.** Without a log from before there is no reading that it differs
  from. The verdict is "cannot tell: p_15 or model since the start"; where a declared unknown of the plant explains it as well,
  as an outlet of a tank at rest explains a level, there is none.
- **A drift along the direction in which a declared unknown moves the readings is that unknown.** `inspect` states which of them
  the plant's sensors cannot separate, and from which size on they can.
- **Two causes that begin within a few rows** show in the same residuals; which of them began is known when one of them ends, or
  when the evidence of the rows after is there. Two sensors that fail in the same row may be named as one change of the process
  for 16 rows, and for good where that is an error of an equation.
- **Small faults in noise that is not known to be white.** How much sums of noise vary is learnt while the detector runs, from
  what slow noise would let them at first. Were it known to be white, `robust-glr` would isolate a bias of 3 sigma in 0.95 of
  its rows in place of 0.90 on two tanks, in 0.93 in place of 0.91 on the engine, and a drift to 10 sigma in 0.71 in place of
  0.70 and in as many (24 runs each, none of the tables').
- **Noise as slow as a fault.** First-order noise of 0.95 from row to row keeps its sign for some twenty rows, as a short
  bias does; only its size tells them apart.
- **A process change that is not declared** and that shows in one sensor at once is a fault of that sensor as far as the
  readings go.
- **An error that most sensors share, of a form that the model can follow.** The pipeline's `cross-talk` moves its 20 upstream
  pressures by 0 to -8 standard deviations along the pipe, as a slightly lower pressure would, and leaves the last one, `p_20`,
  as it is. Without `p_20` nothing is found in such readings; with it one sensor stands 8 standard deviations against all
  others. It does so since its pressure began to change: until readings from before rule that out, the verdict is "cannot
  tell: p_20 or model since the start", in half of the rows; in the others it is isolated."""


REASONS = """### Why, where a limit is missed

- **The pipeline's cross-talk**: see above.
- **A leak under AR(0.8).** Within some ten rows the level that falls is a fault of its gauge as far as slow noise lets the
  others contradict it. Once the gauge is out, what is left is explained by a narrower outlet, and the gauge is used again late.
- **The pipeline's leak under AR(0.8), after a log with such noise.** One leak of four is named as `m_20`, the mass flow beside
  it, which is off by 9 standard deviations at once; without a log it is a leak.
- **Delays on the engine after a log**: the heavy propeller is found after 32 rows in place of 27, fouling after 8.5 in
  place of 8.
- **The time of a step of the engine, one stream**: 1.47 on one day and 1.51 on another, at the limit.
- **The network's input gain.** `omega_4` is isolated in the row of the change, and the estimate without it stays wrong, so that
  its own readings never readmit it.
- **Two causes within some rows** show in the same residuals, and the estimate has taken up a part of the one before the other
  is named."""


def load(paths: Sequence[Path]) -> list[Row]:
    """The rows that the page is made of: of each detector on a plant those of the first file that has it, of detectors without
    a table of their own only those of the summary.
    """
    source: dict[tuple[str, str], Path] = {}
    found = []
    for path in paths:
        for row in read_rows(path):
            if row.scenario == NAME and source.setdefault((row.plant, row.detector), path) == path:
                found.append(rounded(row, DIGITS))
    in_detail = {(plant, d) for plant in dict.fromkeys(row.plant for row in found) for d in beside_default(found, plant)}
    return [row for row in found if (row.plant, row.detector) in in_detail or row.metric in (FALSE, RIGHT, RIGHT_EVENT)]


def cell(value: object) -> str:
    """A cell in Markdown: text, a number, or a number with its interval."""
    if isinstance(value, tuple):
        number, low, high, _ = value
        return f"{number:.{DIGITS}g}" + (f" [{low:.{DIGITS}g}, {high:.{DIGITS}g}]" if low == low else "")
    return f"{value:.{DIGITS}g}" if isinstance(value, float) else str(value).replace("|", "\\|")


def markdown(table: ResultTable) -> str:
    """A table with its title and what is to be known of it."""
    lines = [table.header, ["---"] * len(table.header), *([cell(c) for c in row] for row in table.rows)]
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return "\n\n".join(part for part in (f"### {table.title}", table.caption, table.method, body) if part)


ABOUT_LIMITS = """## What it had to reach

`fusion-sfdia run acceptance`: limits for `robust-glr` that stood before it was built, on seeds from 700 000 on. Nothing was
chosen on them but that sums count from eight rows on, since four runs of the network had shown what comes of shorter ones.
Decisions are taken as they come, row by row, without the second look that a diagnosis of a whole log takes. Two tanks and the
engine have 24 runs a case (P9: 8, after four logs), the pipeline and the network 4, which are few: "within its interval" says
that the limit lies in the 95 % interval. Before: the detector of commit 170c653d on the same readings. P7 is
the median of 5 turns; of the network one turn on a machine with other work, from before what has been off since the start
became one of sensor or model. P8 has 24 runs a case of the engine, after twelve logs, 4 of the others, after two, and none of
the network, which takes hours."""


def cell_of(row: Row | None) -> str:
    """A number with its interval, short."""
    if row is None:
        return "-"
    return f"{row.value:.2f}" + (f" [{row.low:.2f}, {row.high:.2f}]" if row.low == row.low else "")


RELIABILITY = f"""## How far a confidence can be believed

![Share of the events of sensors that are right, by the confidence that {DEFAULT} states](reliability.svg)

*Events of sensors in all cases of a plant, by the confidence that `{DEFAULT}` states: on the grey line that is the share of
them that are right, below it confidence is too high. 95 % intervals; the numbers stand at the end of each plant's chapter.*"""


def draw(rows: Sequence[Row]) -> str:
    """The figure of that section."""
    plants = dict.fromkeys(r.plant for r in rows if r.detector == DEFAULT)
    return figure_svg("reliability", lambda: draw_levels(rows, {plant: (plant, DEFAULT) for plant in plants}))


def limits(rows: Sequence[Row]) -> str:
    """The section on the acceptance list."""
    before = {(r.quantity, r.plant, r.condition, r.metric): r for r in rows if r.detector == BEFORE}
    now = [r for r in rows if r.detector == DEFAULT]
    plants = list(dict.fromkeys(r.plant for r in now if r.quantity == "P1"))
    noise = {(r.condition, r.plant): r for r in now if r.quantity == "P1"}
    cases = list(dict.fromkeys(case for case, _ in noise))

    def earlier(r: Row) -> Row | None:
        return before.get((r.quantity, r.plant, r.condition, r.metric))

    lines = [(case, *(f"{cell_of(earlier(r))} → {cell_of(r)}" for r in (noise[case, p] for p in plants))) for case in cases]
    header = ("item", "plant", "case", "measured", "before", "now", "limit", "verdict")
    shown = [r for r in now if r.quantity in ("P2", "P3", "P4", "P5", "P6") or not met(r)]
    others = [
        (r.quantity, r.plant, r.condition, r.metric.replace("_", " "), cell_of(earlier(r)), cell_of(r),
         ("≤ " if r.source.endswith(acceptance.AT_MOST) else "≥ ") + f"{r.published:.3g}", verdict(r))
        for r in shown
    ]  # fmt: skip
    return "\n\n".join(
        [
            ABOUT_LIMITS,
            markdown(totals(now)),
            markdown(ResultTable("P1: false isolation, before → now", ("noise", *plants), tuple(lines))),
            markdown(ResultTable("P2 to P6, and what else is not met", header, tuple(others))),
            REASONS,
        ]
    )


def trials(rows: Sequence[Row]) -> str:
    """How many trials a case has, by detector and plant."""
    found: dict[str, list[str]] = {}
    for detector in dict.fromkeys(row.detector for row in rows):
        most: dict[str, int] = {}
        for row in rows:
            if row.detector == detector and row.quantity == "readings":
                most[row.plant] = max(row.n, most.get(row.plant, 0))
        found.setdefault(", ".join(f"{plant} {n}" for plant, n in most.items()), []).append(f"`{detector}`")
    return "Trials of each case. " + "; ".join(f"{', '.join(who)}: {counts}" for counts, who in found.items()) + "."


def render(rows: Sequence[Row], of_limits: Sequence[Row] = ()) -> str:
    """The page, with the section on the acceptance list where there are rows of it."""
    parts = [ABOUT, *METHOD, trials(rows), markdown(overview(rows)), RELIABILITY, IMPOSSIBLE]
    parts += [limits(of_limits)] if of_limits else []
    for plant in dict.fromkeys(row.plant for row in rows):
        parts += [f"## {plant}", markdown(cases_table(rows, plant))]
        if (reliability := reliability_table(rows, plant)).rows:
            parts.append(markdown(reliability))
    return "\n\n".join([*parts, "## What is tried", markdown(about_table())]) + "\n"


def summary(rows: Sequence[Row], detector: str, plants: Sequence[str]) -> tuple[list[float], ...]:
    """Of a detector on each plant the numbers of `summary_numbers`, a list each; NaN where it was not run."""
    found = zip(*(summary_numbers(rows, plant, detector) for plant in plants), strict=True)
    return tuple(list(values) for values in found)


def trust(rows: Sequence[Row]) -> str:
    """A sentence on the default detector over all plants: how much of it is right, and where it is not."""
    plants = list(dict.fromkeys(row.plant for row in rows if row.detector == DEFAULT))
    every = [(row, plant) for plant in plants for row in false_isolation(rows, plant, DEFAULT)]
    kept = sum(row.value <= 0.02 for row, _ in every)
    worst, where = max(every, key=lambda one: one[0].value)
    bias = summary(rows, DEFAULT, plants)[2]
    drawn = sum(plant.startswith(RANDOM) for plant in plants)
    return (
        "The numbers are from simulated plants whose model is nearly right. **Where the model error exceeds the noise, most "
        "detectors isolate healthy sensors**, and nearly all attribute a process fault, such as a leak, to a sensor. "
        f"`{DEFAULT}`, the default, tests process and model beside the sensors, as far as the plant states what is uncertain "
        f"in it, or a healthy log has shown it. Live from the first row, under {len(every)} errors of readings, start and "
        f"model on {len(plants)} plants, {drawn} of them drawn at random, it isolates a healthy sensor in at most 2 % of the "
        f"rows in {kept}; the worst is {worst.value:.0%} ({where}, {worst.condition}). Of the rows with a bias of 10 sigma "
        f"{min(bias):.0%} to {max(bias):.0%} have a right verdict: "
        "[measured limits](docs/results/when-the-model-is-wrong.md)."
    )


def main(paths: Sequence[Path]) -> None:
    """Write both files, without paths the page alone."""
    rows = load(paths) or read_rows(NUMBERS)
    of_limits = [rounded(r, DIGITS) for path in paths for r in read_rows(path) if r.scenario == acceptance.NAME]
    of_limits = of_limits or read_rows(LIMITS)
    write_rows(NUMBERS, rows)
    write_rows(LIMITS, of_limits)
    PAGE.write_text(render(rows, of_limits), encoding="utf-8")
    FIGURE.write_text(draw(rows), encoding="utf-8")


if __name__ == "__main__":
    main([Path(path) for path in sys.argv[1:]])
