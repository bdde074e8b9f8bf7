"""The statistics (19) and (20) against their formulas, written with NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.detectors.kalman_banks.disagreement import disagreement


@pytest.mark.parametrize("n", [1, 2, 7])
def test_variance_and_distance_are_those_of_the_formulas(n: int) -> None:
    rng = np.random.default_rng(n)
    local, seen = rng.normal(size=(3, 5, n)), rng.normal(size=(3, 5, 5))
    mixed, scale = rng.normal(size=(3, n)), rng.uniform(0.5, 2.0, n)
    variance, distance = disagreement(local, seen, mixed, scale)
    np.testing.assert_allclose(variance, np.var(seen, axis=-2), rtol=1e-13)
    np.testing.assert_allclose(distance, np.linalg.norm((local - mixed[..., None, :]) / scale, axis=-1), rtol=1e-14)


def test_a_run_has_the_bits_that_it_has_alone() -> None:
    rng = np.random.default_rng(0)
    local, seen, mixed = (rng.normal(size=(4, *shape)) for shape in ((5, 9), (5, 5), (9,)))
    together = disagreement(local, seen, mixed, np.ones(9))
    for r in range(4):
        alone = slice(r, r + 1)
        for all_runs, one in zip(together, disagreement(local[alone], seen[alone], mixed[alone], np.ones(9)), strict=True):
            np.testing.assert_array_equal(all_runs[alone], one)
