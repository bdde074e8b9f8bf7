"""The command `papers`: what the papers publish, beside ours."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

PAPERS = ("shaheen2024", "kougiatsos2024", "kougiatsos2022", "virtual2022", "boem2018")


def add_papers(commands: Any) -> None:
    """Add `papers`."""
    from fusion_sfdia.cli.scenarios import add_common

    one = commands.add_parser(
        "papers",
        help="measure what the papers publish, and compare",
        epilog="Runs the scenarios that have numbers of the papers beside their own. published.csv has each published number "
        "with ours; a number is met where it is within our 95 % interval.",
        allow_abbrev=False,
    )
    one.add_argument("--paper", choices=PAPERS, help="of one paper alone (default: all)")
    add_common(one, seeds="runs of each scenario", full="the sizes of the papers: an hour or more", folder="results/papers")
    one.set_defaults(work=_papers)


def _papers(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.cli.scenarios import changed_settings, reported
    from fusion_sfdia.report.results import write_rows
    from fusion_sfdia.study.experiments.runner import run_scenarios
    from fusion_sfdia.study.scenarios import SCENARIOS, scenario

    found = [scenario(name) for name in SCENARIOS]
    papers = [s for s in found if s.papers and (chosen.paper is None or chosen.paper in s.papers)]
    out = chosen.out or Path("results") / "papers"
    outcome = run_scenarios(
        papers, out, seeds=chosen.seeds, full=chosen.full, changes=changed_settings(chosen.set), workers=chosen.workers,
        scheduler=chosen.scheduler, force=chosen.force,
    )  # fmt: skip
    stated = [row for row in outcome.rows if row.published is not None]
    write_rows(out / "published.csv", stated)
    code = reported(outcome, out, as_json=chosen.json)
    if not chosen.json:
        judged = [row.agrees for row in stated if row.agrees is not None]
        print(
            f"{len(stated)} rows with a published number, {sum(judged)} of {len(judged)} with an interval are within it: "
            f"{out / 'published.csv'}"
        )
    return code
