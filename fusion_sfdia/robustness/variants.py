"""Variants of a detector: what it knows of the plant.

    detector                            the plant as it is
    detector on augmented               augment(plant): what the plant states as uncertain is estimated
    detector commissioned               commission(plant, log); a detector that learns from data is fitted to the log
    detector augmented, commissioned    augment(commission(plant, log))
    detector from a log alone           commission(plant without its uncertainty, log), judged in an operation not in the log

`log` is a healthy log of the real plant in the usual operation, so under a mismatch case of that case's plant.
"""

from __future__ import annotations

from typing import NamedTuple

from fusion_sfdia import registry
from fusion_sfdia.registry import require_known

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


class Variant(NamedTuple):
    """A detector by its registered name, and what it knows of the plant, one of KNOWLEDGE."""

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


def variants(detectors: tuple[str, ...], knowledge: tuple[str, ...]) -> list[Variant]:
    """Every detector with everything it may know of the plant; ValueError for an unknown one."""
    for kind in knowledge:
        require_known("knowledge", kind, KNOWLEDGE)
    for name in detectors:
        require_known("detector", name, registry.detectors())
    return [Variant(name, kind) for name in detectors for kind in knowledge]
