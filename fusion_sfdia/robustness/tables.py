"""Tables of `robustness`, made of its rows alone, so that pages can be made from metrics.csv, too."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from fusion_sfdia.comparison.protocol import HEALTHY
from fusion_sfdia.comparison.subjects import cases_of, compared_plant
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.report.content import Interval, Table
from fusion_sfdia.robustness.aims import (
    AIMS,
    AT_END,
    BIAS,
    DRIFT,
    EXACT,
    FALSE,
    JUDGED,
    NAMING,
    RATIO,
    REASONS,
    SMALL_BIAS,
    VERDICT,
    Aim,
    Shown,
    found,
    mismatches,
    process_faults,
)
from fusion_sfdia.robustness.rows import OF_THE_PROCESS, REFERENCE, index_of, variants_of

Cell = str | float | Interval
NOT_TRIED = "not tried"
NO_VERDICT = "no verdict"  # of a detector without hypotheses about the process
UNSEEN = " *"


def cell(rows: Sequence[Row], absent: str = NOT_TRIED) -> Cell:
    """The number of a row with its interval; `absent` where there is none."""
    return (rows[0].value, rows[0].low, rows[0].high, rows[0].n) if rows and np.isfinite(rows[0].value) else absent


def in_words(shown: Shown | None, aim: Aim) -> str:
    """A number beside its aim: value, interval, the case it is of, and whether the aim is reached."""
    if shown is None:
        return NOT_TRIED
    row = shown.row
    interval = f" [{row.low:.2f}, {row.high:.2f}]" if np.isfinite(row.low) else ""
    case = row.condition or (row.fault if row.fault != HEALTHY else "")
    mark = "" if aim.reached(shown) else "not reached: "
    return f"{mark}{row.value:.2f}{interval}" + (f" ({case})" if case else "")


def aims_table(rows: Sequence[Row], plant: str) -> Table:
    """Every aim beside what the variants of the judged detectors reach."""
    index = index_of(rows)
    those, lines = judged(rows, plant), []
    for aim in AIMS:
        cells = [in_words(aim.worst(index, plant, v), aim) for v in those]
        lines.append((aim.name, aim.words, *cells, REASONS.get((plant, aim.name), "")))
    return Table(
        "What is required, and what is reached",
        ("quantity", "aim", *those, "why not"),
        tuple(lines),
        method="Of several cases the one farthest from its limit is shown, with its name. The number itself is compared with "
        "the limit, whatever its interval. In brackets 95 % intervals.",
    )


def judged(rows: Sequence[Row], plant: str) -> list[str]:
    """The variants that are compared with the aims."""
    return [v for v in variants_of(rows, plant) if v.split(" ")[0] in JUDGED]


def right_table(rows: Sequence[Row], plant: str) -> Table:
    """Detection and isolation where the model is right."""
    index = index_of(rows)
    lines = []
    for v in variants_of(rows, plant):
        isolation = [cell(found(index, plant, v, EXACT, (fault,), ("",))) for fault in RIGHT]
        false = cell(found(index, plant, v, FALSE, (HEALTHY,), ("",)))
        lines.append((v, cell(found(index, plant, v, "auc", (SMALL_BIAS,), ("",))), *isolation, false))
    header = ("detector", "area under the ROC, bias 3 sigma", *(f"exact, {f.replace('-', ' ')}" for f in RIGHT))
    return Table("The model is right", (*header, "healthy: a sensor isolated"), tuple(lines), method=SHARES)


RIGHT = ("bias-3-sigma", "bias-10-sigma", "bias-30-sigma", "drift-10-sigma", "drift-30-sigma")
SHARES = (
    "Exact: share of samples at which exactly the faulty sensor is isolated. A sensor isolated: share of samples at which a "
    "healthy sensor is. In brackets 95 % intervals over runs."
)


def mismatch_table(rows: Sequence[Row], plant: str) -> Table:
    """False isolation by mismatch case, and the worst exact isolation."""
    index, lines = index_of(rows), []
    unseen = mismatches(plant, unseen=True)
    for v in variants_of(rows, plant):
        false = [cell(found(index, plant, v, FALSE, (HEALTHY,), (m,))) for m in mismatches(plant)]
        worst = [least(found(index, plant, v, EXACT, (fault,), mismatches(plant))) for fault in (BIAS, DRIFT)]
        lines.append((v, *false, *worst))
    header = ["detector", *(m + UNSEEN * (m in unseen) for m in mismatches(plant))]
    return Table(
        "The model is wrong, no sensor is faulty: samples at which one is isolated",
        (*header, "worst exact isolation, bias 10 sigma", "worst, drift 10 sigma"),
        tuple(lines),
        caption="* unseen: no setting of any detector was chosen with these in view.",
        method=SHARES,
    )


def least(rows: Iterable[Row]) -> Cell:
    """The row with the smallest value."""
    those = [r for r in rows if np.isfinite(r.value)]
    return cell([min(those, key=lambda r: r.value)]) if those else NOT_TRIED


def process_table(rows: Sequence[Row], plant: str) -> Table:
    """What is said of process faults, and of the process under sensor faults."""
    index, lines = index_of(rows), []
    for fault in process_faults(plant):
        for v in variants_of(rows, plant):
            numbers = [
                cell(found(index, plant, v, metric, (fault,), ("",)), NO_VERDICT if metric in OF_THE_PROCESS else NOT_TRIED)
                for metric in (FALSE, VERDICT, NAMING, "detection_delay", "process_delay")
            ]
            lines.append((fault, v, *numbers))
    return Table(
        "The process is faulty, no sensor is",
        (
            *("process fault", "detector", "samples with a sensor isolated", "runs with a process verdict"),
            *("runs with the right name", "delay of the alarm (s)", "delay of the verdict (s)"),
        ),
        tuple(lines),
        method="The right name: the hypothesis accepted most often is one of "
        + "; ".join(f"{c.name}: {', '.join(c.named)}" for c in cases_of(compared_plant(plant)).process_faults)
        + ". A detector without hypotheses about the process has no verdict. Delays: of the runs that have one.",
    )


def sensor_table(rows: Sequence[Row], plant: str) -> Table:
    """Sensor faults that are taken for the process, slow drifts, and what a step costs."""
    index, lines = index_of(rows), []
    slow = list(dict.fromkeys(r.fault for r in rows if r.plant == plant and r.metric == AT_END))
    for v in variants_of(rows, plant):
        verdicts = [cell(found(index, plant, v, VERDICT, (fault,), ("",)), NO_VERDICT) for fault in RIGHT[1:]]
        drifts = [cell(found(index, plant, v, AT_END, (fault,), ("",))) for fault in slow]
        time = found(index, plant, v, RATIO, (HEALTHY,), ("",))
        lines.append((v, *verdicts, *drifts, time[0].value if time else NOT_TRIED))
    return Table(
        "A sensor is faulty: runs with a process verdict; slow drifts isolated by their end; time of a step",
        (
            *("detector", *(f"process verdict, {f.replace('-', ' ')}" for f in RIGHT[1:])),
            *(f"isolated, {f.replace('-', ' ')}" for f in slow),
            f"time of a step over that of {REFERENCE}",
        ),
        tuple(lines),
        method="A slow drift counts as isolated where exactly its sensor is at the last sample of its rise or within a tenth "
        "of the rise after that.",
    )


def tables_of(rows: Sequence[Row], plant: str) -> list[Table]:
    """All tables of a plant; the aims only with a detector that is judged by them."""
    found = [table(rows, plant) for table in (aims_table, right_table, mismatch_table, process_table, sensor_table)]
    return found if judged(rows, plant) else found[1:]
