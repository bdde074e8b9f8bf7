"""Batches of any shape are stepped as one axis of runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from toy_plants import chain

from fusion_sfdia import simulate
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks import steady_gains
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.plant.plant import Plant, Structure
from fusion_sfdia.plants import two_tanks

TANKS, STEPS = two_tanks(), 24
CASES = [
    *((TANKS, name) for name in ("robust-glr", "fusing-enkf", "limits", "mhe-l1", "pca")),
    *((chain(), name) for name in ("robust-glr", "loo-glr")),  # gains come to rest
    (replace(TANKS, structure=Structure()), "adaptive-threshold"),  # Jacobians differ from run to run
]


@pytest.mark.parametrize(("plant", "name"), CASES)
def test_a_batch_of_two_axes_has_the_bits_of_its_runs_in_a_row(
    plant: Plant, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(steady_gains, "LARGE", 0)
    detector, recording = registry.detector(name, plant), simulate(plant, STEPS, seeds=range(6))
    y = recording.y.copy()
    y[20:, :, 1] += 9 * plant.sensor_sigma[1]
    y[8, 2, 0] = np.nan
    square, row = detector.init((2, 3), seed=4), detector.init(6, seed=4)
    for t, reading, u in zip(recording.t, y, recording.u_of_runs, strict=True):
        row, of_row = detector.step(row, float(t), reading, u)
        square, of_square = detector.step(square, float(t), reading.reshape(2, 3, -1), u.reshape(2, 3, -1))
        for what, a in vars(of_square).items():
            b = getattr(of_row, what)
            assert (a is None) == (b is None)
            if a is not None:
                np.testing.assert_array_equal(a, b.reshape(2, 3, *b.shape[1:]))
    for a, b in zip(leaves(square.memory), leaves(row.memory), strict=True):
        np.testing.assert_array_equal(a, b.reshape(2, 3, *b.shape[1:]))
