"""Inverse factors of positive definite matrices multiply back, leave out what is not used, and are the same in a batch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.filters.factors import half_inverses
from fusion_sfdia.filters.gaussian import half_inverse

Array = NDArray[Any]
SIZES = (1, 2, 3, 4, 5, 8, 17, 63, 130)


def matrices(n: int, count: int) -> Array:
    root = np.random.default_rng(n).standard_normal((count, n, 2 * n))
    return np.asarray(root @ root.swapaxes(-1, -2))


@pytest.mark.parametrize("n", SIZES)
def test_the_factor_is_upper_triangular_and_multiplies_back(n: int) -> None:
    A = matrices(n, 3)
    U = half_inverse(A)
    np.testing.assert_array_equal(U, np.triu(U))
    assert (np.diagonal(U, axis1=-2, axis2=-1) > 0).all()
    allowed = rounding(float(np.linalg.cond(A).max()), 3 * n)
    np.testing.assert_allclose(U @ U.swapaxes(-1, -2) @ A, np.broadcast_to(np.eye(n), A.shape), rtol=0, atol=allowed)
    np.testing.assert_array_equal(half_inverse(A[1]), U[1])


@pytest.mark.parametrize("n", [3, 6, 17])
def test_rows_that_are_left_out_do_not_exist(n: int) -> None:
    """Not even if they are NaN: the factor of the others is the same to the bit in a batch with other choices."""
    A, rng = matrices(n, 4), np.random.default_rng(0)
    used = rng.random((4, n)) < 0.6
    gone = A.copy()
    gone[~(used[:, :, None] & used[:, None, :])] = np.nan
    U = half_inverse(gone, used)
    np.testing.assert_array_equal(U, half_inverse(A, used))
    for r in range(4):
        assert not U[r][~used[r]].any() and not U[r][:, ~used[r]].any()
        kept = U[r][np.ix_(used[r], used[r])]
        expected = half_inverse(A[r][np.ix_(used[r], used[r])])
        allowed = rounding(float(np.linalg.cond(A[r])), 3 * n) * np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(kept, expected, rtol=0, atol=allowed)
        np.testing.assert_array_equal(half_inverse(A[r], used[r]), U[r])


@pytest.mark.parametrize("n", [1, 4, 7])
def test_only_what_is_not_positive_definite_and_finite_is_nan(n: int) -> None:
    A = matrices(n, 5)
    A[1], A[2, n - 1, n - 1], A[3, 0, 0] = -A[1], np.inf, np.nan
    U = A.copy()
    half_inverses(U, np.ones((1, n), bool))
    assert np.isnan(U[1:4]).all() and np.isfinite(U[[0, 4]]).all()
