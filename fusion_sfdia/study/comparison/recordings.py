"""Readings of a comparison: what a plant's sensors read under a truth that no detector knows, as recordings.

The truth is the high-fidelity model of a plant where it has one, in closed loop where it has controllers, which read healthy
sensors. A plant that states so (`disturbed`, as the power network of its paper) is disturbed by its process noise, others are
not: the pipeline's belongs to 21 nodes, and on the finer grid of the truth it is another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.study.cases import MismatchCase, ProcessFaultCase, case_readings
from fusion_sfdia.study.comparison.subjects import ComparedPlant, plant_of

Array = NDArray[Any]

DISTANCE_STEPS = 400
SAME = 1e-6  # sigma: less is the same model


@lru_cache(maxsize=4)
def healthy(plant: ComparedPlant, steps: int, seeds: tuple[int, ...]) -> Recording:
    """Healthy readings in the usual operation, the same for all detectors."""
    return case_readings(plant_of(plant), steps, seeds)


def mismatched(plant: ComparedPlant, case: MismatchCase, steps: int, seeds: Sequence[int], start: float) -> Recording:
    """Healthy readings of a mismatch case, which are judged from `start` (s) on."""
    truth = None if case.truth is None else case.truth()
    inputs = None if case.inputs is None else partial(_from_start, case.inputs, start)
    return case_readings(plant_of(plant), steps, seeds, truth=truth, inputs=inputs)


def _from_start(inputs: Callable[[float, float], Array], start: float, t: float) -> Array:
    return inputs(t, start)


def failing(plant: ComparedPlant, fault: ProcessFaultCase, steps: int, seeds: Sequence[int], onset: float) -> Recording:
    """Readings of a plant with a process fault from the onset (s) on; ValueError for a case without a fault."""
    if (fault.truth is None) == (fault.lost is None):
        raise ValueError(f"process fault {fault.name!r} of {plant.name}: expected either a truth or what is lost of the inputs")
    if fault.truth is not None:
        return case_readings(plant_of(plant), steps, seeds, truth=fault.truth(onset))
    assert fault.lost is not None
    return case_readings(plant_of(plant), steps, seeds, lost=(onset, fault.lost))


@lru_cache(maxsize=8)
def distance_of_truth(plant: ComparedPlant) -> float:
    """Largest difference of noise-free readings of the usual truth from those of the model, in the sensors' sigma.

    Over DISTANCE_STEPS samples of the usual operation, without process noise, controllers reading the same noise.
    """
    of = plant_of(plant)
    run = partial(simulate, of, DISTANCE_STEPS, (0,))
    finest, to_states = (of, None) if of.truth.finer is None else of.truth.finer()
    alone = replace(of, truth=replace(of.truth, finer=None))
    signals = [
        run(truth=replace(truth, sensors=of.sensors), to_states=mapped).signal
        for truth, mapped in ((finest, to_states), (alone, None))
    ]
    return float(np.max(np.abs(signals[0] - signals[1]) / of.sensor_sigma))


def stated_distance(plant: ComparedPlant) -> str:
    """How far the usual truth of a plant is from the detectors' model, in words."""
    distance = distance_of_truth(plant)
    return "nothing in this operation" if distance < SAME else f"{distance:.2g} sigma"
