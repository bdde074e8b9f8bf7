"""What a log of a healthy plant shows of its model: whether predictions err as stated, and false alarms."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.diagnose import SECONDS
from fusion_sfdia.diagnosis.prepared import prepared
from fusion_sfdia.learning.innovations import WhitenessTest, whiteness
from fusion_sfdia.learning.inspection.plant_findings import REMARK, PlantFinding
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.plant.augment import fixed
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

LOWER, UPPER = 0.7, 1.4  # between which the errors of predictions may be of those stated
LASTING = 0.3  # autocorrelation of them, above 5 standard errors, which a right model does not have


class OnHealthy(NamedTuple):
    """The innovations of a Kalman filter on the log, and the events of a detector in it."""

    samples: int
    white: WhitenessTest
    detector: str
    events: tuple[str, ...]


def on_healthy(plant: Plant, log: Log, detector: registry.NamedDetector) -> OnHealthy:
    """Examine a healthy log of one run, with the disturbances that the plant states; ValueError where it is too short."""
    plant = fixed(plant)
    build = partial(registry.detector, detector)
    found, _ = prepared(build(plant), LoadedLog(log, SECONDS, ()), build).diagnose()
    return OnHealthy(len(log.t), whiteness(plant, log), detector.name, tuple(map(str, found.events)))


def of_healthy(plant: Plant, found: OnHealthy) -> Iterator[PlantFinding]:
    """What to know about the model on that log."""
    white = found.white
    for s, variance, rho, pairs in zip(plant.sensors, white.variance, white.autocorrelation, white.pairs, strict=True):
        ratio = float(np.sqrt(variance))
        if ratio > UPPER or ratio < LOWER:
            yield PlantFinding(
                REMARK,
                s.name,
                f"the healthy readings differ from their predictions by {ratio:.2g} times what the plant states, "
                + ("so that false alarms follow: " if ratio > 1 else "so that faults are found late: ")
                + "correct its sigma or the process noise (`commission`)",
            )
        if np.isfinite(rho) and rho > LASTING and rho > 5 / np.sqrt(pairs):
            yield PlantFinding(
                REMARK,
                s.name,
                f"predictions err in one direction for several samples (autocorrelation {rho:.2f}): the model is off; state "
                "its `uncertainty` and use robust-glr, or fit it (`commission`)",
            )
    if found.events:
        some = "; ".join(found.events[:3]) + (f" and {len(found.events) - 3} more" if len(found.events) > 3 else "")
        yield PlantFinding(
            REMARK, found.detector, f"{len(found.events)} events in the healthy log: {some}; check the log, then fit thresholds"
        )
