"""Tables of a comparison: the matrix at a glance, ranks, cost, what was changed, what cannot run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fusion_sfdia.benchmarks.comparison_figures import Cells
from fusion_sfdia.benchmarks.comparison_numbers import Cell
from fusion_sfdia.benchmarks.comparison_protocol import HEALTHY, TROUBLED_SIGMA
from fusion_sfdia.benchmarks.comparison_ranking import CRITERIA, Standing
from fusion_sfdia.benchmarks.comparison_truths import DEPARTURES, PLANT_FAULTS
from fusion_sfdia.benchmarks.scenario import Settings, Table

Standings = Mapping[str, Mapping[str, Mapping[str, Standing]]]  # plant, criterion, detector
EVERY = "all plants"


def sizes(settings: Settings) -> tuple[float, float]:
    """A small and a large fault of those that were tried: 3 and 10 sigma where they are among them."""
    known = sorted(settings["magnitudes"])
    small = 3.0 if 3.0 in known else known[0]
    return small, 10.0 if 10.0 in known else known[-1]


def troubled(cell: Cell) -> float:
    """Largest share of healthy samples at which a sensor is blamed, over the departures; NaN for none."""
    shares = [cell.blame(cell.rows_of(HEALTHY, truth=t)).value for t in cell.truths]
    return max(shares, default=float("nan"))


def glance(settings: Settings) -> dict[str, Callable[[Cell], float]]:
    """The numbers of the matrix at a glance, NaN where there are none."""
    small, large = sizes(settings)
    bias = f"bias-{small:g}-sigma"

    def pooled(measure: Callable[[Cell, Any], Any], size: float) -> Callable[[Cell], float]:
        return lambda cell: float(measure(cell, cell.rows_of(*cell.graded(size))).value)

    return {
        f"runs with an alarm, {small:g} sigma": pooled(Cell.detected, small),
        f"runs with an alarm, {large:g} sigma": pooled(Cell.detected, large),
        f"exact names, {large:g} sigma": pooled(Cell.exact, large),
        f"named at all, {large:g} sigma": pooled(Cell.recall, large),
        f"area under the ROC, {bias.replace('-', ' ')}": lambda c: c.areas[bias].value if bias in c.areas else np.nan,
        "false alarms at its own threshold": lambda cell: cell.nominal.value,
        f"error after over before, {large:g} sigma": pooled(Cell.gain, large),
        "blame, worst departure": troubled,
    }


LOGARITHMIC = ("false alarms at its own threshold", "error after over before")


def tables(settings: Settings, cells: Cells, reasons: Mapping[Any, str], standings: Standings) -> list[Table]:
    """All tables of the report."""
    found = [glance_table(settings, cells)]
    found += [ranks_table(plant, criteria) for plant, criteria in standings.items()]
    found += [cost_table(cells), changes_table(settings)]
    if reasons:
        rows = tuple((plant, detector, why) for (plant, detector), why in reasons.items())
        found.append(Table("What cannot run, and why", ("plant", "detector", "reason"), rows))
    return [table for table in found if table.rows]


def glance_table(settings: Settings, cells: Cells) -> Table:
    """A line a cell."""
    numbers, (_, large) = glance(settings), sizes(settings)
    rows: tuple[tuple[str | float, ...], ...] = tuple(
        (
            *key,
            *(number(cell) for number in numbers.values()),
            *(measure(cell, cell.rows_of(*cell.graded(large))).value for measure in (Cell.delay, Cell.size_error)),
            float(cell["claim"]),
            cell.step_seconds,
        )
        for key, cell in cells.items()
    )
    return Table(
        "At a glance",
        (
            *("plant", "detector", *numbers, f"delay, {large:g} sigma (s)", f"size of the fault off, {large:g} sigma (%)"),
            *("false alarms it claims", "seconds of a step"),
        ),
        rows,
        "Faults are bias, drift, noise and scale; thresholds those of the common rate of false alarms, but for one column. "
        "Exact: share of samples at which exactly the faulty sensor is named; named at all: among others, perhaps. Claims are "
        "per step over all sensors, undefined where there is none. Blame: share of healthy samples at which a sensor is named. "
        "Intervals: metrics.csv.",
    )


def ranks_table(plant: str, criteria: Mapping[str, Mapping[str, Standing]]) -> Table:
    """Ranks of all detectors, shared where nothing differs, and the means behind them."""
    detectors = next(iter(criteria.values()), {})

    def text(standing: Standing) -> str:
        e = standing.mean
        return f"{standing.rank}  ({e.value:.2f}, {e.low:.2f} to {e.high:.2f})"

    order = sorted(detectors, key=lambda d: (sum(criteria[c][d].rank for c in criteria), list(detectors).index(d)))
    count = next(iter(next(iter(criteria.values())).values())).mean.n if detectors else 0
    return Table(
        f"Ranks, {plant}",
        ("detector", *criteria),
        tuple((d, *(text(criteria[c][d]) for c in criteria)) for d in order),
        "1 + the number of detectors that are better beyond chance (Wilcoxon's signed ranks over clusters, Holm's correction "
        "over all pairs, 5 %); a shared rank is no difference that this many runs show. In brackets the mean over "
        f"{count} clusters (first column) and its 95 % interval: of runs with an alarm, of samples with the exact names, of "
        "-log10(error after over before), of samples without a healthy sensor blamed where a departure, a fault of the plant "
        "or missing readings give cause to.",
    )


def cost_table(cells: Cells) -> Table:
    """Time and memory."""
    rows = tuple(
        (*key, cell.step_seconds, float(cell["batch_seconds"]), float(cell["state_bytes"]), float(cell["step_bytes"]))
        for key, cell in cells.items()
    )
    return Table(
        "Cost",
        (
            "plant",
            "detector",
            "seconds of a step",
            "seconds of a step of a run in a batch",
            "bytes of state",
            "bytes of a step",
        ),
        rows,
        "Processor time on this machine: the least of some steps of a single run, and the mean of the batch of the seeds of a "
        "task. Bytes of a step: the largest in use at once. Both differ from run to run, so they are not in metrics.csv.",
    )


def changes_table(settings: Settings) -> Table:
    """Departures and faults of plants, and why."""
    rows = [(plant, "departure", d.name, d.why) for plant in settings["plants"] for d in DEPARTURES.get(plant, ())]
    rows += [(plant, "fault of the plant", f.name, f.why) for plant in settings["plants"] for f in PLANT_FAULTS.get(plant, ())]
    chosen = {"departure": settings["departures"], "fault of the plant": settings["plant_faults"]}
    return Table(
        "What was changed, and why so",
        ("plant", "what", "name", "why"),
        tuple(row for row in rows if chosen[row[1]]),
        "Amounts are ours. Departures last from the start and are known to no detector; each is tried healthy and with a bias "
        f"of {TROUBLED_SIGMA:g} sigma.",
    )


def standing_rows(standings: Standings) -> list[tuple[str, str, str, Standing]]:
    """Plant, criterion, detector and standing, flat."""
    return [
        (plant, criterion, detector, standing)
        for plant, criteria in standings.items()
        for criterion in CRITERIA
        for detector, standing in criteria.get(criterion, {}).items()
    ]
