"""What the scenarios on the recordings share: a task a detector, the two meanings of sigma, shares of one recording."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.chemical.support.recordings import MEASUREMENTS, digest, recording
from fusion_sfdia.common.run_statistics import NOTHING, Estimate
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.experiments.scenario import Settings, Task

Array = NDArray[Any]

SIGMAS = ("reading", "noise")


def require_measurements(settings: Settings) -> None:
    """Raise ValueError for a number that no measurement has."""
    if unknown := [n for n in settings["measurements"] if n > len(MEASUREMENTS)]:
        raise ValueError(f"setting measurements has {unknown[0]}; expected numbers from 1 to {len(MEASUREMENTS)}, of XMEAS")


def task_for_each(settings: Settings, detectors: Iterable[str]) -> list[Task]:
    """One task a detector: there is one recording of each case, and nothing is random."""
    common = {name: list(v) if isinstance(v, tuple) else v for name, v in settings.items()}
    files = digest(settings["data"])
    return [common | {"detector": name, "files": files} for name in detectors]


def sigmas(folder: str, plant: Plant) -> dict[str, Array]:
    """Two meanings of sigma (41,): of the reading about its mean in d00, and of the noise that the plant states."""
    return {"reading": np.nanstd(recording(folder, "d00").y, axis=0), "noise": plant.sensor_sigma}


def once(share: float, samples: int) -> Estimate:
    """A share of the samples of one recording, which has no interval."""
    return NOTHING._replace(value=float(share), n=int(samples > 0))
