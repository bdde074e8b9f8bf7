"""The scenarios by name: a scenario is a file in a folder of benchmarks/, and its path is its name.

Listing them imports none of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase
from importlib import resources
from typing import TYPE_CHECKING

from fusion_sfdia.common.references import load
from fusion_sfdia.detectors.registry import require_known

if TYPE_CHECKING:
    from fusion_sfdia.study.experiments.scenario import Scenario

GROUPS = ("pipeline", "engine", "network", "chemical")  # folders of benchmarks/ whose files are scenarios


def _scenarios() -> dict[str, str]:
    """{name: "module:attribute"} of all scenarios."""
    found = {}
    for group in GROUPS:
        for file in sorted(resources.files(f"fusion_sfdia.benchmarks.{group}").iterdir(), key=lambda f: f.name):
            stem, dot, _ = file.name.rpartition(".py")
            if dot and stem != "__init__":
                found[f"{group}/{stem.replace('_', '-')}"] = f"fusion_sfdia.benchmarks.{group}.{stem}:SCENARIO"
    of_all_plants = {
        "comparison": "study.comparison.compare",
        "robustness": "study.robustness",
        "acceptance": "study.acceptance",
    }
    return found | {name: f"fusion_sfdia.{module}:SCENARIO" for name, module in of_all_plants.items()}


SCENARIOS = _scenarios()


def match_scenarios(patterns: Iterable[str]) -> list[str]:
    """Return the scenarios whose names match names or globs such as pipeline/*, each once, in the order of SCENARIOS."""
    expected: set[str] = set()
    for pattern in patterns:
        found = [name for name in SCENARIOS if fnmatchcase(name, pattern)]
        expected.update(found or [require_known("scenario", pattern, SCENARIOS)])
    return [name for name in SCENARIOS if name in expected]


def scenario(name: str) -> Scenario:
    """Return a scenario by its name; ValueError for an unknown one."""
    found: Scenario = load(SCENARIOS[require_known("scenario", name, SCENARIOS)])
    return found
