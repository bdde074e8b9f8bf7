"""Tables of a comparison: numbers with intervals, published ones beside ours, ranks, cost, what was changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fusion_sfdia.benchmarks.comparison_numbers import Cell
from fusion_sfdia.benchmarks.comparison_protocol import HEALTHY, PUBLISHED, TROUBLED_SIGMA
from fusion_sfdia.benchmarks.comparison_published import PAPER_FAULTS
from fusion_sfdia.benchmarks.comparison_ranking import CRITERIA, Standing
from fusion_sfdia.benchmarks.comparison_truths import DEPARTURES, PLANT_FAULTS
from fusion_sfdia.benchmarks.results import Row
from fusion_sfdia.benchmarks.scenario import Interval, Settings, Table
from fusion_sfdia.evaluation.metrics import NOTHING, Estimate

Measure = Callable[[Cell], Estimate]
Standings = Mapping[str, Mapping[str, Mapping[str, Standing]]]  # plant, criterion, detector
EVERY = "all plants"


def sizes(settings: Settings) -> tuple[float, float]:
    """A small and a large fault of those that were tried: 3 and 10 sigma where they are among them."""
    known = sorted(settings["magnitudes"])
    small = 3.0 if 3.0 in known else known[0]
    return small, 10.0 if 10.0 in known else known[-1]


def troubled(cell: Cell) -> Estimate:
    """Largest share of healthy samples at which a sensor is blamed, over the departures."""
    shares = [cell.blame(cell.rows_of(HEALTHY, truth=t)) for t in cell.truths]
    return max(shares, key=lambda e: e.value, default=NOTHING)


def measures(settings: Settings) -> dict[str, Measure]:
    """What a detector is told by, in the order of the report."""
    small, large = sizes(settings)
    bias = f"bias-{small:g}-sigma"

    def pooled(measure: Callable[[Cell, Any], Estimate], size: float) -> Measure:
        return lambda cell: measure(cell, cell.rows_of(*cell.graded(size)))

    return {
        f"area under the ROC, {bias.replace('-', ' ')}": lambda cell: cell.areas.get(bias, NOTHING),
        f"runs with an alarm, {large:g} sigma": pooled(Cell.detected, large),
        f"exact names, {large:g} sigma": pooled(Cell.exact, large),
        f"named at all, {large:g} sigma": pooled(Cell.recall, large),
        f"error after over before, {large:g} sigma": pooled(Cell.gain, large),
        "false alarms at its own threshold": lambda cell: cell.nominal,
        "healthy samples with an alarm as deployed": lambda cell: cell.deployed,
        "blame, worst departure": troubled,
        f"runs with an alarm, {small:g} sigma": pooled(Cell.detected, small),
        f"delay (s), {large:g} sigma": pooled(Cell.delay, large),
        f"healthy sensors named, {large:g} sigma": pooled(Cell.false_flags, large),
        f"size of the fault off (%), {large:g} sigma": pooled(Cell.size_error, large),
    }


GLANCE = 8  # the first of them are shown at a glance
LOGARITHMIC = ("false alarms at its own threshold", "healthy samples", "error after over before")


def glance(settings: Settings) -> dict[str, Measure]:
    """The measures of the matrix at a glance."""
    return dict(list(measures(settings).items())[:GLANCE])


def numbers_table(settings: Settings, cells: Mapping[str, Cell]) -> Table:
    """The detectors of a plant in numbers with intervals."""
    columns = measures(settings)
    found = {d: [measure(cell) for measure in columns.values()] for d, cell in cells.items()}
    counts = [sorted({line[i].n for line in found.values() if line[i].n}) for i in range(len(columns))]
    told = [f"n {n[0]}" if len(n) == 1 else f"n {n[0]} to {n[-1]}" if n else "" for n in counts]
    return Table(
        "In numbers",
        ("detector", *(f"{name} ({n})" if n else name for name, n in zip(columns, told, strict=True)), "false alarms claimed"),
        tuple((d, *line, claim_of(cells[d])) for d, line in found.items()),
        "In brackets 95 % intervals, n: runs. Faults are bias, drift, noise and scale; thresholds those of the common rate of "
        "false alarms, but for the column of its own. Exact names: share of samples at which exactly the faulty sensor is "
        "named; named at all: among others, perhaps; healthy sensors named: share of healthy sensor-samples. Claims are per "
        "step over all sensors. As deployed: with what an alarm does to those that follow, as where decisions are latched. "
        "Delays: of the runs that have an alarm. Sizes: of faults other than noise. Blame: share of healthy samples at which a "
        "sensor is named. All other numbers: metrics.csv.",
    )


def claim_of(cell: Cell) -> str:
    """The rate of false alarms that a detector claims at most."""
    claim = float(cell["claim"])
    return f"{claim:.2g}" if np.isfinite(claim) else "none"


def paper_table(stated: Sequence[Row]) -> Table:
    """Published numbers beside ours."""
    return Table(
        "What the papers state of their own faults, and what comes out here",
        ("fault", "detector", "of", "metric", "ours", "n", "published", "source"),
        tuple(
            (r.fault, r.detector, r.quantity, r.metric, (r.value, r.low, r.high, r.n), str(r.n), float(r.published), r.source)
            for r in stated
            if r.published is not None
        ),
        "Sizes are the papers'; onset, length, thresholds and truth are those of this comparison, so that a difference does "
        "not refute: the papers' own experiments are the scenarios pipeline/*, engine/* and network/* (fusion-sfdia run). "
        "Accuracy: share of runs in which the sensor that is named most is the faulty one; Shaheen 2024 does not define its "
        "own.",
    )


def ranks_table(plant: str, criteria: Mapping[str, Mapping[str, Standing]]) -> Table:
    """Ranks of all detectors, shared where nothing differs, and the means behind them."""
    told = {criterion: found for criterion, found in criteria.items() if any(s.mean.n for s in found.values())}
    detectors = list(next(iter(told.values()), {}))
    order = sorted(detectors, key=lambda d: sum(found[d].rank for found in told.values()))
    counts = ", ".join(f"{next(iter(found.values())).mean.n} of {criterion}" for criterion, found in told.items())
    header = ["detector"]
    rows: list[list[str | float | Interval]] = [[d] for d in order]
    for criterion, found in told.items():
        header += [f"{criterion}: rank", "mean"]
        for row in rows:
            standing = found[str(row[0])]
            row += [standing.rank, standing.mean]
    return Table(
        f"Ranks, {plant}",
        tuple(header),
        tuple(map(tuple, rows)),
        "1 + the number of detectors whose mean is larger beyond chance (random signs of paired differences over clusters, "
        "Holm's correction over all pairs, 5 %); a shared rank is no difference that this many runs show. Mean over clusters "
        f"({counts}) and its 95 % interval: of runs with an alarm, of samples with exact names, of -log10(error after over "
        "before), of samples without a healthy sensor blamed where a departure, a fault of the plant or missing readings give "
        "cause to.",
    )


def cost_table(cells: Mapping[str, Cell]) -> Table:
    """Time and memory."""
    rows: list[tuple[str | float, ...]] = []
    for d, cell in cells.items():
        batch, state, step = (float(cell[name]) for name in ("batch_seconds", "state_bytes", "step_bytes"))
        rows.append((d, 1e3 * cell.step_seconds, 1e3 * batch, 1e-3 * state, 1e-3 * step))
    return Table(
        "Cost",
        (
            "detector",
            "a step (ms)",
            "a step of a run in a batch (ms)",
            "state (kB)",
            "a step (kB)",
        ),
        tuple(rows),
        "Processor time on this machine: the least of some steps of a single run, and the mean of the batch of the seeds of a "
        "task. Memory of a step: the largest in use at once. Both differ from run to run, so they are not in metrics.csv.",
    )


def changes_table(settings: Settings, plant: str) -> Table:
    """Departures and faults of a plant and of its papers, and why."""
    rows = [("departure", d.name, d.why) for d in DEPARTURES.get(plant, ()) if settings["departures"]]
    rows += [("fault of the plant", f.name, f.why) for f in PLANT_FAULTS.get(plant, ()) if settings["plant_faults"]]
    rows += [("fault of a paper", f.name, f.about) for f in PAPER_FAULTS.get(plant, ()) if PUBLISHED in settings["faults"]]
    return Table(
        "What was changed, and why so",
        ("what", "name", "why"),
        tuple(rows),
        "Amounts are ours unless a paper is named. Departures are known to no detector; each is tried "
        f"healthy and with a bias of {TROUBLED_SIGMA:g} sigma.",
    )


def standing_rows(standings: Standings) -> list[tuple[str, str, str, Standing]]:
    """Plant, criterion, detector and standing, flat."""
    return [
        (plant, criterion, detector, standing)
        for plant, criteria in standings.items()
        for criterion in CRITERIA
        for detector, standing in criteria.get(criterion, {}).items()
    ]
