"""A sequence of equations evaluates each residual as if it were alone."""

from __future__ import annotations

import numpy as np
from structural_plants import plant_of
from toy_plants import Array

from fusion_sfdia.detectors.structural_residuals.sequences import Sequences
from fusion_sfdia.detectors.structural_residuals.structural_residuals import usable


def test_sequences_evaluate_each_residual_as_if_it_were_alone() -> None:
    plant = plant_of("marine-engine")
    assert plant.structure.modules is not None
    residuals, rng = usable(plant)[::40], np.random.default_rng(3)
    nominal = np.array([plant.structure.modules.nominal[v] for v in plant.structure.modules.equations])
    y: Array = nominal[:, None] * (1 + 0.02 * rng.standard_normal((nominal.size, 5)))
    x = np.repeat(y[None, :3], len(residuals), axis=0)
    together = Sequences(plant.structure.modules, residuals).predicted(x, y, np.ones((1, 5)))
    for k, r in enumerate(residuals):
        alone = Sequences(plant.structure.modules, (r,)).predicted(x[:1], y, np.ones((1, 5)))
        np.testing.assert_array_equal(together[k], alone[0])
