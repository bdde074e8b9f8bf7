"""The commands that run scenarios: `run`, and `compare`, which compares detectors."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fusion_sfdia.cli.options import add_tuned
from fusion_sfdia.common.numerals import integer

# those of comparison.protocol, which would import NumPy: a test holds them equal
FAULTS = (
    *("bias", "drift", "noise", "scale", "freeze", "dropout", "two-faults", "three-faults"),
    *("replay", "sign", "published"),
)
SETTINGS = {
    "magnitudes": "1,3,10,30",
    "lengths": "2,5,30,120",
    "settle": "0",
    "window": "30",
    "false_alarm": "0.001",
    "calibration_error": "0",
    "mismatch_cases": "true",
    "process_faults": "true",
    "missed_cost": "1",
    "false_isolation_cost": "2",
    "delay_cost": "0.5",
    "wrong_model_share": "0.5",
}


def add_run(commands: Any) -> None:
    """Add `run`."""
    one = commands.add_parser("run", help="run scenarios and write a report", allow_abbrev=False)
    one.add_argument("scenario", nargs="+", help="a name, or a glob such as 'pipeline/*'")
    add_common(one, seeds="runs of each scenario", full="as many runs as the paper", folder="results/ and the scenario's name")
    one.set_defaults(work=_run)


def add_compare(commands: Any) -> None:
    """Add `compare`, which calls `fusion_sfdia.compare`."""
    one = commands.add_parser(
        "compare",
        help="compare detectors on plants under one protocol",
        epilog=f"Names of --faults: {', '.join(FAULTS)}. Keys of --set and their defaults: "
        f"{', '.join(f'{key}={value}' for key, value in SETTINGS.items())}. Magnitudes are in sigma of the sensor's noise; "
        "lengths, settle and window in samples; costs and the share of wrong models weigh the loss that ranks "
        "detectors. Names of plants and detectors: fusion-sfdia list.",
        allow_abbrev=False,
    )
    for what in ("plants", "detectors", "faults"):
        one.add_argument(
            f"--{what}", dest="set", action="append", default=[], type=f"{what}={{}}".format, metavar="A,B", help="only these"
        )
    add_tuned(one, "plant")
    add_common(
        one,
        seeds="runs of each fault",
        full="every sensor, and enough runs to rank detectors: hours",
        folder="results/comparison",
    )
    one.set_defaults(work=_compare)


def add_common(one: argparse.ArgumentParser, *, seeds: str, full: str, folder: str) -> None:
    """Add the size of a run, where it is worked on, its folder and its settings."""
    size = one.add_mutually_exclusive_group()
    size.add_argument("--seeds", type=integer, metavar="N", help=seeds)
    size.add_argument("--full", action="store_true", help=full)
    one.add_argument("--workers", type=integer, metavar="N", help="processes (default: one a core)")
    one.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="work on a running dask cluster instead, such as tcp://host:8786; tcp has no authentication and both sides run "
        "the code they are sent: on a trusted network only, else tls://",
    )
    one.add_argument("--out", type=Path, metavar="DIR", help=f"folder of the results (default: {folder})")
    one.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change a setting of the scenarios; each once"
    )
    one.add_argument(
        "--force",
        action="store_true",
        help="write into a folder that is in use for something else; finished parts of another run are reused where they fit",
    )
    one.add_argument("--json", action="store_true", help="print the rows of metrics.csv as JSON")


def _run(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.study.experiments.runner import run_scenarios
    from fusion_sfdia.study.scenarios import match_scenarios, scenario

    changes = changed_settings(chosen.set)
    names = match_scenarios(chosen.scenario)
    out = chosen.out or Path("results") / "-".join(chosen.scenario).replace("/", "-").replace("*", "all")
    outcome = run_scenarios(
        [scenario(name) for name in names],
        out,
        seeds=chosen.seeds,
        full=chosen.full,
        changes=changes,
        workers=chosen.workers,
        scheduler=chosen.scheduler,
        force=chosen.force,
    )
    return reported(outcome, out, as_json=chosen.json)


def _compare(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.cli.tune import tuned_plant
    from fusion_sfdia.detectors.registry import plant, require_known
    from fusion_sfdia.study.comparison import protocol
    from fusion_sfdia.study.comparison.compare import compare

    settings: dict[str, Any] = changed_settings(chosen.set)
    for key in settings:
        require_known("setting", key, protocol.SETTINGS)
    for kind in ("plants", "detectors"):
        if kind in settings:
            settings[kind] = [name.strip() for name in settings[kind].split(",") if name.strip()]
    if chosen.tuned is not None:
        if len(settings.get("plants", ())) != 1:
            raise ValueError(f"--tuned {chosen.tuned} is of one plant; name it, and no other, with --plants")
        settings["plants"] = tuned_plant(plant(*settings["plants"]), chosen.tuned)
    out = chosen.out or Path("results") / "comparison"
    found = compare(
        seeds=chosen.seeds,
        full=chosen.full,
        workers=chosen.workers,
        scheduler=chosen.scheduler,
        out=out,
        force=chosen.force,
        **settings,
    )
    return reported(found, out, as_json=chosen.json)


def reported(found: Any, out: Path, *, as_json: bool) -> int:
    """Print what was found, an Outcome or a ComparisonResult; 1 where some work failed."""
    from fusion_sfdia.report import results

    if as_json:
        print(results.as_json(found.rows))
    else:
        for line in found.highlights:
            print(line)
        print(f"{len(found.rows)} numbers in {out / 'metrics.csv'}; report: {out / 'report.html'}")
    for line in found.notes:
        print(f"fusion-sfdia: note: {line}", file=sys.stderr)
    for line in found.failures:
        print(f"fusion-sfdia: failed: {' '.join(line.split())}", file=sys.stderr)
    return 1 if found.failures else 0


def changed_settings(texts: Sequence[str]) -> dict[str, str]:
    """The settings of --set, each KEY=VALUE; ValueError for another form, and for one that is given twice."""
    found: dict[str, str] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not (key and equals):
            raise ValueError(f"--set {text}: expected KEY=VALUE")
        if key in found:
            raise ValueError(f"setting {key} is given twice, as {found[key]!r} and {value!r}; give it once")
        found[key] = value
    return found
