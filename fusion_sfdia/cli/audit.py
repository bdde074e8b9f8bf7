"""The command `audit`: which errors of real plants a detector survives on a plant."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

from fusion_sfdia.cli.options import add_detector, add_names, add_plant, add_tuned
from fusion_sfdia.common.numerals import integer


def add_audit(commands: Any) -> None:
    """Add `audit`."""
    one = commands.add_parser(
        "audit",
        help="try which errors of sensors, model and start a detector survives on a plant",
        epilog="Trials are simulated with errors that no detector was tuned to: noise that is not as stated, wrong "
        "parameters, a start elsewhere, one and two causes. The table states how often healthy sensors are isolated, and how "
        "often the verdict is right, undecided, wrong or missing.",
        allow_abbrev=False,
    )
    add_plant(one)
    add_detector(one)
    add_tuned(one)
    one.add_argument("--seeds", type=integer, default=8, metavar="N", help="trials of each case (default: 8)")
    one.add_argument("--first-seed", type=integer, default=0, metavar="N", help="(default: 0)")
    one.add_argument(
        "--steps", type=integer, default=300, metavar="N", help="rows of a trial, judged from the first (default: 300)"
    )
    add_names(one, "--groups", "readings, start, model, cause (default: all)")
    one.add_argument("--workers", type=integer, metavar="N", help="processes (default: one a core)")
    one.add_argument("--out", type=Path, metavar="FILE.csv", help="write the numbers with their intervals")
    one.add_argument("--force", action="store_true", help="replace a file that is there")
    one.add_argument("--json", action="store_true", help="print the numbers as JSON")
    one.set_defaults(work=_audit)


def _audit(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.cli.tune import bound_detector
    from fusion_sfdia.report.progress import progress
    from fusion_sfdia.report.results import as_json, write_rows
    from fusion_sfdia.study.audit import audit
    from fusion_sfdia.study.error_protocol import GROUPS
    from fusion_sfdia.study.experiments.provenance import cores

    if chosen.out is not None and (chosen.out.is_dir() or (chosen.out.is_file() and not chosen.force)):
        raise ValueError(f"{chosen.out} exists; name another file with --out, or replace it with --force")
    name, _ = bound_detector(chosen.plant, chosen.detector, chosen.tuned, simulated=True)
    found = audit(
        partial(_built, chosen.plant, chosen.detector, chosen.tuned),
        seeds=range(chosen.first_seed, chosen.first_seed + chosen.seeds),
        steps=chosen.steps,
        groups=chosen.groups or GROUPS,
        workers=chosen.workers or cores(),
        each=lambda done, count: iter(progress(done, "auditing", count)),
        name=name,
    )
    rows = found.rows()
    if chosen.out is not None:
        write_rows(chosen.out, rows)
    print(as_json(rows) if chosen.json else found)
    return 0


def _built(plant: str, detector: str | None, tuned: Path | None) -> Any:
    """The detector, in a process of its own; what there is to warn of has been said once."""
    import warnings

    from fusion_sfdia.cli.tune import bound_detector

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return bound_detector(plant, detector, tuned, simulated=True)[1]
