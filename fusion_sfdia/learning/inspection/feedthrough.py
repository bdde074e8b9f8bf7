"""Which readings depend on an input directly, and so show at once whether its values are stated in the right row."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.inspection.plant_findings import REMARK, PlantFinding
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

SEEN = 3.0  # sigma: a smaller jump of a reading is not told from noise


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
