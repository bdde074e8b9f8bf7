"""What a detector is told by in the report of a comparison: one number with its interval for each measure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from fusion_sfdia.comparison.numbers import Cell
from fusion_sfdia.comparison.protocol import HEALTHY, sizes
from fusion_sfdia.comparison.recordings import distance_of_truth
from fusion_sfdia.evaluation.metrics import NOTHING, Estimate
from fusion_sfdia.experiments.scenario import Settings

SAME = 1e-6  # sigma: less is the same model
GLANCE = 8  # the first of them are shown at a glance


class Measure(NamedTuple):
    """A measure, whether less of it is better, and whether it is told apart by its decades."""

    of: Callable[[Cell], Estimate]
    less: bool = False
    decades: bool = False


class Blame(NamedTuple):
    """Share of samples without a faulty sensor at which a sensor is named, and under what."""

    share: Estimate
    where: str


def told_distance(plant: str) -> str:
    """How far the usual truth of a plant is from the detectors' model, in words."""
    distance = distance_of_truth(plant)
    return "nothing in this operation" if distance < SAME else f"{distance:.2g} sigma"


def under_departures(cell: Cell) -> Blame:
    """The worst of the departures."""
    return _worst(Blame(cell.blame(cell.rows_of(HEALTHY, truth=t)), t) for t in cell.truths)


def under_plant_faults(cell: Cell) -> Blame:
    """The worst of the faults of the plant."""
    return _worst(Blame(cell.blame(cell.rows_of(name)), name) for name, kind in cell.kinds.items() if kind == "plant")


def _worst(found: Iterable[Blame]) -> Blame:
    return max(found, key=lambda blame: blame.share.value, default=Blame(NOTHING, "none"))


def exactly(settings: Settings, cell: Cell) -> Estimate:
    """Samples under a large fault at which exactly the faulty sensor is named."""
    return cell.of(Cell.exact, *cell.graded(sizes(settings)[1]))


def names_most(settings: Settings, cells: Mapping[str, Cell]) -> str | None:
    """Of the detectors of a plant the one that names exactly the faulty sensor most often; None without large faults."""
    shares = {d: v for d, c in cells.items() if np.isfinite(v := exactly(settings, c).value)}
    return max(shares, key=lambda d: shares[d]) if shares else None


def seen(settings: Settings, cell: Cell) -> float:
    """Share of the runs with a large fault that raise an alarm; NaN where there is none."""
    rows = cell.rows_of(*cell.graded(sizes(settings)[1]))
    return cell.detected(rows).value if rows.size else np.nan


def measures(settings: Settings) -> dict[str, Measure]:
    """All measures, in the order of the report."""
    small, large = sizes(settings)
    bias = f"bias-{small:g}-sigma"

    def pooled(measure: Callable[[Cell, Any], Estimate], size: float) -> Callable[[Cell], Estimate]:
        return lambda cell: cell.of(measure, *cell.graded(size))

    return {
        f"runs with an alarm, {large:g} sigma": Measure(pooled(Cell.detected, large)),
        f"exact names, {large:g} sigma": Measure(pooled(Cell.exact, large)),
        f"mean area under ROCs, {small:g} sigma": Measure(lambda cell: cell.mean_area(small)),
        f"error after over before, {large:g} sigma": Measure(pooled(Cell.gain, large), less=True, decades=True),
        "blame, worst departure": Measure(lambda cell: under_departures(cell).share, less=True),
        "blame, worst fault of the plant": Measure(lambda cell: under_plant_faults(cell).share, less=True),
        "healthy samples with an alarm as deployed": Measure(lambda cell: cell.deployed, less=True, decades=True),
        "false alarms at its own threshold": Measure(lambda cell: cell.nominal, less=True, decades=True),
        f"named at all, {large:g} sigma": Measure(pooled(Cell.recall, large)),
        f"runs with an alarm, {small:g} sigma": Measure(pooled(Cell.detected, small)),
        f"area under the ROC, {bias.replace('-', ' ')}": Measure(lambda cell: cell.areas.get(bias, NOTHING)),
        f"delay (s), {large:g} sigma": Measure(pooled(Cell.delay, large), less=True),
        f"healthy sensors named, {large:g} sigma": Measure(pooled(Cell.false_flags, large), less=True),
        f"size of the fault off (%), {large:g} sigma": Measure(pooled(Cell.size_error, large), less=True),
    }


def glance(settings: Settings) -> dict[str, Measure]:
    """The measures of the matrix at a glance."""
    return dict(list(measures(settings).items())[:GLANCE])
