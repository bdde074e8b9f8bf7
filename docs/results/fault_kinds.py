"""Writes fault-kinds.csv and fault-kinds.md: python docs/results/fault_kinds.py

Five minutes on one core. The page holds what fault-kinds.csv holds; a test renders it again.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.fault_kinds import KINDS
from fusion_sfdia.study.kind_trials import OTHERS, kind_trials

HERE = Path(__file__).parent
NUMBERS, PAGE = HERE / "fault-kinds.csv", HERE / "fault-kinds.md"
PLANTS, DETECTORS = ("two-tanks", "gas-pipeline"), ("loo-glr", "robust-glr")
SEEDS = range(100, 112)  # what sets the rules was chosen on seeds 0 to 19
COLUMNS = ("plant", "detector", "fault", "named", "count", "intervals", "covered", "others")

ABOUT = f"""# Kinds of faults, as named by a diagnosis

`python docs/results/fault_kinds.py`: a fault of 6 to 20 sigma (spikes at 10 to 30 % of the samples, dropouts of 70 % or all of
the readings) acts on a random sensor for 40 to 69 of 160 samples, {len(SEEDS)} of each kind for each plant and detector. Rows:
what the fault was; columns: what the longest event of its sensor while it acts is named. The rules (`fault_kinds`) were
chosen on other seeds. Last columns: in how many of the events of the right kind the 95 % interval of the size holds the true
size, and how many other sensors had an event. `robust-glr` isolates a sensor by two far readings in a row, since one may be an
outlier of a healthy sensor: of spikes that come one by one it says nothing.
"""


def measured() -> Iterator[dict[str, object]]:
    """A row for each plant, detector, kind, and kind as named."""
    for plant in PLANTS:
        for detector in DETECTORS:
            trials = kind_trials(registry.detector(detector, registry.plant(plant)), list(SEEDS))
            for fault in KINDS:
                mine = [t for t in trials if t.fault.kind == fault]
                for named, count in Counter(t.named for t in mine).items():
                    same = [t for t in mine if t.named == named]
                    known = [t.covered for t in same if t.covered is not None]
                    others = sum(t.others for t in same)
                    values = (plant, detector, fault, named, count, len(known), sum(known), others)
                    yield dict(zip(COLUMNS, values, strict=True))


def load() -> list[dict[str, str]]:
    """The rows of fault-kinds.csv."""
    with NUMBERS.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def render(rows: Sequence[dict[str, str]]) -> str:
    """The page of these rows."""
    named = [name for name in (*KINDS, *OTHERS) if any(r["named"] == name for r in rows)]
    parts = [ABOUT]
    for plant, detector in dict.fromkeys((r["plant"], r["detector"]) for r in rows):
        own = [r for r in rows if (r["plant"], r["detector"]) == (plant, detector)]
        lines = [f"| fault | {' | '.join(named)} | size within its interval | other sensors |", "|---" * (len(named) + 3) + "|"]
        for fault in KINDS:
            mine = [r for r in own if r["fault"] == fault]
            counts = [sum(int(r["count"]) for r in mine if r["named"] == name) for name in named]
            known, covered, others = (sum(int(r[c]) for r in mine) for c in ("intervals", "covered", "others"))
            inside = f"{covered} of {known}" if known else ""
            lines.append(f"| {fault} | {' | '.join(str(n or '') for n in counts)} | {inside} | {others or ''} |")
        right = sum(int(r["count"]) for r in own if r["fault"] == r["named"])
        total = sum(int(r["count"]) for r in own)
        parts.append(f"\n## {plant}, {detector}: {right} of {total} named rightly\n\n" + "\n".join(lines) + "\n")
    return "".join(parts)


if __name__ == "__main__":
    with NUMBERS.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(measured())
    PAGE.write_text(render(load()), encoding="utf-8")
