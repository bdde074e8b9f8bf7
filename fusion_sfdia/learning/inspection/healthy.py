"""What a log of a healthy plant shows of its model: whether predictions err as stated, false alarms, and which readings depend
on an input directly, so that they show at once whether its values are stated in the right row.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
Array = NDArray[Any]

SEEN = 3.0  # sigma: a smaller jump of a reading is not told from noise


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
                + "correct its sigma or the process noise (`Commissioning.of`)",
            )
        if np.isfinite(rho) and rho > LASTING and rho > 5 / np.sqrt(pairs):
            yield PlantFinding(
                REMARK,
                s.name,
                f"predictions err in one direction for several samples (autocorrelation {rho:.2f}): the model is off; state "
                "its `uncertainty` and use robust-glr, or fit it (`Commissioning.of`)",
            )
    if found.events:
        some = "; ".join(found.events[:3]) + (f" and {len(found.events) - 3} more" if len(found.events) > 3 else "")
        yield PlantFinding(
            REMARK, found.detector, f"{len(found.events)} events in the healthy log: {some}; check the log, then fit thresholds"
        )


class Feedthrough(NamedTuple):
    """jump (m, N): change of each reading, in its sigma, by the largest step of each input between rows of a log."""

    jump: Array


def feedthrough(plant: Plant, log: Log) -> Feedthrough:
    """The change of y = h(t, x, u) at x0 by u alone, for the largest step of each input in a log of one run."""
    jump = np.zeros((len(plant.inputs), len(plant.sensors)))
    for i in range(len(plant.inputs) if len(log.t) > 1 else 0):
        k = int(np.argmax(np.abs(np.diff(log.u[:, i]))))
        before, after = log.u[k].copy(), log.u[k].copy()
        after[i] = log.u[k + 1, i]
        t = float(log.t[k])
        with np.errstate(all="ignore"):
            change = plant.output(t, plant.x0, after) - plant.output(t, plant.x0, before)
        jump[i] = np.nan_to_num(np.abs(change)) / plant.sensor_sigma
    return Feedthrough(jump)


def of_feedthrough(plant: Plant, found: Feedthrough) -> Iterator[PlantFinding]:
    """The inputs whose convention matters, and the sensors that show it."""
    for signal, jump in zip(plant.inputs, found.jump, strict=True):
        if names := [f"{n} ({size:.2g} sigma)" for n, size in zip(plant.sensor_names, jump, strict=True) if size > SEEN]:
            yield PlantFinding(
                REMARK,
                signal.name,
                f"its largest step in the log moves {', '.join(names)} at once, as the output depends on u: were it stated a "
                'row too late or too early, each step would be a spike; make sure of `inputs` in the map ("at the sample" or '
                '"until the sample")',
            )
