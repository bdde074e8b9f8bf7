"""The example of a plant that is written in CasADi."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia.derivatives.equation import difference_jacobian
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.checks.plants import check_plant
from fusion_sfdia.plant.plant import Plant

EXAMPLE = "docs/examples/reactor.py"


@pytest.fixture(scope="module")
def plant(root: Path) -> Plant:
    pytest.importorskip("casadi")
    return registry.plant(f"{root / EXAMPLE}:make")


def test_it_rests_where_the_benchmark_does_and_its_jacobian_is_exact(plant: Plant) -> None:
    """The paper prints five digits of the state: 20 s change it by less than the last one and its effect on the others. The
    error of central differences is eps^(2/3) of second to third derivatives, here below 1e-6.
    """
    u = plant.input_at(0.0)
    assert np.all(np.abs(plant.step(0.0, plant.x0, u, 20.0) - plant.x0) < [1e-4, 1e-4, 1e-2, 1e-2])
    x = plant.x0 + np.array([[[0.0, 0.0, 0.0, 0.0]], [[0.1, 0.05, 3.0, -2.0]]])
    differences = difference_jacobian(lambda p: plant.step(0.0, p, u, 20.0), x, plant.state_scale)
    found = plant.step_jacobian_at(0.0, x, u + np.zeros((3, 2)), 20.0)
    assert found.shape == (2, 3, 4, 4) and np.max(np.abs(found - differences)) < 1e-6
    check_plant(plant)


@pytest.mark.slow
def test_it_finds_the_fault_that_the_page_states(plant: Plant, root: Path) -> None:
    recording = simulate(plant, 120, seeds=[1])
    recording.y[60:, 0, 2] += 0.6
    lines = [
        f"{e.hypothesis} from {e.start:.0f} s, {e.size:.1f} {e.unit}"
        for e in diagnose("loo-glr", recording, plant=plant).events
    ]
    stated = (root / EXAMPLE).read_text(encoding="utf-8").rpartition("# ")[2].strip()
    assert lines == [stated]
