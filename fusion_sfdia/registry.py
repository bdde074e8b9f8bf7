"""What can be named on the command line: scenarios, plants, detectors and faults. Nothing heavy is imported to list names."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from difflib import get_close_matches
from fnmatch import fnmatchcase
from importlib import import_module, resources
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fusion_sfdia.core.detector import Detector
    from fusion_sfdia.core.plant import Plant
    from fusion_sfdia.experiments.scenario import Scenario

GROUPS = ("pipeline", "engine", "network")  # folders of benchmarks/ whose files are scenarios


def _scenarios() -> dict[str, str]:
    """{name: "module:attribute"}: a scenario is a file of its group's folder, and its path is its name."""
    found = {}
    for group in GROUPS:
        for file in sorted(resources.files(f"fusion_sfdia.benchmarks.{group}").iterdir(), key=lambda f: f.name):
            stem, dot, _ = file.name.rpartition(".py")
            if dot and stem != "__init__":
                found[f"{group}/{stem.replace('_', '-')}"] = f"fusion_sfdia.benchmarks.{group}.{stem}:SCENARIO"
    return found | {"comparison": "fusion_sfdia.comparison.scenario:SCENARIO"}


SCENARIOS = _scenarios()

# name: what it is, and "module:function" that returns the Plant with its usual settings
PLANTS: dict[str, tuple[str, str]] = {
    "gas-pipeline": (
        "150 km of high-pressure natural gas under transient flow, 21 nodes, 63 sensors (Shaheen 2024)",
        "fusion_sfdia.models.gas_pipeline.plant:gas_pipeline",
    ),
    "marine-engine": (
        "four-stroke marine diesel engine with turbocharger in 4 blocks, 10 sensors (Kougiatsos and Reppa 2024)",
        "fusion_sfdia.models.marine_engine.plant:marine_engine",
    ),
    "power-network": (
        "15 generation areas joined by tie lines, 94 sensors, of which 34 read a neighbour's angle (Boem 2018)",
        "fusion_sfdia.models.power_network.plant:power_network",
    ),
    "two-tanks": (
        "two water tanks in series, checkable by hand: 2 levels and 2 flows measured",
        "fusion_sfdia.models.two_tanks.plant:two_tanks",
    ),
}


DRAWN = "at random, with simulate --fault NAME[:QUANTITY]"
LISTED = "kinds, for the [[fault]] tables of simulate --faults FILE.toml"


def require_known(what: str, name: str, known: Iterable[str]) -> str:
    """Return the name; ValueError with the nearest known one where it is unknown."""
    names = list(known)
    if name not in names:
        near = get_close_matches(name, names, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(f"unknown {what} {name!r}; {hint}known: {', '.join(names) or 'none'}")
    return name


def load(reference: str) -> Any:
    """Return what "module:attribute" names."""
    module, attribute = reference.split(":")
    return getattr(import_module(module), attribute)


def match_scenarios(patterns: Iterable[str]) -> list[str]:
    """Return the scenarios whose names match names or globs such as pipeline/*, each once, in the order of the registry."""
    expected: set[str] = set()
    for pattern in patterns:
        found = [name for name in SCENARIOS if fnmatchcase(name, pattern)]
        expected.update(found or [require_known("scenario", pattern, SCENARIOS)])
    return [name for name in SCENARIOS if name in expected]


def scenario(name: str) -> Scenario:
    """Return a scenario by its name; ValueError for an unknown one."""
    found: Scenario = load(SCENARIOS[require_known("scenario", name, SCENARIOS)])
    return found


def plant(name: str) -> Plant:
    """Return a plant with its usual settings by its name; ValueError for an unknown one."""
    factory: Callable[[], Plant] = load(PLANTS[require_known("plant", name, PLANTS)][1])
    return factory()


def detector(name: str, of: Plant) -> Detector:
    """Return a detector with its usual settings on a plant; ValueError for an unknown name."""
    from fusion_sfdia.detectors import DETECTORS

    return DETECTORS[require_known("detector", name, DETECTORS)].build(of)


def fault(text: str) -> tuple[str, str | None]:
    """Return the preset and the quantity (None: any) of "weak-bias:pressure"; ValueError for an unknown preset."""
    from fusion_sfdia.evaluation.fault_draws import PRESETS
    from fusion_sfdia.evaluation.faults import FAULT_KINDS

    name, colon, quantity = text.partition(":")
    if name in FAULT_KINDS:
        raise ValueError(f"fault {text!r} is a kind, to be listed in a file (--faults); to be drawn: {', '.join(PRESETS)}")
    if colon and not quantity:
        raise ValueError(f"fault {text!r} has no quantity after its colon; expected NAME or NAME:QUANTITY")
    return require_known("fault", name, PRESETS), quantity or None


def listing() -> dict[str, list[dict[str, str]]]:
    """Return names and descriptions of everything, by kind: plants, detectors, faults (and how each is used), scenarios."""
    from fusion_sfdia.detectors import DETECTORS
    from fusion_sfdia.evaluation.fault_draws import PRESETS
    from fusion_sfdia.evaluation.faults import FAULT_KINDS

    return {
        "plants": [_entry(name, about) for name, (about, _) in PLANTS.items()],
        "detectors": [_entry(name, entry.about) for name, entry in DETECTORS.items()],
        "faults": [
            *(_entry(name, preset.description, use=DRAWN) for name, preset in PRESETS.items()),
            *(_entry(name, about, use=LISTED) for name, about in FAULT_KINDS.items()),
        ],
        "scenarios": [_entry(name, scenario(name).title) for name in SCENARIOS],
    }


def _entry(name: str, about: str, **more: str) -> dict[str, str]:
    return {"name": name, "about": about, **more}
