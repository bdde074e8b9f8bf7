"""The command `init`: a first map of a log, and a first plant of its columns."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from typing import Any

from fusion_sfdia.cli.options import WHICH

MAP, PLANT = "map.toml", "plant.py"


def add_init(commands: Any) -> None:
    """Add `init`."""
    one = commands.add_parser(
        "init",
        help="draft the map of a log, and without --plant also a plant for its columns",
        epilog="What fits the log in several ways is marked as unsure in the map, with the alternatives. Exit code 0: the log "
        "is read by the map as it stands; 2: what is still to be settled is printed, and stated in the map.",
        allow_abbrev=False,
    )
    one.add_argument("--data", type=Path, required=True, metavar="LOG", help="the log, as for check-log")
    one.add_argument("--plant", help=f"{WHICH}, or a model.fmu: its sensors are looked for among the columns")
    one.add_argument("--out", type=Path, default=Path(), metavar="DIR", help="folder of the files (default: the present one)")
    one.add_argument("--force", action="store_true", help="replace files that are there")
    one.set_defaults(work=_init)


def _init(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.common.files import atomic_write
    from fusion_sfdia.detectors import registry
    from fusion_sfdia.logs.draft import draft_map, settle
    from fusion_sfdia.logs.problems import LogError
    from fusion_sfdia.report.skeleton import skeleton, skeleton_plant

    written = [chosen.out / MAP, *([] if chosen.plant else [chosen.out / PLANT])]
    if there := [path for path in written if path.exists() and not chosen.force]:
        raise ValueError(f"{there[0]} exists; name another folder with --out, or replace it with --force")
    plant = registry.plant(chosen.plant) if chosen.plant else None
    draft = draft_map(chosen.data, plant)
    name = re.sub(r"\W+", "-", chosen.data.name.partition(".")[0]).strip("-") or "plant"
    settle(draft, chosen.data, plant or skeleton_plant(draft, name))
    texts = [draft.text(chosen.data.name), *([] if plant else [skeleton(draft, name, chosen.data.name)])]
    for path, text in zip(written, texts, strict=True):
        with atomic_write(path) as file:
            file.write(text)
    count = len(draft.columns) + len(draft.inputs) + len(draft.unused)
    print(f"{', '.join(map(str, written))}: {len(draft.columns)} of {count} columns are used")
    for key in draft.unsure:
        print(f"  {key}: {draft.notes[key]}")
    for option, why in draft.options.items():
        print(f"  {option}: {why}")
    if draft.problems:
        print(f"fusion-sfdia: {LogError(draft.problems)}", file=sys.stderr)
        return 2
    given = f"--plant {chosen.plant or f'{written[-1]}:make'} --data {chosen.data} --map {written[0]}"
    print(f"next: fusion-sfdia check-log {given}")
    return 0
