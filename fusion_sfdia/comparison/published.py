"""The papers' own sensor faults in a comparison, and what the papers say of theirs.

Sizes are as published; onset and length are those of all faults of a comparison. Where Shaheen 2024 draws sensor, size and sign
at random, size and sign are drawn here and sensors take turns; the offsets of K24 and K22 are of one sensor each. Boem 2018
has no sensor fault: its scenarios are faults of the plant, see comparison_truths.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.random_streams import stream
from fusion_sfdia.evaluation.fault_draws import PRESETS, draw_faults
from fusion_sfdia.evaluation.faults import Fault
from fusion_sfdia.evaluation.results import Published
from fusion_sfdia.models.gas_pipeline import published as pipeline_published
from fusion_sfdia.models.marine_engine.published import THREE_FAULTS, Offset
from fusion_sfdia.models.power_network.published import GOVERNOR

PIPELINE, ENGINE, NETWORK = "gas-pipeline", "marine-engine", "power-network"


class PaperFault(NamedTuple):
    """A sensor fault of a paper: make(plant, sensor, seed, onset, length in s); sensor: the one it is of, None for any."""

    name: str
    about: str
    make: Callable[[Plant, str, int, float, float], Fault]
    sensor: str | None = None


def _drawn(preset: str, plant: Plant, sensor: str, seed: int, onset: float, length: float) -> Fault:
    (fault,) = draw_faults(preset, plant, stream(seed, "faults"), window=(onset, onset))
    return replace(fault, sensor=sensor, length=length, rise=length / 2 if fault.kind == "drift" else None)


def _offset(offset: Offset, plant: Plant, sensor: str, seed: int, onset: float, length: float) -> Fault:
    return Fault(sensor, "bias", onset, length, offset.magnitude)


# name, module, unit of the offset, where it is found; in the order of THREE_FAULTS
_ENGINE = (
    ("torque-offset", "M(2,3)", "N m", "K24, Fig. 4"),
    ("receiver-pressure-offset", "M(3,1)", "Pa", "K24, Fig. 4; K22, Fig. 3"),
    ("charge-temperature-offset", "M(4,2)", "K", "K24, Fig. 4; K22, Fig. 3"),
)

PAPER_FAULTS: Mapping[str, tuple[PaperFault, ...]] = {
    PIPELINE: tuple(PaperFault(name, PRESETS[name].description, partial(_drawn, name)) for name in pipeline_published.FAULTS),
    ENGINE: tuple(
        PaperFault(name, f"an offset of {offset.magnitude:g} {unit} ({sources})", partial(_offset, offset), offset.sensor)
        for (name, _, unit, sources), offset in zip(_ENGINE, THREE_FAULTS.faults, strict=True)
    ),
}


class PublishedDelay(NamedTuple):
    """A delay as a paper takes it: until which alarm (see comparison_records), in words, and the number (s)."""

    until: str
    what: str
    value: Published


def published_accuracy(plant: str, detector: str, fault: str, quantity: str) -> Published | None:
    """Share of a quantity's faults that are judged right."""
    if plant != PIPELINE or fault not in pipeline_published.FAULTS:
        return None
    return pipeline_published.accuracy("moderate", detector, quantity, fault)


def published_delay(plant: str, detector: str, fault: str) -> PublishedDelay | None:
    """Delay of the detection by the paper's school in the one run that the paper tells of."""
    if plant == ENGINE and detector.startswith("adaptive-threshold"):
        for (name, module, _, _), offset in zip(_ENGINE, THREE_FAULTS.faults, strict=True):
            if fault == name and (fired := THREE_FAULTS.first_alarm(module)) is not None:
                return PublishedDelay("own", f"first alarm of {module}", Published(fired.value - offset.onset, fired.source))
    if plant == NETWORK and detector.startswith("chebyshev:") and fault == "governor":
        if (delay := GOVERNOR.delay(GOVERNOR.detected)) is not None:
            return PublishedDelay("confirmed", "third alarm in a row", delay)
    return None
