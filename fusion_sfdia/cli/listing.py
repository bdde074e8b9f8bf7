"""The command `list`: plants, detectors, faults and scenarios by name. Nothing heavy is imported for the first two."""

from __future__ import annotations

import argparse
import json
from typing import Any

from fusion_sfdia.detectors import registry
from fusion_sfdia.study import scenarios

KINDS = ("plants", "detectors", "faults", "scenarios")
DRAWN = "at random, with simulate --fault NAME[:QUANTITY]"
LISTED = "kinds, for the [[fault]] tables of simulate --faults FILE.toml"
BOTH = "sensors and process"


def add_list(commands: Any) -> None:
    """Add `list`."""
    one = commands.add_parser("list", help="list plants, detectors, faults and scenarios by name", allow_abbrev=False)
    one.add_argument("kind", nargs="?", choices=KINDS, help="only these")
    one.add_argument("--json", action="store_true", help="print JSON")
    one.set_defaults(work=_list)


def _list(chosen: argparse.Namespace) -> int:
    found = {kind: entries(kind) for kind in KINDS if chosen.kind in (None, kind)}
    if chosen.json:
        print(json.dumps(found, indent=2))
        return 0
    for kind, listed in found.items():
        if chosen.kind is None:
            print(f"{kind}:")
        width = max((len(e["name"]) for e in listed), default=0)
        use = None
        for entry in listed:
            if use != (use := entry.get("use")):
                print(f" {use}:")
            package = entry.get("package", registry.OURS)
            origin = "" if package == registry.OURS else f" (from {package})"
            also = " [tests the process, too]" if entry.get("tests") == BOTH else ""
            slow = " [slow reference]" if entry.get("reference") else ""
            limit = f" [at most {most} sensor{'s' * (most != '1')} at once]" if (most := entry.get("at_once")) else ""
            print(f"  {entry['name']:<{width}}  {entry['about']}{also}{limit}{slow}{origin}".rstrip())
    return 0


def entries(kind: str) -> list[dict[str, str]]:
    """Name and description of all of a kind; of plants and detectors their package, of detectors what they test, how
    many sensors they isolate at once at most ("": as many as the plant allows) and whether they are a slow reference ("yes"
    or ""), of faults how each is used.
    """
    match kind:
        case "plants":
            return [{"name": e.name, "about": e.about, "package": e.package} for e in registry.plants().values()]
        case "detectors":
            return [
                {
                    "name": e.name,
                    "about": e.about,
                    "package": e.package,
                    "tests": BOTH if e.tests_process else "sensors",
                    "at_once": "" if e.most_faults is None else str(e.most_faults),
                    "reference": "yes" if e.reference else "",
                }
                for e in registry.detectors().values()
            ]
        case "faults":
            from fusion_sfdia.diagnosis.fault_draws import PRESETS
            from fusion_sfdia.diagnosis.faults import FAULT_KINDS

            drawn = [{"name": name, "about": preset.description, "use": DRAWN} for name, preset in PRESETS.items()]
            return drawn + [{"name": name, "about": about, "use": LISTED} for name, about in FAULT_KINDS.items()]
        case _:
            return [{"name": name, "about": scenarios.scenario(name).title} for name in scenarios.SCENARIOS]
