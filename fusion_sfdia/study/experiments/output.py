"""The folder of a run: the manifest of its contents, and what may be written into it."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fusion_sfdia.common.files import LOCK, TEMPORARY, atomic_write, remove_leftovers, require_free
from fusion_sfdia.study.experiments.parts import PART_NAME

MANIFEST = "manifest.json"
OWN_FILE = re.compile(r"metrics\.csv|report\.html|figures/[a-z0-9-]+\.(svg|png)")


@dataclass(frozen=True)
class Command:
    """A run as defined by its command. Runs of one command may share a folder: the second reuses parts of the first."""

    scenarios: tuple[str, ...]
    seeds: int | None = None
    full: bool = False
    changes: tuple[tuple[str, str], ...] = ()

    @property
    def text(self) -> str:
        """The command line, without the folder and the number of workers."""
        options = ["--full"] if self.full else [] if self.seeds is None else ["--seeds", str(self.seeds)]
        for key, value in self.changes:
            options += ["--set", f"{key}={value}"]
        return shlex.join(["fusion-sfdia", "run", *self.scenarios, *options])


def open_output(out: Path, command: Command, *, force: bool = False) -> None:
    """Make the folder ready for a run, or raise ValueError where it is in use for something else.

    Free to use: an absent or empty folder, and one of an earlier or interrupted run of the same command. force: also one
    of another run, whose files stay until this one has its own, finished parts that both runs need for good, and one of
    anything else, whose files stay unless they have our names.
    """
    require_free(out, force=True)
    found = [p.name for p in out.iterdir() if not p.name.startswith((LOCK, TEMPORARY))] if out.exists() else []
    earlier = read_manifest(out)
    same = earlier is not None and earlier.get("command") == command.text
    if found and not same and not force:
        what, cure = "files that are not a run of fusion-sfdia", "write into it with --force"
        if earlier is not None:
            what = f"another run ({earlier.get('command')})"
            cure = "replace that run with --force, which reuses its finished parts that this run needs"
        raise ValueError(f"{out} is already used: it holds {what}; name another folder with --out, or {cure}")
    kept = earlier if same and earlier else {"files": own_files(earlier or {})}
    try:
        write_manifest(out, {**kept, "command": command.text, "finished": False})
        (out / "parts").mkdir(exist_ok=True)
    except OSError as error:
        raise ValueError(f"cannot write into {out} ({error.strerror}); name another folder with --out") from error


def read_manifest(out: Path) -> dict[str, Any] | None:
    """Return the manifest of a folder; None where it holds none of this package."""
    try:
        manifest = json.loads((out / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return manifest if isinstance(manifest, dict) and manifest.get("program") == "fusion-sfdia" else None


def write_manifest(out: Path, manifest: dict[str, Any]) -> None:
    """Write the manifest, whole or not at all."""
    with atomic_write(out / MANIFEST) as file:
        json.dump({"program": "fusion-sfdia", **manifest}, file, indent=2, ensure_ascii=False)
        file.write("\n")


def own_files(manifest: dict[str, Any]) -> list[str]:
    """Return the files that a manifest lists, only those with names that a run writes."""
    return [name for name in manifest.get("files", ()) if isinstance(name, str) and OWN_FILE.fullmatch(name)]


def remove(out: Path, names: Iterable[str]) -> None:
    """Remove files of a run."""
    for name in names:
        (out / name).unlink(missing_ok=True)


def remove_other_parts(out: Path, keep: set[str]) -> None:
    """Remove parts that do not belong to the run, and unfinished ones of killed processes."""
    remove_leftovers(out / "parts")
    for path in (out / "parts").glob("*"):
        if path.name not in keep and PART_NAME.fullmatch(path.name):
            path.unlink(missing_ok=True)
