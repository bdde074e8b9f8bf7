"""From the results of a comparison to its rows and its report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.comparison.cell import Cells, ComparisonCell, mean, of_plant
from fusion_sfdia.study.comparison.chapters import plant_chapter, words_chapter
from fusion_sfdia.study.comparison.conclusions import absent, findings, left_out, opening, remarks
from fusion_sfdia.study.comparison.figures import draw_overview, loss_figure
from fusion_sfdia.study.comparison.loss import loss_parts
from fusion_sfdia.study.comparison.metric_rows import SCENARIO, best_isolation, glance, rows_of_cell
from fusion_sfdia.study.comparison.ranking import CRITERIA, RankedDetector, by_seed, ranking
from fusion_sfdia.study.comparison.result_tables import EVERY, Standings, choices_table, ranks_table, standing_rows
from fusion_sfdia.study.comparison.subjects import Subjects
from fusion_sfdia.study.experiments.scenario import Arrays, Settings, Task


def summarise(subjects: Subjects, settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Rows, the overview, and a chapter for each plant."""
    cells, reasons = gather(subjects, settings, results)
    if not cells:
        why = "; ".join(reasons.values()) or "every piece of work failed"
        return Summary((), remarks=[f"Nothing could run: {why}."])
    whole = complete(cells)
    standings = standings_of(whole, settings)
    rows = [row for cell in cells.values() for row in rows_of_cell(cell)]
    published = [row for row in rows if row.published is not None]
    for plant, criterion, detector, standing in standing_rows(standings):
        rows.append(Row(SCENARIO, plant, detector, "ranked", criterion, "score", *standing.mean))
        rows.append(Row(SCENARIO, plant, detector, "ranked", criterion, "rank", float(standing.rank), n=standing.mean.n))
    for (plant, detector), cell in whole.items():
        for part, values in loss_parts(cell, settings).items():
            rows.append(Row(SCENARIO, plant, detector, "ranked", part, "loss_part", *mean(by_seed(values, len(cell.seeds)))))
    first, *more = [
        plant_chapter(settings, of_plant(cells, plant), standings.get(plant, {}), of_plant(reasons, plant), published)
        for plant in dict.fromkeys(p for p, _ in cells)
    ]
    example, *figures = first.figures  # that of the first plant stands at the top
    ranked = [loss_figure(settings, whole, standings)] if whole else []
    words = words_chapter([subjects.detector(d) for d in dict.fromkeys(d for _, d in cells)])
    tables = (choices_table(settings, cells, standings), ranks_table(EVERY, standings.get(EVERY, {})))
    return Summary(
        rows=rows,
        figures=[*ranked, overview(settings, cells), example],
        tables=[table for table in tables if table.rows],
        highlights=opening(settings, cells, standings),
        remarks=[*findings(settings, cells), *left_out(cells, whole), *absent(settings, cells, reasons)],
        chapters=[replace(first, figures=figures), *more, words],
        method=remarks(settings, cells),
    )


def gather(
    subjects: Subjects, settings: Settings, results: Iterable[tuple[Task, Arrays]]
) -> tuple[dict[tuple[str, str], ComparisonCell], dict[Any, str]]:
    """The cells by names of plant and detector, and the reasons of those that are not applicable."""
    parts: dict[tuple[str, str], list[Arrays]] = {}
    seeds: dict[tuple[str, str], list[int]] = {}
    reasons: dict[tuple[str, str], str] = {}
    for task, arrays in results:
        key = task["plant"], task["detector"]
        if "reason" in arrays:
            reasons[key] = str(arrays["reason"])
        else:
            parts.setdefault(key, []).append(arrays)
            seeds.setdefault(key, []).extend(task["seeds"])
    plants = {name: subjects.plant(name) for name in dict.fromkeys(plant for plant, _ in parts)}
    cells = {
        (plant, detector): ComparisonCell(plants[plant], detector, settings, found, seeds[plant, detector])
        for (plant, detector), found in parts.items()
    }
    return cells, reasons


def complete(cells: Mapping[tuple[str, str], ComparisonCell]) -> dict[tuple[str, str], ComparisonCell]:
    """The cells that have all seeds, which alone can be paired: a piece of work of the others has failed."""
    everyone = {seed for cell in cells.values() for seed in cell.seeds}
    return {key: cell for key, cell in cells.items() if len(cell.seeds) == len(everyone)}


def standings_of(cells: Cells, settings: Settings) -> Standings:
    """Ranks on each plant, and over all plants of those detectors that run on every one of several."""
    plants = list(dict.fromkeys(plant for plant, _ in cells))
    common = [d for d in dict.fromkeys(d for _, d in cells) if all((p, d) in cells for p in plants)]
    found: dict[str, dict[str, dict[str, RankedDetector]]] = {}
    for name, criterion in CRITERIA.items():
        values = {key: criterion.values(cell, settings) for key, cell in cells.items()}
        compared = {plant: of_plant(values, plant) for plant in plants}
        if len(plants) > 1 and common:
            compared[EVERY] = {d: np.concatenate([values[p, d] for p in plants]) for d in common}
        for plant, of_each in compared.items():
            seeds = len(next(iter(cells.values())).seeds) if criterion.weighted and cells else None
            found.setdefault(plant, {})[name] = ranking(of_each, less=criterion.less, bounds=criterion.bounds, seeds=seeds)
    return found


def overview(settings: Settings, cells: Cells) -> Figure:
    """All detectors on all plants in one figure."""
    shown = glance(settings)
    return Figure(
        "overview",
        "Overview: every detector on every plant",
        overview_caption(settings, cells),
        partial(draw_overview, cells, shown),
        f"{len(shown)} tables of numbers on colours, detectors down and plants across: {', '.join(shown)}",
    )


def overview_caption(settings: Settings, cells: Cells) -> str:
    """What the overview shows."""
    best = {plant: best_isolation(settings, of_plant(cells, plant)) for plant, _ in cells}
    names = "; ".join(f"{plant}: {name}" for plant, name in best.items() if name is not None)
    return (
        f"Read a detector along its row: most exact isolation ({names or 'unknown'}) need not go with least false isolation. "
        "At the common rate of false alarms. Blue: more is better; orange: less is better; grey: not applicable; numbers over "
        "several decades are coloured by their logarithm."
    )
