"""Healthy readings of three plants, and the decisions of a Chebyshev detector on them."""

from __future__ import annotations

from functools import cache

import numpy as np
from toy_plants import chain, readings, tanks

from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import Chebyshev
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.power_network.plant import power_network
from fusion_sfdia.plant.plant import Array, Plant

RUNS, STEPS, SETTLED = 300, 40, 10
WATCHING = {"accommodate": False}


@cache
def network() -> Plant:
    return power_network(loads=(), noise="lit")


@cache
def healthy(name: str, runs: int = RUNS) -> tuple[Array, Array, Array]:
    """t (K,), y (K, B, N), u (K, B, m) of the plant's own model."""
    if name == "network":
        r = simulate(network(), STEPS, range(runs), truth="model", process_noise=True)
        return r.t, r.y, r.u_of_runs
    t, _, y, u = readings({"chain": chain, "tanks": tanks}[name](), STEPS, runs, seed=1)
    return t, y, u


def plant_of(name: str) -> Plant:
    return network() if name == "network" else {"chain": chain, "tanks": tanks}[name]()


def decisions(detector: Chebyshev, data: tuple[Array, Array, Array], batch: tuple[int, ...] | None = None) -> Decision:
    t, y, u = data
    return run(detector, detector.init(y.shape[1:-1] if batch is None else batch), t, y, u)[1]


# Of M squares of unit normals the root of the mean has the standard error 1 / sqrt(2 M); neighbouring times correlate, so M
# counts the runs alone: five of them for the largest of up to 94 components.
ERROR = 5 / np.sqrt(2 * RUNS)


def network_areas_of(plant: Plant) -> object:
    assert plant.structure.areas is not None
    return plant.structure.areas
