"""Tables of a comparison: numbers with intervals, published ones beside ours, ranks, cost, what was changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.report.content import Interval, ResultTable
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.comparison.cell import Cells, ComparisonCell, of_plant
from fusion_sfdia.study.comparison.metric_rows import (
    best_isolation,
    exact_isolation,
    measures,
    under_mismatch,
    under_process_faults,
)
from fusion_sfdia.study.comparison.protocol import COSTS, MISMATCH_SIGMA, PUBLISHED, length_name, mismatch_cases, sizes
from fusion_sfdia.study.comparison.ranking import CRITERIA, LOSS, RankedDetector
from fusion_sfdia.study.comparison.recordings import stated_distance
from fusion_sfdia.study.experiments.scenario import Settings

Standings = Mapping[str, Mapping[str, Mapping[str, RankedDetector]]]  # plant, criterion, detector
EVERY = "all plants"
NOT_TRIED = "model mismatch not tried"


def choices_table(settings: Settings, cells: Cells, standings: Standings) -> ResultTable:
    """For each plant the detectors with the least loss, with most exact isolation, and with least false isolation."""
    rows: list[tuple[str | float | Interval, ...]] = []
    for plant in dict.fromkeys(p for p, _ in cells):
        ranked = standings[plant][LOSS] if plant in standings else {}
        there = {d: of_plant(cells, plant)[d] for d in ranked}
        if (exact := best_isolation(settings, there)) is None:
            continue
        isolating = [d for d, cell in there.items() if exact_isolation(settings, cell).value > 0] or list(there)
        chosen: dict[str, list[str]] = {}
        chosen.setdefault(min(ranked, key=lambda d: ranked[d].mean.value), []).append("least loss")
        chosen.setdefault(exact, []).append("most exact isolation")
        if any(cell.mismatches for cell in there.values()):
            steady = min(isolating, key=lambda d: (under_mismatch(there[d]).share.value, ranked[d].mean.value))
            chosen.setdefault(steady, []).append("least false isolation with a wrong model")
        for detector, why in chosen.items():
            cell = there[detector]
            mismatch, fault = under_mismatch(cell), under_process_faults(cell)
            numbers = (exact_isolation(settings, cell), mismatch.share, mismatch.case, fault.share, fault.case, cell.deployed)
            rows.append((plant, detector, ", ".join(why), ranked[detector].mean, *numbers))
    _, large = sizes(settings)
    header = (
        *("plant", "detector", "for its", "loss", f"exact isolation, {large:g} sigma"),
        *("false isolation, worst mismatch case", "which"),
        *("false isolation, worst process fault", "which", "healthy samples with an alarm"),
    )
    return ResultTable(
        "Which detector to choose",
        header,
        tuple(rows),
        method="Exact isolation: share of the samples under a fault of one sensor at which it alone is isolated. "
        "False isolation: share of the samples at which a healthy sensor is isolated though none is faulty. Of the least false "
        "isolation count only detectors that isolate. Others may not differ beyond chance: see ranks. Healthy samples: as "
        f"deployed, alarms that last included. {cost_words(settings)}",
    )


def cost_words(settings: Settings) -> str:
    """The loss in words."""
    missed, false, late, wrong = (settings[name] for name in COSTS)
    return (
        f"Loss: {missed:g} times the share of a fault's samples at which the faulty sensor is not isolated, {false:g} times "
        f"the share of the samples at which a healthy one is, {late:g} times the share of a fault before the first alarm. All "
        "kinds of conditions with the right model count alike, and all mismatch cases, where the model is wrong, "
        f"{100 * wrong:.0f} % of the time, half of it healthy and half with a bias. A healthy sensor that is isolated is a "
        "good reading taken out, a technician sent to the wrong place, and "
        f"what is really wrong goes on. Other weights: --set {' --set '.join(f'{name}=...' for name in COSTS)}."
    )


def numbers_table(settings: Settings, cells: Mapping[str, ComparisonCell]) -> ResultTable:
    """The detectors of a plant in numbers with intervals."""
    columns = measures(settings)
    found = {d: [measure.of(cell) for measure in columns.values()] for d, cell in cells.items()}
    counts = [sorted({line[i].n for line in found.values() if line[i].n}) for i in range(len(columns))]
    runs = [f"n {n[0]}" if len(n) == 1 else f"n {n[0]} to {n[-1]}" if n else "" for n in counts]
    return ResultTable(
        f"In numbers; the truth differs from the model by {stated_distance(next(iter(cells.values())).subject)}",
        ("detector", *(f"{name} ({n})" if n else name for name, n in zip(columns, runs, strict=True)), "false alarms claimed"),
        tuple((d, *line, claim_of(cells[d])) for d, line in found.items()),
        method="In brackets 95 % intervals, n: runs. Faults are bias, drift, noise and scale; thresholds those of the "
        "common rate of "
        "false alarms, but for the column of its own. Exact isolation: share of samples at which exactly the faulty sensor is "
        "isolated. Healthy sensors isolated: share of healthy sensor-samples. Claims are per step over all sensors. As "
        "deployed: with what an alarm does to later samples, as where decisions are latched. Delays: of the runs that have an "
        "alarm. Sizes: of faults other than noise. False isolation: share of healthy samples at which a sensor is isolated. "
        "Where runs do not differ, as without any alarm, an interval counts runs, not samples. All other numbers: metrics.csv.",
    )


def lengths_tables(settings: Settings, cells: Mapping[str, ComparisonCell]) -> list[ResultTable]:
    """Biases of several lengths beside each other, a table a size."""
    lengths = sorted(settings["lengths"])
    shown = (("area", area_of), ("alarm", alarm_of), ("exact", exact_of))
    tables = []
    for size in dict.fromkeys(sizes(settings)) if lengths and "bias" in settings["faults"] else ():
        rows: list[tuple[str | float | Interval, ...]] = [
            (d, *(of(c, length_name(size, n)) for _, of in shown for n in lengths)) for d, c in cells.items()
        ]
        tables.append(
            ResultTable(
                f"How long a bias of {size:g} sigma lasts",
                ("detector", *(f"{what}, {n} samples" for what, _ in shown for n in lengths)),
                tuple(rows),
                method="The same biases, cut off after some samples. Area: under the ROC of single samples. Alarm: "
                "share of runs with "
                "one while the fault lasts. Exact: share of its samples at which exactly the faulty sensor is isolated. In "
                "brackets 95 % intervals.",
                folded=True,
            )
        )
    return tables


def area_of(cell: ComparisonCell, name: str) -> Estimate:
    """Area under the ROC of a condition."""
    return cell.areas[name]


def alarm_of(cell: ComparisonCell, name: str) -> Estimate:
    """Share of the runs of a condition with an alarm."""
    return cell.of(ComparisonCell.detected, name)


def exact_of(cell: ComparisonCell, name: str) -> Estimate:
    """Share of the samples of a condition with exact isolation."""
    return cell.of(ComparisonCell.exact, name)


def claim_of(cell: ComparisonCell) -> str:
    """The rate of false alarms that a detector claims at most."""
    claim = float(cell["claim"])
    return f"{claim:.2g}" if np.isfinite(claim) else "none"


def paper_table(published: Sequence[Row]) -> ResultTable:
    """Published numbers beside ours."""
    rows = [
        (
            *(r.fault, r.detector, r.quantity, r.condition, r.metric, (r.value, r.low, r.high, r.n), r.n),
            *(float(r.published), judged(r), r.source),
        )
        for r in published
        if r.published is not None
    ]
    return ResultTable(
        "What the papers state of their own faults, and what comes out here",
        ("fault", "detector", "of", "until", "metric", "ours", "n", "published", "our interval", "source"),
        tuple(rows),
        method="Sizes are the papers'; onset, length, thresholds and truth are those of this comparison, so that a "
        "difference does "
        "not refute: the papers' own experiments are the scenarios pipeline/*, engine/* and network/* (fusion-sfdia run). "
        "Trial accuracy: share of runs in which the faulty sensor is isolated more often than any other; Shaheen 2024 does not "
        "define its own.",
        folded=True,
    )


def judged(row: Row) -> str:
    """Whether the published value lies within our interval."""
    return "none" if row.agrees is None else "contains it" if row.agrees else "does not"


def ranks_table(plant: str, criteria: Mapping[str, Mapping[str, RankedDetector]]) -> ResultTable:
    """Ranks of all detectors, shared where nothing differs, and the means behind them."""
    shown = {criterion: found for criterion, found in criteria.items() if any(s.mean.n for s in found.values())}
    detectors = list(next(iter(shown.values()), {}))
    order = sorted(detectors, key=lambda d: shown[LOSS][d].mean.value if LOSS in shown else 0.0)
    counts = ", ".join(f"{next(iter(found.values())).mean.n} of {criterion}" for criterion, found in shown.items())
    header = ["detector"]
    rows: list[list[str | float | Interval]] = [[d] for d in order]
    for criterion, found in shown.items():
        header += [f"{criterion}: rank", f"mean of {criterion}"]
        for row in rows:
            standing = found[str(row[0])]
            row += [standing.rank, standing.mean]
    return ResultTable(
        f"Ranks, {plant}",
        tuple(header),
        tuple(map(tuple, rows)),
        method="1 + the number of detectors that are better beyond chance (random signs of paired differences over clusters, "
        "Holm's correction over all pairs, 5 %); a shared rank is no difference that this many runs show. Mean over clusters "
        f"({counts}) and its 95 % interval: loss, as above; detection, of runs with an alarm; isolation, of samples "
        "with exact isolation; "
        "accommodation, of -log10(error after over before); exoneration, of samples without false isolation under model "
        "mismatch, process faults and missing readings, the three weighted alike. In the order of the loss.",
    )


def cost_table(cells: Mapping[str, ComparisonCell]) -> ResultTable:
    """Time and memory."""
    rows: list[tuple[str | float, ...]] = []
    for d, cell in cells.items():
        batch, state, step = (float(cell[name]) for name in ("batch_seconds", "state_bytes", "step_bytes"))
        rows.append((d, 1e3 * cell.step_seconds, 1e3 * batch, 1e-3 * state, 1e-3 * step))
    return ResultTable(
        "Cost",
        (
            "detector",
            "a step (ms)",
            "a step of a run in a batch (ms)",
            "state (kB)",
            "a step (kB)",
        ),
        tuple(rows),
        method="Processor time on this machine: the least of some steps of a single run, and the mean of the batch of "
        "the seeds of a "
        "task. Memory of a step: the largest in use at once. Both differ from run to run, so they are not in metrics.csv.",
        folded=True,
    )


def changes_table(settings: Settings, cell: ComparisonCell) -> ResultTable:
    """Mismatch cases and faults of a plant and of its papers, and why."""
    rows = [("mismatch case", case.name, case.why) for case in mismatch_cases(settings, cell.cases)]
    rows += [("process fault", f.name, f.why) for f in cell.cases.process_faults if settings["process_faults"]]
    rows += [("fault of a paper", f.name, f.about) for f in cell.cases.paper_faults if PUBLISHED in settings["faults"]]
    return ResultTable(
        "Mismatch cases and faults of this plant",
        ("what", "name", "why"),
        tuple(rows),
        method="Amounts are ours unless a paper is named. No detector knows the mismatch cases; each is tried healthy "
        "and with a bias "
        f"of {MISMATCH_SIGMA:g} sigma.",
        folded=True,
    )


def standing_rows(standings: Standings) -> list[tuple[str, str, str, RankedDetector]]:
    """Plant, criterion, detector and standing, flat."""
    return [
        (plant, criterion, detector, standing)
        for plant, criteria in standings.items()
        for criterion in CRITERIA
        for detector, standing in criteria.get(criterion, {}).items()
    ]
