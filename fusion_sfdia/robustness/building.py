"""How the detector of a variant is built: on the plant, or on what a healthy log of the real plant makes of it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

from fusion_sfdia import registry
from fusion_sfdia.commissioning.commission import commission
from fusion_sfdia.comparison.subjects import ComparedDetector, ComparedPlant, plant_of
from fusion_sfdia.core.augment import augment
from fusion_sfdia.core.detector import NotApplicableError
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.uncertainty import Uncertainty
from fusion_sfdia.registry import NamedDetector, require_known
from fusion_sfdia.robustness.material import healthy_log
from fusion_sfdia.robustness.variants import ALONE, AUGMENTED, BOTH, Variant

FITTED_RATE = 5e-3  # false alarms a step that a log is long enough to set; thresholds are scaled afterwards
AUGMENTS_ITSELF = ("robust-glr",)


class RefusedLogError(ValueError):
    """A healthy log that `commission` refuses."""


def build(of: ComparedPlant, variant: Variant, mismatch: str = "") -> Any:
    """The detector of a variant in the world of a mismatch case, "" for the right model.

    NotApplicableError for a variant that would be the same as another; RefusedLogError for a log that `commission` or the
    detector's fit refuses.
    """
    entry = registry.detectors()[require_known("detector", variant.detector, registry.detectors())]
    if entry.learns:
        return _fitted(of, variant, entry, mismatch)
    if variant.knowledge in (AUGMENTED, BOTH) and variant.detector in AUGMENTS_ITSELF:
        raise NotApplicableError(f"{variant.detector} augments the plant itself: the same as without")
    plant = known(of, mismatch, variant.knowledge == ALONE) if variant.needs_log else plant_of(of)
    if isinstance(plant, str):
        raise RefusedLogError(plant)
    if variant.knowledge == AUGMENTED and not plant.uncertainty.stated:
        raise NotApplicableError(f"plant {plant.name!r} states no uncertainty: the same as without")
    if variant.knowledge in (AUGMENTED, BOTH, ALONE) and variant.detector not in AUGMENTS_ITSELF:
        plant = augment(plant)
    return registry.detector(variant.detector, plant)


@lru_cache(maxsize=64)
def known(of: ComparedPlant, mismatch: str, alone: bool) -> Plant | str:
    """The plant after commissioning on a healthy log, or why the log is refused.

    alone: without what the plant states as uncertain.
    """
    plant = plant_of(of)
    try:
        return commission(replace(plant, uncertainty=Uncertainty()) if alone else plant, healthy_log(of, mismatch))
    except ValueError as problem:
        return str(problem)


def _fitted(of: ComparedPlant, variant: Variant, entry: NamedDetector, mismatch: str) -> Any:
    if variant.knowledge in (AUGMENTED, BOTH):
        raise NotApplicableError(f"{variant.detector} learns from readings and has no model: the same as without")
    if not variant.needs_log:
        return entry.build(plant_of(of))
    try:
        return entry.build(plant_of(of), healthy=healthy_log(of, mismatch), false_alarm=FITTED_RATE)
    except NotApplicableError:
        raise
    except ValueError as problem:
        raise RefusedLogError(str(problem)) from problem


def as_compared(of: ComparedPlant, variant: Variant) -> ComparedDetector:
    """The variant on the right model, as the comparison takes a detector."""
    entry = NamedDetector(variant.name, "", partial(_build, of, variant))
    return ComparedDetector(variant.name, f"{of.name} {of.digest}", entry)


def _build(of: ComparedPlant, variant: Variant, plant: Plant) -> Any:
    return build(of, variant)  # of whose plant this is
