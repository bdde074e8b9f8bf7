"""The chapters of a comparison's report: of each plant its findings, figures and tables; the words and the detectors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial

import numpy as np

from fusion_sfdia.report.content import Chapter, Figure, ResultTable
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import span
from fusion_sfdia.study.comparison.cell import ComparisonCell
from fusion_sfdia.study.comparison.conclusions import plant_findings
from fusion_sfdia.study.comparison.figures import (
    draw_confusion,
    draw_cost,
    draw_magnitudes,
    draw_panels,
    draw_roc,
    example_figure,
    mismatch_panels,
    other_panels,
)
from fusion_sfdia.study.comparison.looks import prominent
from fusion_sfdia.study.comparison.metric_rows import exact_isolation, share_right
from fusion_sfdia.study.comparison.protocol import HEALTHY, MISMATCH_SIGMA, settle_of, sizes
from fusion_sfdia.study.comparison.ranking import RankedDetector
from fusion_sfdia.study.comparison.recordings import stated_distance
from fusion_sfdia.study.comparison.result_tables import (
    changes_table,
    cost_table,
    lengths_tables,
    numbers_table,
    paper_table,
    ranks_table,
)
from fusion_sfdia.study.comparison.subjects import ComparedDetector
from fusion_sfdia.study.experiments.scenario import Settings

Cells = Mapping[str, ComparisonCell]  # of one plant, by detector

WORDS = {
    "sigma": "the standard deviation of a sensor's noise",
    "detection": "an alarm while a sensor is faulty: some residual is beyond its threshold",
    "isolation": "the faulty sensor is identified; exact isolation: it alone",
    "accommodation": "isolated and missing readings are replaced; the error after over that before, of the faulty sensors",
    "exoneration": "no false isolation where no sensor is faulty, or readings are missing",
    "false isolation": "a healthy sensor is isolated",
    "mismatch case": "model mismatch: a plant that differs from its model, or an operation on which nothing was learnt; no "
    "sensor is faulty",
    "process fault": "a fault of the plant, not of a sensor; no sensor is faulty",
    "area under the ROC": "the chance that a sample with a fault scores higher than one without: 0.5 is guessing. It counts "
    "single samples; a run has an alarm where any of its samples has",
    "mean area": "the mean of the areas of bias, drift, noise and scale of a size, and of a freeze, which has none",
    "memory": "over what a detector's test gathers evidence: present readings only, a filter's state, some samples, a sum",
    "common rate": "the rate of alarms without a fault to which the thresholds of all detectors are scaled",
    "as deployed": "with all consequences of an alarm: sensors that stay isolated, alarms that stay on",
    "silent": "with thresholds out of reach, so that nothing is ever isolated or replaced; its scores give the ROC",
    "cluster": "the runs of a seed with one kind of fault, which share noise and sensor and count once",
    "freeze, replay, sign": "a reading that stays as it was; earlier ones over again; its negative",
    "truth": "what makes the readings: the high-fidelity model of a plant where it has one; see the tables' heads",
    "K22, K24; V22; B18": "Kougiatsos 2022 and 2024; its virtual sensors, 2022; Boem 2018",
    ":paper, :corrected, :calibrated": "as printed; with misprints corrected; with margins chosen by us",
}


def plant_chapter(
    settings: Settings,
    cells: Cells,
    criteria: Mapping[str, Mapping[str, RankedDetector]],
    reasons: Mapping[str, str],
    published: Sequence[Row],
) -> Chapter:
    """The results on a plant. criteria: its standings. reasons: of detectors that are not applicable. published: rows with a
    published number.
    """
    some = next(iter(cells.values()))
    model = some.model
    about = some.subject.entry.about or some.plant
    size = f"{len(model.states)} states, {len(model.sensors)} sensors, a sample every {model.dt:g} s"
    about = f"{about[0].upper() + about[1:]}; {size}."
    missing: dict[str, list[str]] = {}
    for detector, why in reasons.items():
        missing.setdefault(why, []).append(detector)
    absent = [f"Not applicable to this plant: {', '.join(names)}: {why.rstrip('.')}." for why, names in missing.items()]
    tables = [
        numbers_table(settings, cells),
        *lengths_tables(settings, cells),
        ranks_table(some.plant, criteria),
        paper_table([row for row in published if row.plant == some.plant]),
        changes_table(settings, some),
        cost_table(cells),
    ]
    return Chapter(
        some.subject.slug,
        some.plant,
        text=[about, *plant_findings(settings, cells)],
        method=[
            f"Truth behind the readings: differs from the detectors' model by {stated_distance(some.subject)} at most.",
            f"A fault lasts {settings['window']} samples, {settings['window'] * model.dt:g} s, where no length is stated, and "
            f"begins after {settle_of(settings, some.cases)} samples or later; all {len(model.sensors)} sensors take turns.",
            *absent,
        ],
        figures=figures(settings, cells),
        tables=[table for table in tables if table.rows],
    )


def figures(settings: Settings, cells: Cells) -> list[Figure]:
    """The example, curves, magnitudes, confusion, other faults, model mismatch and cost."""
    found = [
        example_figure(settings, cells),
        roc_figure(settings, cells),
        magnitudes_figure(settings, cells),
        confusion_figure(cells),
        others_figure(cells),
        mismatch_figure(cells),
        cost_figure(settings, cells),
    ]
    return [figure for figure in found if figure is not None]


def roc_figure(settings: Settings, cells: Cells) -> Figure | None:
    """Curves of the small faults of each kind."""
    some, (small, _) = next(iter(cells.values())), sizes(settings)
    swept = [n for n in some["swept_condition"].tolist() if n == "freeze" or n in some.graded(small)]
    if not swept:
        return None
    mean = {d: c.mean_area(small).value for d, c in cells.items()}
    return Figure(
        f"{some.subject.slug}-roc",
        f"Receiver operating characteristics, {some.plant}",
        f"Mean area under the curves of all kinds: {extremes(mean)}. Further up and left is better; read "
        "a curve at the rate of false alarms that is acceptable. Thresholds swept over silent detectors; grey: chance.",
        partial(draw_roc, cells, swept, prominent(mean)),
        f"Detection against false-alarm probability of {len(cells)} detectors on {some.plant} for {' and '.join(swept)}",
    )


def magnitudes_figure(settings: Settings, cells: Cells) -> Figure | None:
    """Detection, isolation and delay against the size of faults."""
    some, (small, large) = next(iter(cells.values())), sizes(settings)
    if not some.graded(large):
        return None
    seen = {d: c.of(ComparisonCell.detected, *c.graded(small)).value for d, c in cells.items()}
    return Figure(
        f"{some.subject.slug}-magnitudes",
        f"Detection, isolation and delay against the size of the fault, {some.plant}",
        f"At the common rate of false alarms. Runs with an alarm at {small:g} sigma: {extremes(seen)}. Delays are "
        "those of the runs that have an alarm. Intervals: table below and metrics.csv.",
        partial(draw_magnitudes, cells, prominent(seen)),
        f"Lines of {len(cells)} detectors over the size of bias, drift, noise and scale faults on {some.plant}",
    )


def confusion_figure(cells: Cells) -> Figure:
    """What is isolated, by the quantity of the faulty sensor."""
    some = next(iter(cells.values()))
    plant = some.plant
    right = {d: share_right(c) for d, c in cells.items()}
    return Figure(
        f"{some.subject.slug}-confusion",
        f"Which quantity is isolated, {plant}",
        "Single faults of the two largest sizes, replays and negated readings; rows: the quantity of the faulty sensor, "
        "columns: what is isolated, in shares of the samples, each of several having its share. The share of the "
        f"faulty sensor is {extremes(right)}.",
        partial(draw_confusion, cells),
        f"A matrix for each of {len(cells)} detectors on {plant}: faulty quantity against isolated quantity",
    )


def others_figure(cells: Cells) -> Figure | None:
    """What is not a single fault of a size in sigma."""
    some = next(iter(cells.values()))
    if not (shown := other_panels(some)):
        return None
    return Figure(
        f"{some.subject.slug}-others",
        f"Other sensor faults, and process faults, {some.plant}",
        "Samples with false isolation: "
        + false_isolation_extremes(cells, [column.name for column in shown[0].columns])
        + ". At the common rate of false alarms; under a process fault no sensor is faulty.",
        partial(draw_panels, cells, shown),
        f"{len(shown)} tables of numbers on colours, detectors of {some.plant} down and conditions across",
    )


def mismatch_figure(cells: Cells) -> Figure | None:
    """Robustness to model mismatch."""
    some = next(iter(cells.values()))
    if not some.mismatches:
        return None
    worst = {m: extremes(healthy_alarms(cells.values(), m)) for m in some.mismatches}
    return Figure(
        f"{some.subject.slug}-mismatch",
        f"Model mismatch, {some.plant}",
        "Healthy samples with an alarm: " + "; ".join(f"{m} {shares}" for m, shares in worst.items()) + ".",
        partial(draw_panels, cells, mismatch_panels(some, f"bias-{MISMATCH_SIGMA:g}-sigma")),
        f"Three tables of numbers on colours, detectors of {some.plant} down and mismatch cases across",
    )


def cost_figure(settings: Settings, cells: Cells) -> Figure | None:
    """Exact isolation against the cost of a step."""
    some, (_, large) = next(iter(cells.values())), sizes(settings)
    if not some.graded(large):
        return None
    exact = {d: exact_isolation(settings, c) for d, c in cells.items()}
    return Figure(
        f"{some.subject.slug}-cost",
        f"Exact isolation, and the cost of a step, {some.plant}",
        f"Samples under a fault of {large:g} sigma at which exactly the faulty sensor is isolated, "
        f"{extremes({d: e.value for d, e in exact.items()})}, against the least processor time of a step of one run; 95 % "
        "intervals.",
        partial(draw_cost, cells, exact),
        "A point a detector: the share of samples with exact isolation over the time of a step",
    )


def words_chapter(detectors: Sequence[ComparedDetector]) -> Chapter:
    """What the words mean, and what each of the detectors is."""
    return Chapter(
        "words",
        "Words and detectors",
        tables=[
            ResultTable("Words", ("word", "what it means here"), tuple(WORDS.items())),
            ResultTable(
                "Detectors",
                ("detector", "memory", "what it is"),
                tuple((d.name, d.entry.memory or "not stated", d.entry.about or "not stated") for d in detectors),
            ),
        ],
    )


def extremes(values: Mapping[str, float]) -> str:
    """The least and the largest by name; of a single one its value."""
    known = {k: v for k, v in values.items() if np.isfinite(v)}
    if not known:
        return "none is known"
    low, high = min(known, key=lambda k: known[k]), max(known, key=lambda k: known[k])
    if len(known) == 1:
        return f"{span([known[low]])} ({low})"
    return f"from {span([known[low]])} ({low}) to {span([known[high]])} ({high})"


def false_isolation_extremes(cells: Mapping[str, ComparisonCell], names: Sequence[str]) -> str:
    """Least and largest false isolation by condition."""
    return "; ".join(f"{n} {extremes({d: c.false_isolation(c.rows_of(n)).value for d, c in cells.items()})}" for n in names)


def healthy_alarms(cells: Iterable[ComparisonCell], mismatch: str) -> dict[str, float]:
    """Share of healthy samples with an alarm in a mismatch case, by detector."""
    return {c.detector: c.alarms(c.rows_of(HEALTHY, mismatch=mismatch)).value for c in cells}
