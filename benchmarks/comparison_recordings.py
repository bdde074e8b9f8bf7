"""Readings of a comparison: what a plant shows from a truth that no detector knows, as recordings.

The truth is the finer twin of a plant where it has one, in closed loop where it has controllers, which read healthy sensors.
The power network is disturbed by its process noise, as its paper says; the others are not: the pipeline's belongs to 21 nodes,
and on the finer grid of the truth it is another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks import registry
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.simulate import Recording, simulate

Array = NDArray[Any]


@cache
def plant_of(name: str) -> Plant:
    """A registered plant."""
    return registry.plant(name)


@lru_cache(maxsize=4)
def healthy(plant: str, steps: int, seeds: tuple[int, ...]) -> Recording:
    """Healthy readings in the usual operation, the same for all detectors."""
    return simulated(plant, steps, seeds)


def simulated(
    plant: str,
    steps: int,
    seeds: Sequence[int],
    *,
    truth: Plant | None = None,
    inputs: Callable[[float], Array] | None = None,
    lost: tuple[float, tuple[float, ...]] | None = None,
) -> Recording:
    """Readings from the finer twin of a truth (None: of the plant) under inputs (None: the truth's operation).

    lost: from a time (s) on other inputs act than those that are known, the known ones times these factors.
    """
    of = plant_of(plant)
    model = of if truth is None else truth
    if lost is not None and model.feedback is not None:
        raise ValueError(f"plant {model.name!r} has controllers, which would see what is lost; give it a fault of its own")
    finest, to_states = (model, None) if model.finer is None else model.finer()
    finest = replace(finest, sensors=of.sensors)  # whose noise may be a share of what they usually show
    run = partial(simulate, of, steps, seeds, truth=finest, to_states=to_states, process_noise=of.disturbed)
    if lost is None:
        return run(inputs=inputs)
    t = np.arange(steps) * of.dt
    known = np.array([model.input_at(float(s)) for s in t])
    acting = np.where((t >= lost[0] - 1e-6 * of.dt)[:, None], known * np.asarray(lost[1]), known)
    return replace(run(inputs=acting), u=known)


def beginning(recording: Recording, steps: int) -> Recording:
    """The first samples of a recording."""
    names = ("t", "u", "y", "signal", "x")
    return replace(recording, **{n: a[:steps] for n in names if (a := getattr(recording, n)) is not None})
