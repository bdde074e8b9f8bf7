"""The command `bench`: the speed on this machine."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from fusion_sfdia.common.numerals import decimal


def add_bench(commands: Any) -> None:
    """Add `bench`."""
    one = commands.add_parser("bench", help="measure the speed on this machine, on one thread", allow_abbrev=False)
    parts = (
        "bank, model, scaling, lorenz, engine, stream, own, network, campaigns, logs, start, workers, peers, growth, roofline"
    )
    one.add_argument("part", nargs="*", help=f"{parts} (default: all but roofline)")
    one.add_argument("--seconds", type=decimal, default=2.0, metavar="S", help="for each thing that is timed (default: 2)")
    one.add_argument("--out", type=Path, metavar="DIR", help="folder for metrics.csv")
    one.add_argument("--force", action="store_true", help="write into a folder that is in use")
    one.add_argument("--history", type=Path, metavar="FILE", help="add this run to a file of runs")
    one.add_argument(
        "--against",
        type=Path,
        metavar="FILE",
        help="state what is slower than in a file of runs, measured twice; exit code 1 if anything is",
    )
    one.add_argument("--json", action="store_true", help="print the rows of metrics.csv as JSON")
    one.set_defaults(work=_bench)


def _bench(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.benchmarks.speed import bench, growth, history, slower
    from fusion_sfdia.report.results import as_json

    before = [] if chosen.against is None else history.alike(history.read(chosen.against), chosen.against)
    if chosen.history is not None and chosen.history.exists():
        history.read(chosen.history)  # before anything is measured
    rows = bench.run(chosen.part, chosen.out, chosen.seconds, force=chosen.force)
    print(as_json(rows) if chosen.json else "\n".join(bench.as_text(row) for row in rows))
    run = history.entry(rows, chosen.seconds)
    if chosen.history is not None:
        history.append(chosen.history, run)
    problems = growth.excessive(rows)
    for line in problems:
        print(line, file=sys.stderr)
    known = [history.ratios(b) for b in before]
    changes = slower.compared(known, history.ratios(run))
    if before and not changes:
        raise ValueError(f"{chosen.against} has none of the rows of this run; measure the same parts")
    if parts := list(dict.fromkeys(c.key[0].removeprefix("bench/") for c in changes if c.slower)):
        again = history.entry(bench.run(parts, None, chosen.seconds), chosen.seconds)
        changes = slower.confirmed(changes, slower.compared(known, history.ratios(again)))
    if before:
        print("\n".join(slower.as_text(changes)), file=sys.stderr if chosen.json else sys.stdout)
    return int(bool(problems) or any(c.slower for c in changes))
