"""The chapter of a plant in the report of a comparison: what was found, its numbers with intervals, its figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from fusion_sfdia.comparison.figures import (
    departure_panels,
    draw_confusion,
    draw_cost,
    draw_magnitudes,
    draw_panels,
    draw_roc,
    other_panels,
)
from fusion_sfdia.comparison.findings import extremes, healthy_alarms, others_told, plant_findings
from fusion_sfdia.comparison.measures import exactly, told_distance
from fusion_sfdia.comparison.numbers import Cell, share_right
from fusion_sfdia.comparison.protocol import TROUBLED_SIGMA, settle_of, sizes
from fusion_sfdia.comparison.ranking import Standing
from fusion_sfdia.comparison.tables import (
    changes_table,
    cost_table,
    lengths_tables,
    numbers_table,
    paper_table,
    ranks_table,
)
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.experiments.scenario import Settings
from fusion_sfdia.registry import plants
from fusion_sfdia.report.content import Chapter, Figure

Cells = Mapping[str, Cell]  # of one plant, by detector


def plant_chapter(
    settings: Settings,
    cells: Cells,
    criteria: Mapping[str, Mapping[str, Standing]],
    reasons: Mapping[str, str],
    stated: Sequence[Row],
) -> Chapter:
    """What happened on a plant. criteria: its standings. reasons: of detectors that it cannot have. stated: published rows."""
    some = next(iter(cells.values()))
    model = some.model
    what = plants()[some.plant].about
    about = f"{what}; {len(model.states)} states, {len(model.sensors)} sensors, a sample every {model.dt:g} s."
    missing: dict[str, list[str]] = {}
    for detector, why in reasons.items():
        missing.setdefault(why, []).append(detector)
    absent = [f"Cannot run here: {', '.join(names)}: {why.rstrip('.')}." for why, names in missing.items()]
    tables = [
        numbers_table(settings, cells),
        *lengths_tables(settings, cells),
        ranks_table(some.plant, criteria),
        paper_table([row for row in stated if row.plant == some.plant]),
        changes_table(settings, some.plant),
        cost_table(cells),
    ]
    return Chapter(
        some.plant,
        some.plant,
        [
            about[0].upper() + about[1:],
            f"Truth behind the readings: differs from the detectors' model by {told_distance(some.plant)} at most.",
            f"A fault lasts {settings['window']} samples, {settings['window'] * model.dt:g} s, where no length is named, and "
            f"begins after {settle_of(settings, some.plant)} samples or later; all {len(model.sensors)} sensors take turns.",
            *plant_findings(settings, cells, criteria),
            *absent,
        ],
        figures(settings, cells),
        [table for table in tables if table.rows],
    )


def figures(settings: Settings, cells: Cells) -> list[Figure]:
    """Curves, magnitudes, confusion, what else was tried, departures and cost."""
    found = [
        roc_figure(settings, cells),
        magnitudes_figure(settings, cells),
        confusion_figure(cells),
        others_figure(cells),
        departures_figure(cells),
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
        f"{some.plant}-roc",
        f"Receiver operating characteristics, {some.plant}",
        f"Mean area under the curves of all kinds: {extremes(mean)}. The further up and left the better; what a "
        "detector finds is read at the rate of false alarms that one can stand. Thresholds swept over silent detectors; grey: "
        "chance.",
        partial(draw_roc, cells, swept),
        f"Detection against false-alarm probability of {len(cells)} detectors on {some.plant} for {' and '.join(swept)}",
    )


def magnitudes_figure(settings: Settings, cells: Cells) -> Figure | None:
    """Detection, isolation and delay against the size of faults."""
    some, (small, large) = next(iter(cells.values())), sizes(settings)
    if not some.graded(large):
        return None
    seen = {d: c.of(Cell.detected, *c.graded(small)).value for d, c in cells.items()}
    return Figure(
        f"{some.plant}-magnitudes",
        f"Detection, isolation and delay against the size of the fault, {some.plant}",
        f"At the common rate of false alarms. Runs with an alarm at {small:g} sigma: {extremes(seen)}. Delays are "
        "those of the runs that have an alarm. Intervals: table below and metrics.csv.",
        partial(draw_magnitudes, cells),
        f"Lines of {len(cells)} detectors over the size of bias, drift, noise and scale faults on {some.plant}",
    )


def confusion_figure(cells: Cells) -> Figure:
    """What is named, by the quantity of the faulty sensor."""
    plant = next(iter(cells.values())).plant
    right = {d: share_right(c) for d, c in cells.items()}
    return Figure(
        f"{plant}-confusion",
        f"Which quantity is named, {plant}",
        "Single faults of the two largest sizes, replays and negated readings; rows: the quantity of the faulty sensor, "
        "columns: what is named, in shares of the samples, each of several named having its share. The share of the "
        f"right sensor is {extremes(right)}.",
        partial(draw_confusion, cells),
        f"A matrix for each of {len(cells)} detectors on {plant}: faulty quantity against named quantity",
    )


def others_figure(cells: Cells) -> Figure | None:
    """What is not a single fault of a size in sigma."""
    some = next(iter(cells.values()))
    if not (shown := other_panels(some)):
        return None
    return Figure(
        f"{some.plant}-others",
        f"Other faults of sensors, and faults of the plant, {some.plant}",
        "At the common rate of false alarms; a fault of the plant is no sensor's fault. Samples with a healthy sensor "
        "named: " + others_told(cells, [name for name, _, _ in shown[0].columns]) + ".",
        partial(draw_panels, cells, shown),
        f"{len(shown)} tables of numbers on colours, detectors of {some.plant} down and conditions across",
    )


def departures_figure(cells: Cells) -> Figure | None:
    """Robustness to a wrong model."""
    some = next(iter(cells.values()))
    if not some.truths:
        return None
    worst = {t: extremes(healthy_alarms(cells.values(), t)) for t in some.truths}
    return Figure(
        f"{some.plant}-departures",
        f"Where the plant is not as believed, {some.plant}",
        "Healthy samples with an alarm: " + "; ".join(f"{t} {told}" for t, told in worst.items()) + ".",
        partial(draw_panels, cells, departure_panels(some, f"bias-{TROUBLED_SIGMA:g}-sigma")),
        f"Three tables of numbers on colours, detectors of {some.plant} down and departures across",
    )


def cost_figure(settings: Settings, cells: Cells) -> Figure | None:
    """What is named against what a step costs."""
    some, (_, large) = next(iter(cells.values())), sizes(settings)
    if not some.graded(large):
        return None
    exact = {d: exactly(settings, c) for d, c in cells.items()}
    return Figure(
        f"{some.plant}-cost",
        f"What is found, and what a step costs, {some.plant}",
        f"Samples under a fault of {large:g} sigma at which exactly the faulty sensor is named, "
        f"{extremes({d: e.value for d, e in exact.items()})}, against the least processor time of a step of one run; 95 % "
        "intervals.",
        partial(draw_cost, cells, exact),
        "A point a detector: the share of samples with the exact names over the time of a step",
    )
