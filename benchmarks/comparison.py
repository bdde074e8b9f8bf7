"""comparison: every detector on every plant under one protocol, at one rate of false alarms."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from fusion_sfdia.benchmarks.comparison_figures import (
    Cells,
    departure_panels,
    draw_confusion,
    draw_cost,
    draw_magnitudes,
    draw_overview,
    draw_panels,
    draw_roc,
    of_plant,
    other_panels,
)
from fusion_sfdia.benchmarks.comparison_findings import (
    areas,
    extremes,
    healthy_alarms,
    highlights,
    others_told,
    overview_caption,
    remarks,
)
from fusion_sfdia.benchmarks.comparison_numbers import Cell, gather, share_right
from fusion_sfdia.benchmarks.comparison_protocol import SETTINGS, TROUBLED_SIGMA, tasks
from fusion_sfdia.benchmarks.comparison_ranking import CRITERIA, clusters, ranking
from fusion_sfdia.benchmarks.comparison_rows import SCENARIO as NAME
from fusion_sfdia.benchmarks.comparison_rows import rows_of_cell
from fusion_sfdia.benchmarks.comparison_tables import EVERY, LOGARITHMIC, Standings, glance, sizes, standing_rows, tables
from fusion_sfdia.benchmarks.comparison_work import work
from fusion_sfdia.benchmarks.results import Row
from fusion_sfdia.benchmarks.scenario import Arrays, Figure, Scenario, Settings, Summary, Task


def summarise(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Rows, tables and figures of all cells."""
    cells, reasons = gather(settings, results)
    standings = standings_of(settings, cells)
    rows = [row for cell in cells.values() for row in rows_of_cell(cell)]
    for plant, criterion, detector, standing in standing_rows(standings):
        rows.append(Row(NAME, plant, detector, "ranked", criterion, "score", *standing.mean))
        rows.append(Row(NAME, plant, detector, "ranked", criterion, "rank", float(standing.rank), n=standing.mean.n))
    return Summary(
        rows=rows,
        figures=figures(settings, cells) if cells else [],
        tables=tables(settings, cells, reasons, standings) if cells else [],
        highlights=highlights(settings, cells, standings),
        remarks=remarks(settings, cells) if cells else [f"Nothing could run: {'; '.join(reasons.values())}."],
    )


def standings_of(settings: Settings, cells: Cells) -> Standings:
    """Ranks on each plant, and over all of those detectors that run on every one of several."""
    plants = list(dict.fromkeys(plant for plant, _ in cells))
    found = {p: {c: ranking(clusters(of_plant(cells, p), c)) for c in CRITERIA} for p in plants}
    common = [d for d in dict.fromkeys(d for _, d in cells) if all((p, d) in cells for p in plants)]
    if len(plants) > 1 and common:
        found[EVERY] = {
            c: ranking({d: np.concatenate([clusters({d: cells[p, d]}, c)[d] for p in plants]) for d in common})
            for c in CRITERIA
        }
    return found


def figures(settings: Settings, cells: Cells) -> list[Figure]:
    """The overview, then the figures of each plant, then what it costs."""
    numbers = glance(settings)
    logarithmic = [title for title in numbers if title.startswith(LOGARITHMIC)]
    found = [
        Figure(
            "overview",
            "Every detector on every plant",
            overview_caption(settings, cells),
            partial(draw_overview, cells, numbers, logarithmic),
            f"{len(numbers)} tables of numbers on colours, detectors down and plants across: {', '.join(numbers)}",
        )
    ]
    for plant in dict.fromkeys(p for p, _ in cells):
        found += plant_figures(settings, plant, of_plant(cells, plant))
    exact = {f"{d} on {p}": c.exact(c.rows_of(*c.graded(sizes(settings)[1]))).value for (p, d), c in cells.items()}
    found.append(
        Figure(
            "cost",
            "What is found, and what a step costs",
            f"Samples under a fault of {sizes(settings)[1]:g} sigma at which exactly the faulty sensor is named, "
            f"{extremes(exact)}, against the least processor time of a step of one run; 95 % intervals.",
            partial(draw_cost, cells, _exact_of(sizes(settings)[1])),
            "A panel a plant, a point a detector: the share of samples with the exact names over the time of a step",
        )
    )
    return found


def _exact_of(size: float) -> Any:
    return lambda cell: cell.exact(cell.rows_of(*cell.graded(size)))


def plant_figures(settings: Settings, plant: str, cells: Mapping[str, Cell]) -> list[Figure]:
    """Curves, magnitudes, confusion and departures of one plant."""
    some = next(iter(cells.values()))
    found = []
    swept = [n for n in some["swept_condition"].tolist() if n.startswith("bias")][:2]
    if swept:
        found.append(
            Figure(
                f"{plant}-roc",
                f"Receiver operating characteristics, {plant}",
                areas(cells, swept) + " Thresholds swept over silent detectors; grey: chance.",
                partial(draw_roc, cells, swept),
                f"Detection against false-alarm probability of {len(cells)} detectors on {plant} for {' and '.join(swept)}",
            )
        )
    small, large = sizes(settings)
    if some.graded(large):
        seen = {d: c.detected(c.rows_of(*c.graded(small))).value for d, c in cells.items()}
        found.append(
            Figure(
                f"{plant}-magnitudes",
                f"Detection, isolation and delay against the size of the fault, {plant}",
                f"At the common rate of false alarms. Runs with an alarm at {small:g} sigma: {extremes(seen)}. Delays are "
                "those of the runs that have an alarm.",
                partial(draw_magnitudes, cells),
                f"Lines of {len(cells)} detectors over the size of bias, drift, noise and scale faults on {plant}",
            )
        )
    right = {d: share_right(c) for d, c in cells.items()}
    found.append(
        Figure(
            f"{plant}-confusion",
            f"Which quantity is named, {plant}",
            "Single faults of the two largest sizes, replays and negated readings; rows: the quantity of the faulty sensor, "
            "columns: what is named, in shares of the samples, each of several named having its share. The share of the "
            f"right sensor is {extremes(right)}.",
            partial(draw_confusion, cells),
            f"A matrix for each of {len(cells)} detectors on {plant}: faulty quantity against named quantity",
        )
    )
    if shown := other_panels(some):
        found.append(
            Figure(
                f"{plant}-others",
                f"Several faults, missing readings, attacks, faults of the plant, {plant}",
                "At the common rate of false alarms; a fault of the plant is no sensor's fault. Samples with a healthy sensor "
                "named: " + others_told(cells, [name for name, _, _ in shown[0].columns]) + ".",
                partial(draw_panels, cells, shown),
                f"Three tables of numbers on colours, detectors of {plant} down and conditions across",
            )
        )
    if some.truths:
        worst = {t: extremes(healthy_alarms(cells.values(), t)) for t in some.truths}
        found.append(
            Figure(
                f"{plant}-departures",
                f"Where the plant is not as believed, {plant}",
                "Healthy samples with an alarm: " + "; ".join(f"{t} {told}" for t, told in worst.items()) + ".",
                partial(draw_panels, cells, departure_panels(some, f"bias-{TROUBLED_SIGMA:g}-sigma")),
                f"Three tables of numbers on colours, detectors of {plant} down and departures across",
            )
        )
    return found


SCENARIO = Scenario(
    name=NAME,
    title="Comparison: every detector on every plant at one rate of false alarms",
    about="All detectors see the same readings and faults. Their thresholds are scaled to one rate of false alarms; then they "
    "are told apart by what they find, name, restore and leave in peace, where the model is right and where it is not.",
    settings=SETTINGS,
    seeds=5,
    full_seeds=100,
    tasks=tasks,
    work=work,
    summarise=summarise,
    full={"all_sensors": True, "calibration_seeds": 40, "calibration_steps": 1000},
)
