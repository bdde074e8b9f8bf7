"""Tables of a comparison: numbers with intervals, published ones beside ours, ranks, cost, what was changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fusion_sfdia.comparison.figures import Cells, of_plant
from fusion_sfdia.comparison.measures import (
    exactly,
    measures,
    names_most,
    told_distance,
    under_departures,
    under_plant_faults,
)
from fusion_sfdia.comparison.numbers import Cell
from fusion_sfdia.comparison.protocol import PUBLISHED, TROUBLED_SIGMA, length_name, sizes
from fusion_sfdia.comparison.published import PAPER_FAULTS
from fusion_sfdia.comparison.ranking import CRITERIA, Standing
from fusion_sfdia.comparison.truths import DEPARTURES, PLANT_FAULTS
from fusion_sfdia.evaluation.metrics import Estimate
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.experiments.scenario import Settings
from fusion_sfdia.report.content import Interval, Table

Standings = Mapping[str, Mapping[str, Mapping[str, Standing]]]  # plant, criterion, detector
EVERY = "all plants"


def steadiness(settings: Settings, cell: Cell) -> float:
    """Exact names times what the worst departure leaves without blame."""
    blame = under_departures(cell).share.value
    return exactly(settings, cell).value * (1 - blame if np.isfinite(blame) else 1.0)


def choices_table(settings: Settings, cells: Cells) -> Table:
    """For each plant who names most, and who still does where blame under departures is counted against it."""
    rows: list[tuple[str | float | Interval, ...]] = []
    for plant in dict.fromkeys(p for p, _ in cells):
        there = of_plant(cells, plant)
        if (names := names_most(settings, there)) is None:
            continue
        steady = max(there, key=lambda d: steadiness(settings, there[d]))
        chosen = {names: "names most"} | {steady: "names most, blames least" if names == steady else "names much, blames less"}
        for detector, what in chosen.items():
            cell = there[detector]
            departure, fault = under_departures(cell), under_plant_faults(cell)
            told = (
                told_distance(plant),
                exactly(settings, cell),
                departure.share,
                departure.where,
                fault.share,
                fault.where,
                cell.deployed,
            )
            rows.append((plant, what, detector, *told))
    _, large = sizes(settings)
    return Table(
        "Which to take",
        (
            *(
                "plant",
                "the one that",
                "detector",
                "truth off the model by",
                f"exact names, {large:g} sigma",
                "blame, worst departure",
                "which",
            ),
            *("blame, worst fault of the plant", "which", "healthy samples with an alarm"),
        ),
        tuple(rows),
        "Exact names: samples under a fault of one sensor at which that one alone is named. Blame: samples at which a healthy "
        "sensor is named though none is faulty, where the plant departs from its model or fails itself. The one that blames "
        "less has the largest product of exact names and of samples without blame under departures. Others may not differ "
        "beyond chance: see ranks. Healthy samples: as deployed, alarms that last included.",
    )


def numbers_table(settings: Settings, cells: Mapping[str, Cell]) -> Table:
    """The detectors of a plant in numbers with intervals."""
    columns = measures(settings)
    found = {d: [measure.of(cell) for measure in columns.values()] for d, cell in cells.items()}
    counts = [sorted({line[i].n for line in found.values() if line[i].n}) for i in range(len(columns))]
    told = [f"n {n[0]}" if len(n) == 1 else f"n {n[0]} to {n[-1]}" if n else "" for n in counts]
    return Table(
        f"In numbers; the truth differs from the model by {told_distance(next(iter(cells.values())).plant)}",
        ("detector", *(f"{name} ({n})" if n else name for name, n in zip(columns, told, strict=True)), "false alarms claimed"),
        tuple((d, *line, claim_of(cells[d])) for d, line in found.items()),
        "In brackets 95 % intervals, n: runs. Faults are bias, drift, noise and scale; thresholds those of the common rate of "
        "false alarms, but for the column of its own. Exact names: share of samples at which exactly the faulty sensor is "
        "named; named at all: among others, perhaps; healthy sensors named: share of healthy sensor-samples. Claims are per "
        "step over all sensors. As deployed: with what an alarm does to those that follow, as where decisions are latched. "
        "Delays: of the runs that have an alarm. Sizes: of faults other than noise. Blame: share of healthy samples at which a "
        "sensor is named. Where runs do not differ, as without any alarm, an interval counts runs, not samples. All other "
        "numbers: metrics.csv.",
    )


def lengths_tables(settings: Settings, cells: Mapping[str, Cell]) -> list[Table]:
    """Biases of several lengths beside each other, a table a size."""
    lengths = sorted(settings["lengths"])
    shown = (("area", area_of), ("alarm", alarm_of), ("exact", exact_of))
    tables = []
    for size in dict.fromkeys(sizes(settings)) if lengths and "bias" in settings["faults"] else ():
        rows: list[tuple[str | float | Interval, ...]] = [
            (d, *(of(c, length_name(size, n)) for _, of in shown for n in lengths)) for d, c in cells.items()
        ]
        tables.append(
            Table(
                f"How long a bias of {size:g} sigma lasts",
                ("detector", *(f"{what}, {n} samples" for what, _ in shown for n in lengths)),
                tuple(rows),
                "The same biases, cut off after some samples. Area: under the ROC of single samples. Alarm: share of runs with "
                "one while the fault lasts. Exact: share of its samples at which exactly the faulty sensor is isolated. In "
                "brackets 95 % intervals.",
                folded=True,
            )
        )
    return tables


def area_of(cell: Cell, name: str) -> Estimate:
    """Area under the ROC of a condition."""
    return cell.areas[name]


def alarm_of(cell: Cell, name: str) -> Estimate:
    """Share of the runs of a condition with an alarm."""
    return cell.of(Cell.detected, name)


def exact_of(cell: Cell, name: str) -> Estimate:
    """Share of the samples of a condition with exact isolation."""
    return cell.of(Cell.exact, name)


def claim_of(cell: Cell) -> str:
    """The rate of false alarms that a detector claims at most."""
    claim = float(cell["claim"])
    return f"{claim:.2g}" if np.isfinite(claim) else "none"


def paper_table(stated: Sequence[Row]) -> Table:
    """Published numbers beside ours."""
    return Table(
        "What the papers state of their own faults, and what comes out here",
        ("fault", "detector", "of", "metric", "ours", "n", "published", "our interval", "source"),
        tuple(
            (
                *(r.fault, r.detector, r.quantity, r.metric),
                (r.value, r.low, r.high, r.n),
                r.n,
                float(r.published),
                judged(r),
                r.source,
            )
            for r in stated
            if r.published is not None
        ),
        "Sizes are the papers'; onset, length, thresholds and truth are those of this comparison, so that a difference does "
        "not refute: the papers' own experiments are the scenarios pipeline/*, engine/* and network/* (fusion-sfdia run). "
        "Trial accuracy: share of runs in which the faulty sensor is isolated more often than any other; Shaheen 2024 does not "
        "define its own.",
        folded=True,
    )


def judged(row: Row) -> str:
    """Whether the published value lies within our interval."""
    return "none" if row.agrees is None else "holds it" if row.agrees else "does not"


def ranks_table(plant: str, criteria: Mapping[str, Mapping[str, Standing]]) -> Table:
    """Ranks of all detectors, shared where nothing differs, and the means behind them."""
    told = {criterion: found for criterion, found in criteria.items() if any(s.mean.n for s in found.values())}
    detectors = list(next(iter(told.values()), {}))
    order = sorted(detectors, key=lambda d: sum(found[d].rank for found in told.values()))
    counts = ", ".join(f"{next(iter(found.values())).mean.n} of {criterion}" for criterion, found in told.items())
    header = ["detector"]
    rows: list[list[str | float | Interval]] = [[d] for d in order]
    for criterion, found in told.items():
        header += [f"{criterion}: rank", f"mean of {criterion}"]
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
        "cause to, each of the three alike. In the order of the sum of ranks.",
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
        folded=True,
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
        folded=True,
    )


def standing_rows(standings: Standings) -> list[tuple[str, str, str, Standing]]:
    """Plant, criterion, detector and standing, flat."""
    return [
        (plant, criterion, detector, standing)
        for plant, criteria in standings.items()
        for criterion in CRITERIA
        for detector, standing in criteria.get(criterion, {}).items()
    ]
