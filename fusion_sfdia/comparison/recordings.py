"""Readings of a comparison: what a plant shows from a truth that no detector knows, as recordings.

The truth is the high-fidelity model of a plant where it has one, in closed loop where it has controllers, which read healthy
sensors. The power network is disturbed by its process noise, as its paper says; the others are not: the pipeline's belongs to
21 nodes, and on the finer grid of the truth it is another. What the papers operate ends after 80 s (loads of the network) and
2700 s (demand of the pipeline); here it comes again, so that faults meet every phase of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia import registry
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.simulate import Recording, simulate
from fusion_sfdia.models.gas_pipeline.physics import INLET_PRESSURE, INLET_TEMPERATURE
from fusion_sfdia.models.gas_pipeline.plant import demand
from fusion_sfdia.models.power_network.parameters import LoadStep, load_steps
from fusion_sfdia.models.power_network.plant import power_network

Array = NDArray[Any]


DEMAND_PERIOD = 3600.0  # s: the ramps of the plant's demand, and back to where it began
DISTANCE_STEPS = 400
LOAD_PERIOD, LOAD_REPEATS = 100.0, 20  # s: the load steps come again with the opposite sign, and so on


@cache
def demand_step() -> float:
    """Seconds of a step of the pipeline: an input that acts from t on is that of its end."""
    return registry.plant("gas-pipeline").dt


def repeated_demand(t: float) -> Array:
    """The pipeline's inputs that act from t on: 300 to 450 kg/s and down to 350 as in `demand`, then to 300 in 600 s, again."""
    ahead = t + demand_step()
    within = ahead % DEMAND_PERIOD
    back = 25.0 * (1.0 - float(np.cos(np.pi * np.clip((within - 2850.0) / 600.0, 0.0, 1.0))))
    return np.array([INLET_PRESSURE, INLET_TEMPERATURE, demand(within) - back])


@cache
def repeated_loads(scenario: str) -> tuple[LoadStep, ...]:
    """The load steps of a scenario of B18 over and over, every other time with the opposite sign, so that loads stay small."""
    steps = load_steps(scenario)
    return tuple(
        step._replace(time=step.time + k * LOAD_PERIOD, change=(-1) ** k * step.change)
        for k in range(LOAD_REPEATS)
        for step in steps
    )


OPERATIONS: dict[str, Callable[[float], Array]] = {"gas-pipeline": repeated_demand}  # others have the plant's own


@cache
def plant_of(name: str) -> Plant:
    """A registered plant in the usual operation of the comparison: what learns from healthy runs learns from that."""
    if name == "power-network":
        return power_network(loads=repeated_loads("1"))
    plant = registry.plant(name)
    if (operation := OPERATIONS.get(name)) is None:
        return plant
    finer = plant.truth.finer and partial(_finer, plant, operation)
    return replace(plant, truth=replace(plant.truth, operation=operation, finer=finer))


def _finer(plant: Plant, operation: Callable[[float], Array]) -> tuple[Plant, Callable[[Array], Array]]:
    assert plant.truth.finer is not None
    finer, to_states = plant.truth.finer()
    return replace(finer, truth=replace(finer.truth, operation=operation)), to_states


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
    """Readings from the high-fidelity model of a truth (None: of the plant) under inputs (None: the usual ones).

    lost: from a time (s) on other inputs act than those that are known, the known ones times these factors.
    """
    of = plant_of(plant)
    model = of if truth is None else truth
    inputs = OPERATIONS.get(plant) if inputs is None else inputs
    if lost is not None and model.truth.feedback is not None:
        raise ValueError(f"plant {model.name!r} has controllers, which would see what is lost; give it a fault of its own")
    finest, to_states = (model, None) if model.truth.finer is None else model.truth.finer()
    finest = replace(finest, sensors=of.sensors)  # whose noise may be a share of what they usually show
    run = partial(simulate, of, steps, seeds, truth=finest, to_states=to_states, process_noise=of.truth.disturbed)
    if lost is None:
        return run(inputs=inputs)
    t = np.arange(steps) * of.dt
    known = np.array([(inputs or model.input_at)(float(s)) for s in t])
    acting = np.where((t >= lost[0] - 1e-6 * of.dt)[:, None], known * np.asarray(lost[1]), known)
    return replace(run(inputs=acting), u=known)


@cache
def distance_of_truth(plant: str) -> float:
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
