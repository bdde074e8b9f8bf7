"""Batches of any shape are stepped as one axis of runs."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia import simulate
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.plants import two_tanks

PLANT = two_tanks()


@pytest.mark.parametrize("name", ["robust-glr", "fusing-enkf", "limits", "mhe-l1"])
def test_a_batch_of_two_axes_has_the_bits_of_its_runs_in_a_row(name: str) -> None:
    detector, recording = registry.detector(name, PLANT), simulate(PLANT, 12, seeds=range(6))
    y = recording.y + np.where(np.arange(12) > 5, 9.0, 0.0)[:, None, None] * [0.0, PLANT.sensor_sigma[1], 0.0, 0.0]
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
