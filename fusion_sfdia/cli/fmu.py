"""The command `fmu`: what a Functional Mock-up Unit is, and what its plant still needs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_fmu(commands: Any) -> None:
    """Add `fmu`."""
    one = commands.add_parser("fmu", help="describe an FMU, as a file of settings for its plant", allow_abbrev=False)
    one.add_argument("path", type=Path, metavar="MODEL.fmu", help="a Functional Mock-up Unit of FMI 2.0 or 3.0")
    one.add_argument("--kind", choices=("model exchange", "co-simulation"), help="default: the first that it has")
    one.set_defaults(work=_fmu)


def _fmu(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.plant.fmu.settings import describe

    print(describe(chosen.path, chosen.kind))
    return 0
