"""The command `bench`: the speed on this machine."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from fusion_sfdia.core.numerals import decimal


def add_bench(commands: Any) -> None:
    """Add `bench`."""
    one = commands.add_parser("bench", help="measure the speed on this machine, on one thread", allow_abbrev=False)
    one.add_argument("part", nargs="*", help="bank, model, scaling, lorenz, engine, stream, growth (default: all)")
    one.add_argument("--seconds", type=decimal, default=2.0, metavar="S", help="for each thing that is timed (default: 2)")
    one.add_argument("--out", type=Path, metavar="DIR", help="folder for metrics.csv")
    one.add_argument("--force", action="store_true", help="write into a folder that is in use")
    one.add_argument("--json", action="store_true", help="print the rows of metrics.csv as JSON")
    one.set_defaults(work=_bench)


def _bench(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.benchmarks.speed import bench
    from fusion_sfdia.evaluation.results import as_json

    rows = bench.run(chosen.part, chosen.out, chosen.seconds, force=chosen.force)
    print(as_json(rows) if chosen.json else "\n".join(bench.as_text(row) for row in rows))
    return 0
