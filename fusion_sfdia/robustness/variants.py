"""Variants of a detector: what it is told of the plant.

    detector                        the plant as it is
    detector on augmented           augment(plant): what the plant states as uncertain is estimated
    detector commissioned           commission(plant, log); a detector that learns from data is fitted to the log
    detector augmented, commissioned    augment(commission(plant, log))
    detector from a log alone       commission(plant without its uncertainty, log), judged in an operation that is not in it

`log` is a healthy log of the real plant in the usual operation, so under a mismatch case of that case's plant.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from fusion_sfdia import registry
from fusion_sfdia.core.augment import augment
from fusion_sfdia.core.detector import NotApplicableError
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.uncertainty import Uncertainty
from fusion_sfdia.detectors import FALSE_ALARM
from fusion_sfdia.evaluation.simulate import Recording
from fusion_sfdia.registry import NamedDetector, require_known

AS_IT_IS, AUGMENTED, COMMISSIONED, BOTH, ALONE = KNOWLEDGE = (
    *("plant", "augmented", "commissioned", "augmented-commissioned", "log-alone"),
)
IN_WORDS = {
    AS_IT_IS: "",
    AUGMENTED: " on augmented",
    COMMISSIONED: " commissioned",
    BOTH: " augmented, commissioned",
    ALONE: " from a log alone",
}
TESTS_THE_PROCESS = ("robust-glr",)  # augments the plant itself


class Variant(NamedTuple):
    """A detector by its registered name, and what it is told of the plant, one of KNOWLEDGE."""

    detector: str
    knowledge: str

    @property
    def name(self) -> str:
        """Its name in the results."""
        return self.detector + IN_WORDS[self.knowledge]

    @property
    def needs_log(self) -> bool:
        """Whether it needs a healthy log of the real plant."""
        return self.knowledge in (COMMISSIONED, BOTH, ALONE)

    def build(self, plant: Plant, log: Recording | None) -> Any:
        """The detector of a plant, with a healthy log where it needs one.

        NotApplicableError for a variant that would be the same as another; ValueError for a log that `commission` refuses.
        """
        entry = registry.detectors()[require_known("detector", self.detector, registry.detectors())]
        if self.needs_log and log is None:
            raise ValueError(f"{self.name} needs a healthy log; pass the recording")
        if entry.learns:
            return self._fitted(entry, plant, log)
        if self.knowledge in (AUGMENTED, BOTH) and self.detector in TESTS_THE_PROCESS:
            raise NotApplicableError(f"{self.detector} augments the plant itself: the same as without")
        known = replace(plant, uncertainty=Uncertainty()) if self.knowledge == ALONE else plant
        if self.needs_log:
            try:
                from fusion_sfdia.commissioning.commission import commission
            except ModuleNotFoundError as problem:
                raise NotApplicableError("commissioning has not landed") from problem
            known = commission(known, log)
        if self.knowledge in (AUGMENTED, BOTH, ALONE) and self.detector not in TESTS_THE_PROCESS:
            if self.knowledge == AUGMENTED and not known.uncertainty.stated:
                raise NotApplicableError(f"plant {plant.name!r} states no uncertainty: the same as without")
            known = augment(known)
        return registry.detector(self.detector, known)

    def _fitted(self, entry: NamedDetector, plant: Plant, log: Recording | None) -> Any:
        if self.knowledge in (AUGMENTED, BOTH):
            raise NotApplicableError(f"{self.detector} learns from readings and has no model: the same as without")
        return entry.build(plant) if log is None else entry.build(plant, healthy=log, false_alarm=FALSE_ALARM)

    def built_on(self, log: Recording | None) -> NamedDetector:
        """An entry of the registry that builds it with that log."""
        return NamedDetector(self.name, "", partial(_build, self, log))


def _build(variant: Variant, log: Recording | None, plant: Plant) -> Any:
    return variant.build(plant, log)


def variants(detectors: tuple[str, ...], knowledge: tuple[str, ...]) -> list[Variant]:
    """Every detector with everything it may know of the plant; ValueError for an unknown one."""
    for kind in knowledge:
        require_known("knowledge", kind, KNOWLEDGE)
    for name in detectors:
        require_known("detector", name, registry.detectors())
    return [Variant(name, kind) for name in detectors for kind in knowledge]
