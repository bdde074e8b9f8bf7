"""The papers' own sensor faults in a comparison, and what the papers say of theirs.

Sizes are as published; onset and length are those of all faults of a comparison. Where Shaheen 2024 draws sensor, size and sign
at random, size and sign are drawn here and sensors take turns; the offsets of K24 and K22 are of one sensor each. Boem 2018
has no sensor fault: its two scenarios are faults of the plant, see comparison_truths.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from fusion_sfdia.benchmarks import pipeline_published
from fusion_sfdia.benchmarks.engine_published import THREE_FAULTS, Offset
from fusion_sfdia.benchmarks.network_published import GOVERNOR, SIGN_FLIP
from fusion_sfdia.benchmarks.results import Published
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.random_streams import stream
from fusion_sfdia.evaluation.fault_draws import PRESETS, draw
from fusion_sfdia.evaluation.faults import Fault

PIPELINE, ENGINE, NETWORK = "gas-pipeline", "marine-engine", "power-network"


class PaperFault(NamedTuple):
    """A sensor fault of a paper: make(plant, sensor, seed, onset, length in s); sensor: the one it is of, None for any."""

    name: str
    about: str
    make: Callable[[Plant, str, int, float, float], Fault]
    sensor: str | None = None


def _drawn(preset: str, plant: Plant, sensor: str, seed: int, onset: float, length: float) -> Fault:
    (fault,) = draw(preset, plant, stream(seed, "faults"), window=(onset, onset))
    return replace(fault, sensor=sensor, length=length, rise=length / 2 if fault.kind == "drift" else None)


def _offset(offset: Offset, plant: Plant, sensor: str, seed: int, onset: float, length: float) -> Fault:
    return Fault(sensor, "bias", onset, length, offset.magnitude)


PAPER_FAULTS: Mapping[str, tuple[PaperFault, ...]] = {
    PIPELINE: tuple(PaperFault(name, PRESETS[name].description, partial(_drawn, name)) for name in pipeline_published.FAULTS),
    ENGINE: tuple(
        PaperFault(name, f"an offset of {offset.magnitude:g} {unit} ({sources})", partial(_offset, offset), offset.sensor)
        for name, unit, sources, offset in zip(
            ("torque-offset", "receiver-pressure-offset", "charge-temperature-offset"),
            ("N m", "Pa", "K"),
            ("K24, Fig. 4", "K24, Fig. 4; K22, Fig. 3", "K24, Fig. 4; K22, Fig. 3"),
            THREE_FAULTS.faults,
            strict=True,
        )
    ),
}

_NETWORK_DELAYS = {"governor": GOVERNOR, "input-gain": SIGN_FLIP}
_OF_SCHOOL = {PIPELINE: "fusing-", ENGINE: "adaptive-threshold", NETWORK: "chebyshev:"}


def published_accuracy(plant: str, detector: str, fault: str, quantity: str) -> Published | None:
    """Share of a quantity's faults that are judged right."""
    if plant != PIPELINE or fault not in pipeline_published.FAULTS:
        return None
    return pipeline_published.accuracy("moderate", detector, quantity, fault)


def published_delay(plant: str, detector: str, fault: str) -> Published | None:
    """Delay of the detection (s) of the paper's school in the one run that the paper tells of."""
    if not detector.startswith(_OF_SCHOOL.get(plant, "none")):
        return None
    if plant == ENGINE:
        for known, offset in zip(PAPER_FAULTS[ENGINE], THREE_FAULTS.faults, strict=True):
            if fault == known.name:
                fired = THREE_FAULTS.first_alarm(offset.sensor.replace("S(", "M(").replace("){", ",").replace("}", ")"))
                return None if fired is None else Published(fired.value - offset.onset, f"{fired.source}, its own module")
    if plant == NETWORK and fault in _NETWORK_DELAYS:
        told = _NETWORK_DELAYS[fault]
        delay = told.delay(told.detected)
        return None if delay is None else Published(delay.value, f"{delay.source}, confirmed by 3 alarms in a row")
    return None
