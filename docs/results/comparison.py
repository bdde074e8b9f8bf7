"""Writes comparison.csv, comparison.md and loss.svg from a comparison's metrics.csv: python docs/results/comparison.py METRICS.

The page holds what comparison.csv holds, which is the part of metrics.csv that it shows; a test renders it again.
"""

from __future__ import annotations

import csv
import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from fusion_sfdia.detectors import registry
from fusion_sfdia.report.figure_files import figure_svg
from fusion_sfdia.study.comparison.figures import Losses, draw_loss
from fusion_sfdia.study.comparison.protocol import COSTS
from fusion_sfdia.study.comparison.result_tables import cost_words

HERE = Path(__file__).parent
FALSE_ISOLATION = "false_isolation_probability"  # the metric
COLUMNS = ("plant", "detector", "fault", "quantity", "condition", "metric", "value", "low", "high", "n")
PLANTS = ("two-tanks", "marine-engine", "gas-pipeline", "power-network")
LENGTHS = (2, 5, 30, 120)
CRITERIA = ("loss", "detection", "isolation", "accommodation", "exoneration")
ABSENT = "not applicable"

Row = dict[str, str]
Index = Mapping[tuple[str, str, str, str, str], Row]

ABOUT = """# The comparison

`fusion-sfdia compare --seeds 24`: every detector gets the same readings, and its thresholds are scaled so that one healthy
step in 1000 alarms over all sensors, as long as nothing has been isolated. In brackets 95 % intervals over seeds, in which the
uncertainty of that scale is contained. A fault begins at a time that is drawn, on a sensor that is drawn, and lasts 30 samples
unless stated otherwise; sigma is the standard deviation of the sensor's noise. Memory: over what a detector's test gathers
evidence; "state estimate only" is a filter whose test judges the present sample.

The truth differs from the detectors' model where a plant has a high-fidelity model: the pipeline is computed on a finer grid,
the network as a whole where the model goes area by area, the tanks with friction in the outlets. The engine's truth is its
model. So numbers for the engine, and for the tanks and the pipeline up to a small difference, are those without model mismatch;
results with mismatch are in the tables of false isolation.

`robust-glr` was measured again on the same readings after its last changes. Its ranks are of the run of all detectors before
them, since a rank asks for the readings of all, run by run.
"""

# title, what it shows, fault, quantity, metric
TABLES = (
    ("Area under the ROC, bias of 3 sigma", "single samples; 0.5 is guessing", "bias-3-sigma", "auc"),
    (
        "Mean area under the ROCs of bias, drift, noise, scale and freeze, 3 sigma",
        "a bias alone would favour tests that look for a bias; a freeze has no size",
        "graded-3-sigma",
        "auc",
    ),
    (
        "Exact isolation, faults of 10 sigma",
        "share of faulty samples at which the faulty sensor, and it alone, is isolated; bias, drift, noise and scale alike",
        "graded-10-sigma",
        "exact_isolation",
    ),
    ("Exact isolation, two faults at once", "biases of 10 sigma", "two-faults", "exact_isolation"),
    ("Exact isolation, three faults at once", "biases of 10 sigma", "three-faults", "exact_isolation"),
    (
        "Error after over before accommodation, faults of 10 sigma",
        "of the readings of the faulty sensors; 1 where nothing is replaced",
        "graded-10-sigma",
        "rmse_ratio",
    ),
    (
        "Healthy samples with an alarm, as deployed",
        "with alarms that last once they are raised; 0.001 would be none of them",
        "none",
        "deployed_false_alarm_probability",
    ),
)


def needed(row: Row) -> bool:
    """Whether the page shows a row."""
    shown = {(fault, "", metric) for _, _, fault, metric in TABLES}
    shown |= {(f"bias-{m}-sigma", f"{n} samples", k) for m, k in (("3", "auc"), ("10", "exact_isolation")) for n in LENGTHS}
    rates = ("nominal_false_alarm_probability", "claimed_false_alarm_probability")
    return (
        (row["fault"], row["condition"], row["metric"]) in shown
        or row["metric"] in rates
        or row["metric"] == FALSE_ISOLATION
        or row["fault"] == "ranked"
    )


def load(path: Path) -> list[Row]:
    """The rows of a file that the page shows."""
    with path.open(encoding="utf-8", newline="") as file:
        return [{c: row[c] for c in COLUMNS} for row in csv.DictReader(file) if needed(row)]


def shortened(row: Row) -> Row:
    """Numbers to four digits."""
    return row | {c: f"{float(row[c]):.4g}" for c in ("value", "low", "high") if row[c]}


def interval(row: Row | None) -> str:
    """A value with its interval, two decimals; ABSENT for none."""
    if row is None or row["value"] in ("", "nan"):
        return ABSENT if row is None else "none"
    value, digits = float(row["value"]), 2
    if 0 < abs(value) < 0.095:
        digits = 3
    shown = f"{value:.{digits}f}"
    if row["low"] in ("", "nan"):
        return shown
    return f"{shown} [{float(row['low']):.{digits}f}, {float(row['high']):.{digits}f}]"


def table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    rows = [header, ["---"] * len(header), *lines]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in rows)


def by_plant(detectors: Sequence[str], cell: Callable[[str, str], str]) -> str:
    """A table of detectors down and plants across, without detectors that apply to no plant."""
    known = registry.detectors()
    lines = [(f"`{d}`", known[d].memory, *(cell(p, d) for p in PLANTS)) for d in detectors]
    return table(("detector", "memory", *PLANTS), [line for line in lines if set(line[2:]) != {ABSENT}])


def worst(rows: Sequence[Row], plant: str, detector: str, *, mismatch: bool) -> str:
    """The largest share of samples with a false isolation, under model mismatch or under a process fault."""
    found = [
        row
        for row in rows
        if (row["plant"], row["detector"], row["metric"]) == (plant, detector, FALSE_ISOLATION)
        and row["fault"] != "dropout"
        and ((row["fault"] == "none" and row["condition"]) if mismatch else (row["fault"] != "none"))
        and row["value"] not in ("", "nan")
    ]
    if not found:
        return ABSENT
    top = max(found, key=lambda row: float(row["value"]))
    return f"{interval(top)} ({top['condition'] if mismatch else top['fault']})"


def index_of(rows: Sequence[Row]) -> Index:
    """Rows by plant, detector, fault, condition (the quantity of rows without one), and metric."""
    return {(r["plant"], r["detector"], r["fault"], r["condition"] or r["quantity"], r["metric"]): r for r in rows}


def render(rows: Sequence[Row]) -> str:
    """The page."""
    index = index_of(rows)
    detectors = list(dict.fromkeys(r["detector"] for r in rows))
    losses = by_plant(detectors, lambda p, d: interval(index.get((p, d, "ranked", "loss", "score"))))
    parts = [
        ABOUT,
        f"## Loss\n\n{cost_words(COSTS)} In brackets intervals over seeds, thresholds as they are. "
        "Bold in the figure: no detector costs less beyond chance.\n\n"
        f"![The loss of every detector on every plant](loss.svg)\n\n{losses}\n",
    ]
    for title, about, fault, metric in TABLES:
        shown = by_plant(detectors, lambda p, d, fault=fault, metric=metric: interval(index.get((p, d, fault, "all", metric))))
        parts.append(f"## {title}\n\n{about[0].upper() + about[1:]}.\n\n{shown}\n")
    for mismatch, title in ((True, "model mismatch"), (False, "process fault")):
        shown = by_plant(detectors, lambda p, d, mismatch=mismatch: worst(rows, p, d, mismatch=mismatch))
        parts.append(
            f"## False isolation under the worst {title}\n\nShare of samples at which a healthy sensor is isolated though "
            f"none is faulty.\n\n{shown}\n"
        )
    for plant in PLANTS:
        there = [d for d in detectors if (plant, d, "bias-3-sigma", "all", "auc") in index]
        header = ["detector"]
        header += [f"area, 3 sigma, {n}" for n in LENGTHS] + [f"exact, 10 sigma, {n}" for n in LENGTHS]
        lines = [
            [
                f"`{d}`",
                *(interval(index.get((plant, d, "bias-3-sigma", f"{n} samples", "auc"))) for n in LENGTHS),
                *(interval(index.get((plant, d, "bias-10-sigma", f"{n} samples", "exact_isolation"))) for n in LENGTHS),
            ]
            for d in there
        ]
        parts.append(f"## How long a bias lasts, in samples: {plant}\n\n{table(header, lines)}\n")
    for plant in (*PLANTS, "all plants"):
        ranked = [d for d in detectors if any((plant, d, "ranked", c, "rank") in index for c in CRITERIA)]
        lines = []
        for d in sorted(ranked, key=lambda d: float(index[plant, d, "ranked", "loss", "score"]["value"])):
            found = [index[plant, d, "ranked", c, "rank"]["value"] for c in CRITERIA]
            lines.append([f"`{d}`", *(f"{float(v):.0f}" for v in found)])
        if lines:
            parts.append(
                f"## Ranks: {plant}\n\nOne more than the number of detectors that are better beyond chance (paired over seeds "
                f"and kinds of faults, 5 % over all pairs); equal ranks are no difference that is shown.\n\n"
                f"{table(('detector', *CRITERIA), lines)}\n"
            )
    parts.append(claims(index, detectors))
    return "\n".join(parts)


def claims(index: Index, detectors: Sequence[str]) -> str:
    """Rates of false alarms at the detectors' own thresholds, beside what they claim."""

    def cell(plant: str, detector: str) -> str:
        own = index.get((plant, detector, "none", "all", "nominal_false_alarm_probability"))
        claimed = index.get((plant, detector, "none", "all", "claimed_false_alarm_probability"))
        if own is None or claimed is None:
            return ABSENT if own is None else "claims none"
        value, low, high = (float(own[c] or "nan") for c in ("value", "low", "high"))
        exceeded = low > float(claimed["value"])
        return f"{value:.2g} [{low:.2g}, {high:.2g}]{' exceeds' if exceeded else ''} {float(claimed['value']):.2g}"

    return (
        "## False alarms at the detectors' own thresholds\n\nPer step over all sensors, in calibration runs; last the claim, "
        f"which is marked where it is shown to be exceeded.\n\n{by_plant(detectors, cell)}\n"
    )


def mark(numbers: object) -> str:
    """The last line of a figure's file: a digest of its numbers, by which a test notices that it has to be drawn again."""
    return f"<!-- numbers: {hashlib.sha256(json.dumps(numbers).encode()).hexdigest()} -->\n"


def losses_of(rows: Sequence[Row]) -> tuple[Losses, dict[str, list[str]]]:
    """The parts of the losses, and by plant the detectors that none beats beyond chance."""
    losses: dict[str, dict[str, dict[str, float]]] = {}
    best: dict[str, list[str]] = {plant: [] for plant in PLANTS}
    for row in rows:
        if row["metric"] == "loss_part":
            of = losses.setdefault(row["plant"], {}).setdefault(row["detector"], {})
            of[row["quantity"]] = float(row["value"])
        elif (row["metric"], row["quantity"], row["value"]) == ("rank", "loss", "1") and row["plant"] in best:
            best[row["plant"]].append(row["detector"])
    return {plant: losses[plant] for plant in PLANTS}, best


def main(metrics: Path) -> None:
    """Write the numbers, the page and the figure."""
    rows = [shortened(row) for row in load(metrics)]
    with (HERE / "comparison.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    (HERE / "comparison.md").write_text(render(rows), encoding="utf-8")
    losses = losses_of(rows)
    (HERE / "loss.svg").write_text(figure_svg("loss", lambda: draw_loss(*losses)) + mark(losses), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
