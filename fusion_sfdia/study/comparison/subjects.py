"""What is compared: plants and detectors of the registry, of files, and objects, each with a digest of its sources.

Work is found again by names and digests, and sent to other processes with the entry of the registry that builds its subjects.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from fusion_sfdia.common.references import call, load
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.registry import NamedDetector, NamedPlant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.cases import ComparisonCases, in_operation
from fusion_sfdia.study.experiments.sources import content_digest, object_digest

PlantLike = str | Plant | Callable[[], Plant] | NamedPlant
DetectorLike = str | Callable[[Plant], Detector] | NamedDetector


@dataclass(frozen=True)
class ComparedPlant:
    """A plant by its name in the results; two of the same name and digest are the same.

    entry: what makes it. note: what its user should know, "" for nothing.
    """

    name: str
    digest: str
    entry: NamedPlant = field(compare=False, repr=False)
    note: str = field(default="", compare=False, repr=False)

    @property
    def slug(self) -> str:
        """Its name as a part of names of figures and chapters."""
        return re.sub(r"[^a-z0-9]+", "-", self.name.lower()).strip("-")


@dataclass(frozen=True)
class ComparedDetector:
    """A detector by its name in the results, as a ComparedPlant. entry: what it is, and what builds it."""

    name: str
    digest: str
    entry: NamedDetector = field(compare=False, repr=False)


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

    One that holds the same as the registered plant of its name has the cases of that one. The digest of a plant that is none
    of this package includes what the built plant holds: numbers that its function reads from a file count, too. ValueError as
    of `registry.find_plant`, for a plant that cannot be built, and for what cannot be sent to other processes.
    """
    entry, content, note = _recognised(what, registry.find_plant(what))
    entry = entry if cases is None else entry._replace(cases=cases)
    lazy = [entry.cases] if isinstance(entry.cases, str) else []
    digest = object_digest((entry.make, entry.cases, content), _modules(entry.source, *lazy))
    if _is_file(what):  # its module is none that another process could import
        entry = entry._replace(make=partial(call, _absolute(what), ""))
    return ComparedPlant(_short(entry.name), digest, entry, note if cases is None else "")


def _recognised(what: PlantLike, entry: NamedPlant) -> tuple[NamedPlant, str, str]:
    """The entry of a plant, with the cases of the registered plant that it equals; a digest of what it holds, and a note."""
    known = registry.plants()
    if entry in known.values() or isinstance(what, NamedPlant):
        return entry, "" if entry.package == registry.OURS else _content_of(entry), ""
    plant = _built(entry)
    content, same = content_digest(plant), known.get(plant.name)
    if same is not None and content == _content_of(same):
        return (entry._replace(cases=same.cases), content, "") if isinstance(what, str) else (same, "", "")
    if isinstance(what, str):
        return entry, content, ""
    differs = (
        f"plant {plant.name!r} has the name of a registered plant, but differs from it: it is compared without the mismatch "
        f"cases and process faults of that one; give it a name of its own, or pass cases={{{plant.name!r}: ...}}"
    )
    return entry._replace(name=plant.name), content, "" if same is None else differs


def _content_of(entry: NamedPlant) -> str:
    """A digest of what a registered plant holds; "" for one that cannot be built, which its work reports."""
    try:
        return content_digest(_built(entry))
    except ValueError:
        return ""


def _built(entry: NamedPlant) -> Plant:
    """The plant of an entry; ValueError where its function fails."""
    try:
        return registry.plant(entry)
    except Exception as error:
        raise ValueError(
            f"plant {entry.name} cannot be built: {type(error).__name__}: {error}; correct its function"
        ) from error


def compared_detector(what: DetectorLike) -> ComparedDetector:
    """A detector that is compared, by its name, a reference or itself.

    ValueError as of `registry.find_detector`, and for a built detector: each plant needs one of its own.
    """
    built: Any = what
    if isinstance(built, Detector) and not isinstance(built, type):
        name = type(built).__name__
        raise ValueError(
            f"detector {name} is already built for plant {built.plant.name!r}; expected what builds it for each plant: pass "
            f"the class, {name}, or lambda plant: {name}(plant, ...) with its settings"
        )
    entry = registry.find_detector(what)
    digest = object_digest(entry.build, _modules(entry.source))
    if _is_file(what):
        entry = entry._replace(build=partial(call, _absolute(what), ""))
    return ComparedDetector(_short(entry.name), digest, entry)


@lru_cache(maxsize=8)
def cases_of(plant: ComparedPlant) -> ComparisonCases:
    """What is tried on a plant beside generic faults of its sensors; nothing where it has no cases."""
    cases = plant.entry.cases
    found = load(cases) if isinstance(cases, str) else cases
    if found is None:
        return ComparisonCases()
    if not isinstance(found, ComparisonCases):
        raise ValueError(f"cases of plant {plant.name} are of type {type(found).__name__}; expected ComparisonCases")
    return found


@lru_cache(maxsize=8)
def plant_of(plant: ComparedPlant) -> Plant:
    """The plant in the usual operation of the comparison: what learns from healthy runs learns from that."""
    return in_operation(registry.plant(plant.entry), cases_of(plant).operation)


def _is_file(what: Any) -> bool:
    return isinstance(what, str) and what.rpartition(":")[0].endswith(".py")


def _absolute(reference: Any) -> str:
    """A reference to a file as one that holds in every folder."""
    path, _, attribute = str(reference).rpartition(":")
    return f"{Path(path).resolve()}:{attribute}"


def _short(name: str) -> str:
    """The name in the results: of a reference to a file without its folder."""
    return name.rpartition("/")[2] if _is_file(name) else name


def _modules(*sources: str) -> list[str]:
    """Modules of "module:name" texts; that of a file is found by what it defines."""
    return [source.rpartition(":")[0] for source in sources if source and not _is_file(source)]
