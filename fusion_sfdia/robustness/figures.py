"""The figure of a plant: what every variant isolates and names under every condition."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.comparison.figures import heat
from fusion_sfdia.comparison.protocol import HEALTHY
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.report.plots import panels
from fusion_sfdia.robustness.aims import AT_END, BIAS, EXACT, FALSE, NAMING, VERDICT, mismatches, process_faults
from fusion_sfdia.robustness.rows import Index, index_of, variants_of
from fusion_sfdia.robustness.tables import RIGHT, UNSEEN

NO_SENSOR = "no sensor is faulty: samples at which one is isolated"


class Column(NamedTuple):
    """A column of a panel: its label, and the fault, condition and metric of its numbers."""

    label: str
    fault: str
    condition: str
    metric: str


def columns_of(rows: Sequence[Row], plant: str) -> dict[str, list[Column]]:
    """The columns of each panel by its title."""
    unseen, faults = mismatches(plant, unseen=True), process_faults(plant)
    cases = [(m + UNSEEN * (m in unseen), m) for m in mismatches(plant)]
    slow = list(dict.fromkeys(r.fault for r in rows if r.plant == plant and r.metric == AT_END))
    found = {
        NO_SENSOR: [
            Column("right model", HEALTHY, "", FALSE),
            *(Column(label, HEALTHY, name, FALSE) for label, name in cases),
            *(Column(name, name, "", FALSE) for name in faults),
        ],
        "a sensor is faulty: samples with exact isolation; slow drifts: runs": [
            *(Column(fault.replace("-", " "), fault, "", EXACT) for fault in RIGHT),
            *(Column(f"bias 10 sigma, {label}", BIAS, name, EXACT) for label, name in cases),
            *(Column(fault.replace("-", " "), fault, "", AT_END) for fault in slow),
        ],
        "runs with a process verdict": [
            *(Column(name, name, "", VERDICT) for name in faults),
            *(Column(f"{name}, right name", name, "", NAMING) for name in faults),
            *(Column(fault.replace("-", " "), fault, "", VERDICT) for fault in RIGHT[1:]),
        ],
    }
    metrics = {r.metric for r in rows if r.plant == plant}
    return {title: columns for title, columns in found.items() if metrics & {c.metric for c in columns}}


def value_of(index: Index, plant: str, variant: str, column: Column) -> float:
    """The number of a cell, NaN where there is none."""
    row = index.get((plant, variant, column.fault, column.condition, column.metric))
    return np.nan if row is None else row.value


def draw(rows: Sequence[Row], plant: str) -> Drawing:
    """Variants down, conditions across, a panel a question."""
    index, those, shown = index_of(rows), variants_of(rows, plant), columns_of(rows, plant)
    figure, axes = panels(list(shown), columns=1, width=15.0, height=2.2 + 0.22 * len(those))
    for axis, (title, columns) in zip(axes, shown.items(), strict=True):
        values = np.array([[value_of(index, plant, v, column) for column in columns] for v in those])
        heat(axis, values, those, [column.label for column in columns], less=title == NO_SENSOR)
    return figure
