"""Means over windows: sums of a ring, and windows side by side as each alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.filters.gaussian import half_inverse
from fusion_sfdia.learning.frozen_model.window_means import Spread, explained, latest, sums

Array = NDArray[Any]


@pytest.mark.parametrize("row", [0, 3, 7, 8, 13, 29])
def test_sums_are_those_of_the_last_rows(row: int) -> None:
    length, rows = 8, np.random.default_rng(1).integers(0, 9, (30, 2, 3)).astype(float)
    ring = np.zeros((2, length, 3))
    for k in range(row + 1):
        ring[:, k % length] = rows[k]
    found = sums(ring, latest([1, 3, 8], length), row)
    for i, w in enumerate((1, 3, 8)):
        np.testing.assert_array_equal(found[:, i], rows[max(row + 1 - w, 0) : row + 1].sum(axis=0))


@pytest.mark.parametrize("missing", [False, True])
def test_windows_side_by_side_are_as_each_alone(missing: bool) -> None:
    rng = np.random.default_rng(2)
    root, m, d = rng.standard_normal((3, 4, 4)), rng.standard_normal((3, 2, 4)), rng.standard_normal((3, 2, 4, 5))
    cov, known = root @ root.mT + np.eye(4), np.ones((3, 2, 4), bool)
    known[1, 0, 2] = not missing
    g, beside = 1 + rng.random((3, 2)), d[..., 1] * [[1.0], [0.0]]
    whole = explained(Spread(half_inverse(cov)[:, None], cov[:, None]), m, known, d, g, beside)
    for w in range(3):
        alone = explained(Spread(half_inverse(cov[w]), cov[w]), m[w], known[w], d[w], g[w], beside[w])
        for a, b in zip(whole, alone, strict=True):
            np.testing.assert_allclose(a[w], b, rtol=rounding(float(np.linalg.cond(cov[w])), 20))
