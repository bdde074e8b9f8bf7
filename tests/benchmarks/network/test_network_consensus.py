"""network/consensus: theory and simulation of the variance of residuals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fusion_sfdia.benchmarks.network.consensus import ALONE, alone, consensus_work, copies, network, theory
from fusion_sfdia.benchmarks.network.support.residuals import CORRECTED, MEMORYLESS, diagnosed
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.simulation import run_network


def quiet(t: float) -> np.ndarray[Any, Any]:
    return np.zeros(15)


@pytest.mark.long
def test_the_theory_of_consensus_is_the_corrected_threshold_without_memory() -> None:
    areas = network({"noise": "small", "worse": 4.0})
    *_, (_, last) = diagnosed(areas, run_network(network_model(noise="small"), 3, [0], loads=quiet), MEMORYLESS)
    deviation = np.concatenate([last.deviation[0, :, 0], last.deviation_shared[0]])
    np.testing.assert_allclose(np.sum(list(theory(areas, "corrected", 0.0).values()), axis=0), deviation**2, rtol=1e-12)


def test_consensus_with_useless_other_readings_is_the_own_reading() -> None:
    areas = network({"noise": "lit", "worse": 1e12})
    moments = list(run_network(network_model(), 20, [0, 1], loads=quiet))
    found = list(alone(areas, moments, CORRECTED.lam))
    agreed = [s.residual[..., 0] for _, s in diagnosed(areas, moments, CORRECTED)]
    # the others' weight is 1e-12 of residuals of at most 1
    np.testing.assert_allclose(np.stack(found)[..., :15], np.stack(agreed), atol=1e-11)


@pytest.mark.parametrize("weights", [ALONE, "corrected", "paper"])
def test_theory_and_simulation_agree_on_the_variance_of_residuals(weights: str) -> None:
    task = {"noise": "small", "readings": "unequal", "worse": 16.0, "steps": 150, "seeds": list(range(20))}
    areas = network(task)
    runs = consensus_work(task)[f"{weights} 0.3"] / 141
    expected = np.sum(list(theory(areas, weights, 0.3).values()), axis=0)
    for mask in copies(areas).values():
        per_run = runs[:, mask].mean(axis=1)
        margin = 4.5 * per_run.std(ddof=1) / np.sqrt(20)  # standard errors over 20 runs, 6 groups: by luck 1 in 1000
        assert abs(per_run.mean() - expected[mask].mean()) < margin
