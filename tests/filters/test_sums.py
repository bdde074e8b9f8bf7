"""Sums of covariances in one pass: the bits are those of one operation after the other, of a run as of a batch."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.filters.sums import difference, symmetric_sum

Array = NDArray[Any]
RNG = np.random.default_rng(3)
N = 5
BATCHES: tuple[tuple[int, ...], ...] = (), (1,), (4,), (2, 3)


@pytest.mark.parametrize("batch", BATCHES)
def test_a_symmetric_sum_has_the_bits_of_its_operations(batch: tuple[int, ...]) -> None:
    M, D = RNG.standard_normal((*batch, N, N)), RNG.random(N)
    expected = (M + M.swapaxes(-1, -2)) * 0.5 + np.diag(D)
    np.testing.assert_array_equal(symmetric_sum(M.copy(), D), expected)
    np.testing.assert_array_equal(symmetric_sum(M.copy(), np.diag(D)), expected)


@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("same_for_all", [False, True])
def test_a_difference_has_the_bits_of_its_operations(batch: tuple[int, ...], same_for_all: bool) -> None:
    P = RNG.standard_normal((1,) * len(batch) + (N, N) if same_for_all else (*batch, N, N))
    less, floor = RNG.standard_normal((*batch, N, N)), 1e-3
    expected = P - less
    np.einsum("...ii->...i", expected)[...] += floor * np.diagonal(P, axis1=-2, axis2=-1)
    np.testing.assert_array_equal(difference(P, less.copy(), floor), expected)
    np.testing.assert_array_equal(difference(np.broadcast_to(P, (*batch, N, N)), less.copy(), floor), expected)


def test_what_is_subtracted_may_be_the_same_for_all_runs() -> None:
    P, less = RNG.standard_normal((4, N, N)), RNG.standard_normal((1, N, N))
    expected = P - less
    np.testing.assert_array_equal(difference(P, less.copy(), 0.0), expected)
