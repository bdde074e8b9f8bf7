"""Summaries of engine runs compared with one published run with several sensor faults: rows, tables, figures, sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from fusion_sfdia.benchmarks.engine.support.decisions import (
    alarms_table,
    differences,
    isolation_rows,
    module_figures,
    module_rows,
)
from fusion_sfdia.benchmarks.engine.support.trials import DETECTORS, published_first, timeline
from fusion_sfdia.models.marine_engine.published import Experiment
from fusion_sfdia.report.content import Figure, ResultTable
from fusion_sfdia.report.results import Published, Row
from fusion_sfdia.study.experiments.scenario import Arrays

PUBLISHED_TIMELINE = "the paper's own timeline"  # condition of rows of the decision logic on published alarm times


class PublishedComparison(NamedTuple):
    """Rows of our runs by detector and of the published timeline, with their figures, table and sentences."""

    by_detector: dict[str, list[Row]]
    of_timeline: list[Row]
    figures: list[Figure]
    table: ResultTable
    differences: list[str]

    @property
    def logic_alone(self) -> dict[str, float]:
        """Values by metric of the published timeline."""
        return {r.metric: r.value for r in self.of_timeline}


def compare_with_published(
    scenario: str,
    fault: str,
    found: Mapping[str, Arrays],
    stated: Experiment,
    duration: float,
    *,
    what: str,
    figure: str,
    published: tuple[Published | None, Published | None] = (None, None),
) -> PublishedComparison:
    """Modules and diagnosis sets of each detector's runs, and those of the published alarm times.

    found: arrays of `trial` by detector, of runs of `duration` s. what, figure: the faults and the published figure, as text.
    published: P^U and P^E.
    """
    ours = stated._replace(duration=duration)
    of: dict[str, list[Row]] = {}
    for detector, arrays in found.items():
        lines = timeline(arrays["first"], ours.faults, duration)
        of[detector] = module_rows(scenario, detector, fault, arrays, ours)
        of[detector] += isolation_rows(scenario, detector, fault, lines, published=published)
    lines = timeline(published_first(stated.fired), stated.faults, stated.duration)
    printed = isolation_rows(scenario, DETECTORS[0], fault, lines, published=published, condition=PUBLISHED_TIMELINE)
    sentences = [differences(rows, detector, ours, figure) for detector, rows in of.items()]
    every = [r for rows in of.values() for r in rows]
    return PublishedComparison(
        of, printed, module_figures(found, ours, what), alarms_table(every, ours, list(found)), sentences
    )
