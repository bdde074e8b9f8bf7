"""Commissioning, lightly, on every plant of the package: its parts run and what it returns is a plant of the same interface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.commissioning.commission import as_runs
from fusion_sfdia.learning.commissioning.disturbances import learnt
from fusion_sfdia.learning.innovations import fitted, settling
from fusion_sfdia.plant.augment import augment, fixed
from fusion_sfdia.plant.uncertainty import Uncertainty

STEPS, SIZE = 90, 3.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two-tanks", "gas-pipeline", "marine-engine", "power-network"])
def test_a_constant_offset_of_states_is_learnt(name: str) -> None:
    plant = replace(registry.plant(name), uncertainty=Uncertainty())
    recording = simulate(plant, STEPS, [60], truth="model")
    log = as_runs(plant, (recording,))
    push = SIZE * plant.state_scale
    push[1:] = 0.0
    other = replace(plant, step=lambda t, x, u, dt: plant.step(t, x, u, dt) + push)
    erring = as_runs(plant, (simulate(other, STEPS, [60], truth="model"),))
    use = np.arange(STEPS) >= 20
    assert settling(fixed(plant), log) > 0
    adapted, found = learnt(plant, erring, use)
    before, after = (np.mean(fitted(p, erring).nis[use]) for p in (plant, adapted))
    assert found or before < 1.2
    assert after <= before
    assert len(augment(adapted).states) == len(plant.states) + len(found)
