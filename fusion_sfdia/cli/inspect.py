"""The command `inspect`: what can be diagnosed with a plant."""

from __future__ import annotations

import argparse
import json
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

from fusion_sfdia.cli.options import add_columns, add_names, add_plant, add_tuned, loaded, printed_warnings, warn_of


def add_inspect(commands: Any) -> None:
    """Add `inspect`."""
    one = commands.add_parser("inspect", help="check a plant, and state which faults can be found with it", allow_abbrev=False)
    add_plant(one)
    one.add_argument("--data", type=Path, metavar="LOG", help="a log of the plant in order: are noise and model right?")
    one.add_argument("--map", type=Path, metavar="MAP.toml", help="how the log is written, and which column is which sensor")
    add_columns(one)
    add_tuned(one)
    one.add_argument("--detector", help="the detector of --tuned, where `list` does not show it")
    add_names(one, "--detectors", "those of the simulated runs (default: one of each school)")
    add_names(one, "--sensors", "those with a fault in simulated runs (default: all of up to 16)")
    one.add_argument("--no-simulation", action="store_true", help="theory only")
    one.add_argument("--out", type=Path, metavar="DIR", help="write inspection.txt and inspection.json into a folder")
    one.add_argument("--force", action="store_true", help="write into a folder that is in use")
    one.add_argument("--json", action="store_true", help="print JSON")
    one.set_defaults(work=_inspect)


def _inspect(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.common.files import locked

    with nullcontext() if chosen.out is None else locked(chosen.out, force=chosen.force):
        return _inspected(chosen)


def _inspected(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.cli.tune import chosen_plant, tuned_entry
    from fusion_sfdia.common.files import all_or_none, atomic_write
    from fusion_sfdia.common.plain_text import plain
    from fusion_sfdia.learning.inspection.inspect import inspect
    from fusion_sfdia.learning.inspection.inspection import as_json, as_text
    from fusion_sfdia.report.progress import progress

    if chosen.detector is not None and chosen.tuned is None:
        raise ValueError(
            "--detector is the one of --tuned, which is not given; the detectors of simulated runs are --detectors"
        )
    model = chosen_plant(chosen)
    healthy = None if chosen.data is None else loaded(chosen, chosen.data, model)
    if healthy is not None:
        warn_of(chosen.data, healthy.brief)
    with printed_warnings():
        found = inspect(
            model,
            None if healthy is None else healthy.log,
            detectors=chosen.detectors,
            sensors=chosen.sensors,
            simulated=not chosen.no_simulation,
            tuned=None if chosen.tuned is None else tuned_entry(chosen.plant, chosen.detector, chosen.tuned),
            each=partial(progress, what="inspecting"),
        )
    text, data = as_text(found), json.dumps(as_json(found), indent=2)
    if chosen.out is not None:
        with all_or_none(chosen.out) as new:
            for name, content in (("inspection.txt", text), ("inspection.json", data)):
                with atomic_write(new / name) as file:
                    file.write(plain(f"{content}\n"))
    print(data if chosen.json else text)
    return int(bool(found.mistakes))
