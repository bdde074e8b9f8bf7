"""The command `papers`: what the papers publish, beside ours."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

# those of study.published_numbers, which would import NumPy: a test holds them equal
PAPERS = ("shaheen2024", "kougiatsos2024", "kougiatsos2022", "virtual2022", "boem2018")
RULE = (
    "Met: within our interval and, as a wide interval proves nothing, ours within a factor 2 of it; or within 0.5 % "
    "of it; a bound, where ours is not shown to be beyond it."
)


def add_papers(commands: Any) -> None:
    """Add `papers`."""
    from fusion_sfdia.cli.scenarios import add_common

    one = commands.add_parser(
        "papers",
        help="measure what the papers publish, and compare",
        epilog="Runs the scenarios that have numbers of the papers beside their own, and writes published.md with a figure for "
        f"each paper, and published.csv: each published number with ours, in 95 % intervals. {RULE} Each number that is missed "
        "is given a reason, known from full runs, or marked unexplained.",
        allow_abbrev=False,
    )
    one.add_argument("--paper", choices=PAPERS, help="of one paper alone (default: all)")
    add_common(one, seeds="runs of each scenario", full="the sizes of the papers: hours", folder="results/papers")
    one.set_defaults(work=_papers)


def _papers(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.cli.scenarios import changed_settings, reported
    from fusion_sfdia.study.experiments.runner import run_scenarios
    from fusion_sfdia.study.published_numbers import PAGE, counts, stated, write_page
    from fusion_sfdia.study.scenarios import SCENARIOS, scenario

    known = [scenario(name) for name in SCENARIOS]
    papers = [s for s in known if s.papers and (chosen.paper is None or chosen.paper in s.papers)]
    out = chosen.out or Path("results") / "papers"
    outcome = run_scenarios(
        papers, out, seeds=chosen.seeds, full=chosen.full, changes=changed_settings(chosen.set), workers=chosen.workers,
        scheduler=chosen.scheduler, force=chosen.force,
    )  # fmt: skip
    rows = stated(outcome.rows, chosen.paper)
    found = counts(write_page(out, rows))
    code = reported(outcome, out, as_json=chosen.json)
    if not chosen.json:
        print(
            f"{found.numbers} published numbers: met as read by default {found.by_default}, by some reading {found.by_some}; "
            f"missed with a reason {found.explained}, unexplained {found.unexplained}: {out / PAGE}"
        )
    return code
