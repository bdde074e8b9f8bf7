"""The tables and figures of `robustness`, made of the rows of its metrics.csv."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from statistics import mean, median
from typing import Any

import numpy as np

from fusion_sfdia.report.content import Chapter, Figure, Interval, ResultTable, Summary
from fusion_sfdia.report.plots import panels
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.audit import DELAY, LEVELS, METRICS, RIGHT_EVENT
from fusion_sfdia.study.comparison.figures import heat
from fusion_sfdia.study.error_protocol import CASES, OF_PLANT
from fusion_sfdia.study.experiments.scenario import Arrays, Task

Results = list[tuple[Task, Arrays]]
Index = Mapping[tuple[str, str, str, str], Row]

NAME = "robustness"
DEFAULT = "robust-glr"
RIVALS = 2  # shown beside it, case by case
FALSE, RIGHT = METRICS["false"], METRICS["right"]
BIAS = "bias-10"
WITHOUT_CAUSE = ("readings", "start", "model")  # groups
PROCESS_CASES = ("process-pulse", "process-step", "process-ramp")
MISMATCH, PROCESS_FAULT = "mismatch: ", "process fault: "  # before names of cases that stand beside a plant
RANDOM = "random plant"
SURE = "confidence {:g} to {:g}".format(*LEVELS[-1])
METHOD = (
    "Rows are judged from the first one on, with the thresholds that each detector has by default. Readings come from the "
    "high-fidelity model of each plant, unless its parameters, equations or start differ. Causes begin after a third of the "
    "rows and last a third; a process fault that stands beside a plant lasts to the end. Seeds were used for nothing else, "
    "and the random plants have no page and no settings of their own.",
    "False isolation: share of all rows in which a healthy sensor is isolated. Of the rows with a cause (without one: of all), "
    "right: exactly the faulty sensors are isolated, and the process is named if and only if it differs; any name of the "
    "process counts. Wrong: a healthy sensor is isolated, or the process is named and is as modelled; within 20 rows after a "
    "repair neither counts. Undecided: neither, with suspects or without an estimate. Missed: nothing is reported. Delay: "
    "rows until the first right one, median. In brackets 95 % intervals over seeds.",
)


def index_of(rows: Iterable[Row]) -> Index:
    """Rows by plant, detector, case and metric."""
    return {(r.plant, r.detector, r.condition, r.metric): r for r in rows}


def names_in(rows: Iterable[Row], what: str) -> list[str]:
    """The plants, detectors or cases of rows, in their order."""
    return list(dict.fromkeys(getattr(r, what) for r in rows))


def cases_in(rows: Iterable[Row], plant: str) -> list[str]:
    """The cases of a plant."""
    return list(dict.fromkeys(r.condition for r in rows if r.plant == plant and r.metric == FALSE))


def false_isolation(rows: Iterable[Row], plant: str, detector: str) -> list[Row]:
    """The rows of false isolation where readings, start or model are not as stated and nothing fails."""
    return [
        r
        for r in rows
        if (r.plant, r.detector, r.metric) == (plant, detector, FALSE)
        and (r.quantity in WITHOUT_CAUSE or r.condition.startswith(MISMATCH))
        and r.n
    ]


def right_of_process(rows: Iterable[Row], plant: str, detector: str) -> list[float]:
    """The shares of right verdicts where the process alone fails."""
    return [
        r.value
        for r in rows
        if (r.plant, r.detector, r.metric) == (plant, detector, RIGHT)
        and (r.condition in PROCESS_CASES or r.condition.startswith(PROCESS_FAULT))
        and r.n
    ]


def summary_numbers(rows: Sequence[Row], plant: str, detector: str) -> tuple[float, ...]:
    """Of a detector on a plant: false isolation in the worst and the median case, right verdicts under a bias of 10 sigma and
    under process faults, and events with a confidence of the highest of LEVELS that are right; NaN for what is not known.
    """
    index = index_of(rows)
    false = [r.value for r in false_isolation(rows, plant, detector)]
    process = right_of_process(rows, plant, detector)
    bias, sure = (index.get((plant, detector, *key)) for key in ((BIAS, RIGHT), (SURE, RIGHT_EVENT)))
    return (
        max(false, default=np.nan),
        median(false) if false else np.nan,
        bias.value if bias is not None else np.nan,
        mean(process) if process else np.nan,
        sure.value if sure is not None and sure.n else np.nan,
    )


def overview(rows: Sequence[Row]) -> ResultTable:
    """All detectors: each cell has a value a registered plant, and one that is the mean of the random plants."""
    plants = names_in(rows, "plant")
    own, drawn = ([p for p in plants if p.startswith(RANDOM) == is_drawn] for is_drawn in (False, True))
    lines = []
    for detector in names_in(rows, "detector"):
        numbers = {p: summary_numbers(rows, p, detector) for p in plants}
        columns = []
        for k in range(5):
            of_drawn = [numbers[p][k] for p in drawn if not np.isnan(numbers[p][k])]
            values = [*(numbers[p][k] for p in own), *([mean(of_drawn) if of_drawn else np.nan] if drawn else [])]
            columns.append(" / ".join("-" if np.isnan(v) else f"{v:.2f}" for v in values))
        lines.append((detector, *columns))
    header = (
        *("detector", "false isolation, worst case", "false isolation, median case", "right, bias of 10 sigma"),
        *("right, process faults", "right events, confidence .9 to 1"),
    )
    shown = ", ".join([*own, *([f"mean of {len(drawn)} random plants"] if drawn else [])])
    return ResultTable(
        "All detectors",
        header,
        tuple(lines),
        caption=f"Values: {shown}; - not applicable, or no such event. Cases of false isolation: readings, start and model "
        "that are not as stated, without a fault.",
    )


def beside_default(rows: Sequence[Row], plant: str) -> list[str]:
    """The default detector, and the rivals with the largest mean share of right verdicts on a plant."""
    shares: dict[str, list[float]] = {}
    for r in rows:
        if r.plant == plant and r.metric == RIGHT and r.n:
            shares.setdefault(r.detector, []).append(r.value)
    rivals = sorted((d for d in shares if d != DEFAULT), key=lambda d: -mean(shares[d]))
    return [*([DEFAULT] if DEFAULT in shares else []), *rivals[:RIVALS]]


def cases_table(rows: Sequence[Row], plant: str) -> ResultTable:
    """The default detector and its best rivals, case by case."""
    index = index_of(rows)
    lines: list[tuple[str | Interval, ...]] = []
    for case in cases_in(rows, plant):
        for detector in beside_default(rows, plant):
            found = [index.get((plant, detector, case, metric)) for metric in (*METRICS.values(), DELAY)]
            if found[0] is None or not found[0].n:
                continue
            first = found[0]
            others = ["-" if r is None or not np.isfinite(r.value) else f"{r.value:.2f}" for r in found[1:-1]]
            delay = found[-1]
            wait = "-" if delay is None or not np.isfinite(delay.value) else f"{delay.value:.0f}"
            lines.append((case, detector, (first.value, first.low, first.high, first.n), *others, wait))
    header = ("case", "detector", "false isolation", "right", "undecided", "wrong", "missed", "delay, rows")
    return ResultTable(f"{plant}, case by case", header, tuple(lines))


def reliability_table(rows: Sequence[Row], plant: str) -> ResultTable:
    """Of the events of sensors with a confidence, the share that is right."""
    index = index_of(rows)
    lines: list[tuple[str | Interval, ...]] = []
    for detector in names_in((r for r in rows if r.plant == plant), "detector"):
        cells: list[str | Interval] = []
        for low, high in LEVELS:
            r = index.get((plant, detector, f"confidence {low:g} to {high:g}", RIGHT_EVENT))
            cells.append("-" if r is None or not r.n else (r.value, r.low, r.high, r.n))
        if any(cell != "-" for cell in cells):
            lines.append((detector, *cells))
    header = ("detector", *(f"stated {low:g} to {high:g}" for low, high in LEVELS))
    return ResultTable(f"{plant}: events that are right, by their confidence", header, tuple(lines))


def about_table() -> ResultTable:
    """What the cases are."""
    lines = tuple((c.group, c.name, c.about) for c in CASES)
    of_plant = (OF_PLANT, f"{MISMATCH}... , {PROCESS_FAULT}...", "stated beside the plant, with their reasons")
    return ResultTable("What is tried", ("group", "case", "what differs"), (*lines, of_plant), folded=True)


def summary_of(rows: Sequence[Row], remarks: Sequence[str]) -> Summary:
    """The report: all detectors first, then a chapter a plant."""
    plants = names_in(rows, "plant")
    highlights = []
    for plant in plants:
        if false := false_isolation(rows, plant, DEFAULT):
            worst = max(false, key=lambda r: r.value)
            highlights.append(
                f"{plant}, {DEFAULT}: a healthy sensor is isolated in at most {worst.value:.2f} of the rows, without a fault "
                f"({worst.condition})."
            )
    return Summary(
        rows=rows,
        tables=[overview(rows), about_table()] if rows else [],
        chapters=[chapter(rows, plant) for plant in plants],
        highlights=highlights,
        remarks=remarks,
        method=METHOD,
    )


def chapter(rows: Sequence[Row], plant: str) -> Chapter:
    """What detectors make of a plant."""
    slug = re.sub(r"[^a-z0-9]+", "-", plant.lower()).strip("-")
    figures = [
        Figure(
            slug,
            f"{plant}: every detector, every case",
            "Orange: rows in which a healthy sensor is isolated, none is right. Blue: verdicts that are right. Grey: not "
            "applicable.",
            partial(draw_cases, rows, plant),
            f"Shares of false isolation and of right verdicts of each detector in each case on {plant}",
        )
    ]
    reliability = reliability_table(rows, plant)
    if reliability.rows:
        figures.append(
            Figure(
                f"{slug}-confidence",
                f"{plant}: how far a confidence can be believed",
                "On the diagonal a stated confidence is the share of events that are right; below it, confidence is too high.",
                partial(draw_reliability, rows, plant),
                f"Share of events that are right by their stated confidence, of each detector with confidences on {plant}",
            )
        )
    return Chapter(
        slug, plant, figures=figures, tables=[cases_table(rows, plant), *([reliability] if reliability.rows else [])]
    )


def draw_cases(rows: Sequence[Row], plant: str) -> Any:
    """Detectors down, cases across; false isolation above, right verdicts below."""
    index, cases = index_of(rows), cases_in(rows, plant)
    detectors = names_in((r for r in rows if r.plant == plant), "detector")
    titles = {"rows in which a healthy sensor is isolated": FALSE, "right verdicts": RIGHT}
    figure, axes = panels(list(titles), columns=1, width=4.0 + 0.32 * len(cases), height=2.2 + 0.22 * len(detectors))
    for axis, metric in zip(axes, titles.values(), strict=True):
        found = [[index.get((plant, d, case, metric)) for case in cases] for d in detectors]
        values = np.array([[np.nan if r is None else r.value for r in line] for line in found])
        heat(axis, values, detectors, cases, less=metric == FALSE)
    return figure


def draw_reliability(rows: Sequence[Row], plant: str) -> Any:
    """The share of right events of each detector at the middle of each level of confidence, with its interval."""
    return draw_levels(rows, {d: (plant, d) for d in names_in((r for r in rows if r.plant == plant), "detector")})


def draw_levels(rows: Sequence[Row], lines: Mapping[str, tuple[str, str]]) -> Any:
    """The same of any pairs of a plant and a detector, by the names of the lines."""
    figure, (axis,) = panels(["events"], columns=1, width=6.0, height=4.0)
    index = index_of(rows)
    axis.plot([0, 1], [0, 1], color="0.6", linewidth=0.8)
    for name, of in lines.items():
        points = []
        for low, high in LEVELS:
            r = index.get((*of, f"confidence {low:g} to {high:g}", RIGHT_EVENT))
            if r is not None and r.n:
                points.append(((low + high) / 2, r.value, r.low, r.high))
        if points:
            x, y, low_y, high_y = np.array(points).T
            errors = np.maximum([y - low_y, high_y - y], 0.0)
            axis.errorbar(x, y, errors, marker="o", markersize=4, capsize=2, label=name)
    axis.set(xlabel="confidence stated", ylabel="share that is right", xlim=(0, 1), ylim=(0, 1.02))
    figure.legend(loc="outside right upper", fontsize=7)
    return figure
