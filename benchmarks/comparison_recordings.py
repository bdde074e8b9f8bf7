"""Readings of a comparison: what a plant shows from a truth that no detector knows, as recordings.

The truth is the finer twin of a plant where it has one. The power network is run in closed loop, as its angles have a common
mode without restoring force: its controllers read healthy sensors, and each seed has its own inputs (K, B, m). It is disturbed
by its process noise, as its paper says; the others are not: the pipeline's belongs to 21 nodes, and on the finer grid of the
truth it is another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks import registry
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.simulate import Recording, simulate
from fusion_sfdia.models.power_network_model import network_model
from fusion_sfdia.models.power_network_operation import AreaFault, load_profile
from fusion_sfdia.models.power_network_parameters import NetworkParameters, load_network, load_steps
from fusion_sfdia.models.power_network_simulation import run_network

Array = NDArray[Any]

NETWORK = "power-network"


@cache
def plant_of(name: str) -> Plant:
    """A registered plant."""
    return registry.plant(name)


@lru_cache(maxsize=4)
def healthy(plant: str, steps: int, seeds: tuple[int, ...]) -> Recording:
    """Healthy readings in the usual operation, the same for all detectors."""
    return network_recording(steps, seeds) if plant == NETWORK else simulated(plant, steps, seeds)


def simulated(
    plant: str,
    steps: int,
    seeds: Sequence[int],
    *,
    truth: Plant | None = None,
    inputs: Callable[[float], Array] | None = None,
    lost: tuple[float, tuple[float, ...]] | None = None,
) -> Recording:
    """Readings from the finer twin of a truth (None: of the plant) under inputs (None: its operation).

    lost: from a time (s) on other inputs act than those that are known, the known ones times these factors.
    """
    of = plant_of(plant)
    model = of if truth is None else truth
    finest, to_states = (model, None) if model.finer is None else model.finer()
    t = np.arange(1, steps + 1) * of.dt
    known = np.array([(of.input_at if inputs is None else inputs)(float(s)) for s in t - of.dt])
    acting = known
    if lost is not None:
        acting = np.where((t - of.dt >= lost[0] - 1e-6 * of.dt)[:, None], known * np.asarray(lost[1]), known)
    recording = simulate(of, steps, seeds, truth=finest, to_states=to_states, inputs=acting)
    return replace(recording, u=known)


def network_recording(
    steps: int,
    seeds: Sequence[int],
    *,
    parameters: NetworkParameters | None = None,
    loads: str = "1",
    faults: Sequence[AreaFault] = (),
) -> Recording:
    """Readings of the power network in closed loop, discretised exactly; u (K, B, m). loads: the scenario of B18."""
    plant = plant_of(NETWORK)
    model = network_model(load_network() if parameters is None else parameters, discretisation="exact")
    profile = load_profile(model, load_steps(loads))
    moments = list(run_network(model, steps, seeds, loads=profile, faults=faults))[1:]
    t, x = np.array([m.t for m in moments]), np.stack([m.x.reshape(len(seeds), -1) for m in moments])
    return Recording(
        t=t,
        u=np.stack([m.u for m in moments]),
        y=np.stack([m.y for m in moments]),
        signal=np.stack([plant.output(float(s), state, np.zeros(0)) for s, state in zip(t, x, strict=True)]),
        x=x,
        seeds=tuple(int(s) for s in seeds),
        states=tuple(s.name for s in plant.states),
        inputs=tuple(s.name for s in plant.inputs),
        sensors=plant.sensor_names,
    )


def of_each(u: Array, runs: int) -> Array:
    """The inputs (K, m) or (K, B, m) as those of each run (K, B, m)."""
    return u if u.ndim == 3 else np.broadcast_to(u[:, None], (u.shape[0], runs, u.shape[-1]))


def until(recording: Recording, steps: int) -> Recording:
    """The first samples of a recording."""
    return replace(
        recording, t=recording.t[:steps], u=recording.u[:steps], y=recording.y[:steps], signal=recording.signal[:steps]
    )
