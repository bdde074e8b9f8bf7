"""The command `completion`: what a shell needs to complete commands, options and names."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

SHELLS = ("bash", "zsh", "fish")


def add_completion(commands: Any, top: argparse.ArgumentParser) -> None:
    """Add `completion` of the parser that has these commands."""
    one = commands.add_parser(
        "completion",
        help="print what a shell needs to complete commands, options and names",
        epilog='bash: eval "$(fusion-sfdia completion bash)" in ~/.bashrc; zsh: fusion-sfdia completion zsh > _fusion-sfdia in '
        "a folder of $fpath; fish: fusion-sfdia completion fish > ~/.config/fish/completions/fusion-sfdia.fish",
        allow_abbrev=False,
    )
    one.add_argument("shell", choices=SHELLS)
    one.set_defaults(work=partial(_completion, top))


def _completion(top: argparse.ArgumentParser, chosen: argparse.Namespace) -> int:
    from fusion_sfdia.common.errors import MissingPackageError
    from fusion_sfdia.detectors import registry

    try:
        import shtab
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            "completion needs shtab, which is not installed; install it with: pip install 'fusion-sfdia[completion]'"
        ) from error

    names = {"plant": sorted(registry.plants()), "detector": sorted(registry.detectors())}
    (commands,) = (action for action in top._actions if action.dest == "command")
    for one in dict(commands.choices or {}).values():
        for action in one._actions:
            if action.type is Path:
                action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE
            elif action.dest in names:
                action.choices = names[action.dest]
    print(shtab.complete(top, chosen.shell))
    return 0
