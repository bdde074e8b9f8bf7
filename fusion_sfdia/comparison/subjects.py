"""What is compared: plants and detectors of the registry, of files, and objects, each with a digest of its sources.

Work is found again by names and digests, and sent to other processes with what builds the subjects there: a name or a
reference to a file, which are looked up again, or else the object itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from fusion_sfdia import registry
from fusion_sfdia.core.detector import Detector
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.references import load
from fusion_sfdia.evaluation.cases import ComparisonCases, in_operation
from fusion_sfdia.experiments.sources import OURS, object_digest
from fusion_sfdia.registry import NamedDetector, NamedPlant

PlantLike = str | Plant | Callable[[], Plant] | NamedPlant
DetectorLike = str | Callable[[Plant], Detector] | NamedDetector


@dataclass(frozen=True)
class ComparedPlant:
    """A plant by its name in the results; two of the same name and digest are the same. what: see `registry.find_plant`.

    digest: of its sources, "" for one of this package, whose sources are in the name of every part of a run.
    """

    name: str
    digest: str
    what: PlantLike = field(compare=False, repr=False)

    @property
    def about(self) -> str:
        """What it is, in one line; empty where that is not stated."""
        return registry.find_plant(self.what).about


@dataclass(frozen=True)
class ComparedDetector:
    """A detector by its name in the results, as a ComparedPlant. what: see `registry.find_detector`."""

    name: str
    digest: str
    what: DetectorLike = field(compare=False, repr=False)

    @property
    def entry(self) -> NamedDetector:
        """What it is, how it is built and over what it gathers evidence."""
        return registry.find_detector(self.what)


@dataclass(frozen=True)
class Subjects:
    """Plants and detectors by name that are compared beside those of the registry; without arguments none."""

    plants: Mapping[str, ComparedPlant] = field(default_factory=dict)
    detectors: Mapping[str, ComparedDetector] = field(default_factory=dict)

    def plant(self, name: str) -> ComparedPlant:
        """The plant of that name; ValueError for an unknown one."""
        return self.plants[name] if name in self.plants else compared_plant(name)

    def detector(self, name: str) -> ComparedDetector:
        """The detector of that name; ValueError for an unknown one."""
        return self.detectors[name] if name in self.detectors else compared_detector(name)


def compared_plant(what: PlantLike, cases: ComparisonCases | None = None) -> ComparedPlant:
    """A plant that is compared, by its name, a reference or itself; cases: in place of those with which it is registered.

    ValueError as of `registry.find_plant`, and for what cannot be sent to other processes.
    """
    what = _absolute(what)
    entry = registry.find_plant(what)
    if cases is not None:
        entry = what = entry._replace(cases=cases)
    elif _is_ours(entry.source) and isinstance(what, str):
        return ComparedPlant(entry.name, "", what)
    elif not _is_file(what):
        what = entry
    named = [entry.cases] if isinstance(entry.cases, str) else []
    made = (entry.make, None if named else entry.cases)
    return ComparedPlant(_short(entry.name), object_digest(made, _modules([entry.source, *named])), what)


def compared_detector(what: DetectorLike) -> ComparedDetector:
    """A detector that is compared, by its name, a reference or itself; ValueError as of `registry.find_detector`."""
    what = _absolute(what)
    entry = registry.find_detector(what)
    if _is_ours(entry.source) and isinstance(what, str):
        return ComparedDetector(entry.name, "", what)
    if not _is_file(what):
        what = entry
    return ComparedDetector(_short(entry.name), object_digest(entry.build, _modules([entry.source])), what)


@lru_cache(maxsize=8)
def cases_of(plant: ComparedPlant) -> ComparisonCases:
    """What is tried on a plant beside generic faults of its sensors; nothing where it has no cases."""
    cases = registry.find_plant(plant.what).cases
    found = load(cases) if isinstance(cases, str) else cases
    if found is None:
        return ComparisonCases()
    if not isinstance(found, ComparisonCases):
        raise ValueError(f"cases of plant {plant.name} are of type {type(found).__name__}; expected ComparisonCases")
    return found


@lru_cache(maxsize=8)
def plant_of(plant: ComparedPlant) -> Plant:
    """The plant in the usual operation of the comparison: what learns from healthy runs learns from that."""
    return in_operation(registry.plant(plant.what), cases_of(plant).operation)


def _is_file(what: Any) -> bool:
    return isinstance(what, str) and what.rpartition(":")[0].endswith(".py")


def _absolute(what: Any) -> Any:
    """A reference to a file as one that holds in every folder."""
    if not _is_file(what):
        return what
    path, _, attribute = what.rpartition(":")
    return f"{Path(path).resolve()}:{attribute}"


def _short(name: str) -> str:
    """The name in the results: of a reference to a file without its folder."""
    return name.rpartition("/")[2] if _is_file(name) else name


def _is_ours(source: str) -> bool:
    return source.partition(":")[0].partition(".")[0] == OURS


def _modules(sources: Iterable[str]) -> list[str]:
    """Modules of "module:name" texts; a file's stands among the loaded modules under its own name."""
    return [source.rpartition(":")[0] for source in sources if source and not _is_file(source)]
