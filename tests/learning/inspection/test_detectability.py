"""What an inspection promises, a run delivers."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia import Plant, simulate
from fusion_sfdia.detectors import RobustBank, registry
from fusion_sfdia.detectors.kalman_banks.identifiability import identifiability
from fusion_sfdia.learning.inspection.detectability import BIAS_WITHIN, DRIFT_WITHIN, GROWTH, LEAST_BIAS, LEAST_DRIFT, promised
from fusion_sfdia.plants import random_plant

RUNS, MET = 20, 18
STEPS, FIRST, LAST = 190, 60, 100  # samples, and between which a fault begins
PLANTS = (
    "two-tanks",
    "marine-engine",
    "gas-pipeline",
    pytest.param("power-network", marks=pytest.mark.long),
    531,
    532,
)  # seeds of random ones


def plant_of(name: str | int) -> Plant:
    return registry.plant(name) if isinstance(name, str) else random_plant(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTS)
def test_faults_of_the_promised_size_are_isolated_in_time(name: str | int) -> None:
    """Biases and drifts in turn, of random sensors, from the size that is promised to half as much again."""
    plant, rng = plant_of(name), np.random.default_rng(9)
    promise = promised(plant, identifiability(plant, GROWTH))
    made = simulate(plant, STEPS, range(600, 600 + RUNS), truth="model", process_noise=True)
    y, faults = made.y.copy(), []
    for run in range(RUNS):
        drifts = run % 2
        least, within = (promise.drift, DRIFT_WITHIN) if drifts else (promise.bias, BIAS_WITHIN)
        i, onset = int(rng.choice(np.flatnonzero(np.isfinite(least)))), int(rng.integers(FIRST, LAST))
        size = least[i] * rng.uniform(1, 1.5) * rng.choice([-1, 1]) * plant.sensor_sigma[i]
        grown = np.minimum(np.arange(1, STEPS - onset + 1) / GROWTH, 1.0) if drifts else 1.0
        y[onset:, run, i] += size * grown
        faults.append((i, onset, within))
    detector = RobustBank(plant)
    state, isolated = detector.init(RUNS), np.zeros((STEPS, RUNS, len(plant.sensors)), bool)
    for k in range(STEPS):
        state, decision = detector.step(state, made.t[k], y[k], made.u_of_runs[k])
        isolated[k] = decision.isolated[:, : len(plant.sensors)]
    alone = isolated & (isolated.sum(axis=-1, keepdims=True) == 1)
    met = [alone[onset : onset + within, run, i].any() for run, (i, onset, within) in enumerate(faults)]
    assert sum(met) >= MET


def test_no_promise_is_below_what_offsets_are() -> None:
    plant = registry.plant("two-tanks")
    promise = promised(plant, identifiability(plant, GROWTH))
    assert (promise.bias >= LEAST_BIAS).all() and (promise.drift >= LEAST_DRIFT).all()
