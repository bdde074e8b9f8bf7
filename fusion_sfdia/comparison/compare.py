"""comparison: every detector on every plant under one protocol, at one rate of false alarms.

Its files, all comparison_*.py: what is done is protocol, with truths and published (departures, faults of plants and papers);
how it is done, work, with recordings, calibration and records; what comes out, numbers, measures, ranking and rows; how it is
told, findings, tables, figures, chapters and words.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from fusion_sfdia.comparison.chapters import plant_chapter
from fusion_sfdia.comparison.figures import Cells, draw_overview, of_plant
from fusion_sfdia.comparison.findings import absent, highlights, left_out, overview_caption, remarks
from fusion_sfdia.comparison.measures import glance
from fusion_sfdia.comparison.numbers import complete, gather
from fusion_sfdia.comparison.protocol import SETTINGS, tasks
from fusion_sfdia.comparison.ranking import CRITERIA, SHARES, clusters, ranking
from fusion_sfdia.comparison.rows import SCENARIO as NAME
from fusion_sfdia.comparison.rows import rows_of_cell
from fusion_sfdia.comparison.tables import EVERY, Standings, choices_table, ranks_table, standing_rows
from fusion_sfdia.comparison.words import words
from fusion_sfdia.comparison.work import work
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.experiments.scenario import Arrays, Scenario, Settings, Task
from fusion_sfdia.report.content import Figure, Summary


def summarise(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Rows, the matrix at a glance, and a chapter for each plant."""
    cells, reasons = gather(settings, results)
    if not cells:
        why = "; ".join(reasons.values()) or "every piece of work failed"
        return Summary((), remarks=[f"Nothing could run: {why}."])
    whole = complete(cells)
    standings = standings_of(whole)
    rows = [row for cell in cells.values() for row in rows_of_cell(cell)]
    stated = [row for row in rows if row.published is not None]
    for plant, criterion, detector, standing in standing_rows(standings):
        rows.append(Row(NAME, plant, detector, "ranked", criterion, "score", *standing.mean))
        rows.append(Row(NAME, plant, detector, "ranked", criterion, "rank", float(standing.rank), n=standing.mean.n))
    return Summary(
        rows=rows,
        figures=[overview(settings, cells)],
        tables=[
            table for table in (choices_table(settings, cells), ranks_table(EVERY, standings.get(EVERY, {}))) if table.rows
        ],
        highlights=highlights(settings, cells, standings),
        remarks=[*remarks(settings, cells), *left_out(cells, whole), *absent(settings, cells, reasons)],
        chapters=[
            plant_chapter(settings, of_plant(cells, plant), standings.get(plant, {}), of_plant(reasons, plant), stated)
            for plant in dict.fromkeys(p for p, _ in cells)
        ]
        + [words(list(dict.fromkeys(d for _, d in cells)))],
    )


def standings_of(cells: Cells) -> Standings:
    """Ranks on each plant, and over all of those detectors that run on every one of several."""
    plants = list(dict.fromkeys(plant for plant, _ in cells))
    found = {p: {c: ranking(clusters(of_plant(cells, p), c), shares=c in SHARES) for c in CRITERIA} for p in plants}
    common = [d for d in dict.fromkeys(d for _, d in cells) if all((p, d) in cells for p in plants)]
    if len(plants) > 1 and common:
        found[EVERY] = {
            c: ranking(
                {d: np.concatenate([clusters({d: cells[p, d]}, c)[d] for p in plants]) for d in common}, shares=c in SHARES
            )
            for c in CRITERIA
        }
    return found


def overview(settings: Settings, cells: Cells) -> Figure:
    """The matrix at a glance."""
    shown = glance(settings)
    return Figure(
        "overview",
        "At a glance: every detector on every plant",
        overview_caption(settings, cells),
        partial(draw_overview, cells, shown),
        f"{len(shown)} tables of numbers on colours, detectors down and plants across: {', '.join(shown)}",
    )


SCENARIO = Scenario(
    name=NAME,
    title="Comparison: every detector on every plant at one rate of false alarms",
    about="All detectors see the same readings and faults. Their thresholds are scaled to one rate of false alarms; then they "
    "are told apart by what they find, name, restore and leave in peace, where the model is right and where it is not.",
    settings=SETTINGS,
    seeds=8,
    full_seeds=100,
    tasks=tasks,
    work=work,
    summarise=summarise,
    full={"calibration_error": 0.1},
    bounds={"settle": (0, 1e6), "window": (2, 1e6), "false_alarm": (1e-6, 0.5), "calibration_error": (1e-3, 0.99)},
    optional=("lengths",),
)
