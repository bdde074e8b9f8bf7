"""Products of few states and sensors are those of the matrices, each run with the bits that it has alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.filters import ekf
from fusion_sfdia.filters.small import LARGEST, congruence, is_small

Array = NDArray[np.float64]
RNG = np.random.default_rng(0)
RUNS, M, N = 3, 4, 6
DIAGONAL, MATRIX = np.arange(1.0, M + 1), np.diag(np.arange(1.0, M + 1)) + 0.5


def covariance(*batch: int) -> Array:
    root = RNG.standard_normal((*batch, N, N))
    return np.asarray(root @ root.swapaxes(-1, -2))


@pytest.mark.parametrize("D", [DIAGONAL, MATRIX], ids=["diagonal", "matrix"])
@pytest.mark.parametrize(
    ("A", "P"),
    [
        (RNG.standard_normal((M, N)), covariance(RUNS)),
        (RNG.standard_normal((RUNS, M, N)), covariance(RUNS)),
        (RNG.standard_normal((M, N)), covariance()),
        (RNG.standard_normal((M, N)), covariance(2, 2)),
        (RNG.standard_normal((2, 1, M, N)), covariance(2, 2)),
    ],
    ids=["one-jacobian", "one-of-each-run", "single", "two-axes", "broadcast"],
)
def test_the_products_are_those_of_matrices(A: Array, P: Array, D: Array) -> None:
    both, right = congruence(A, P, D)
    largest = np.abs(A) @ np.abs(P)
    np.testing.assert_allclose(right.swapaxes(-1, -2), A @ P, rtol=0, atol=rounding(float(largest.max()), N))
    allowed = rounding(float((largest @ np.abs(A).swapaxes(-1, -2)).max() + np.abs(D).max()), 2 * N + 1)
    expected = A @ P @ A.swapaxes(-1, -2) + (np.diag(D) if D.ndim == 1 else D)
    np.testing.assert_allclose(both, expected, rtol=0, atol=allowed)
    np.testing.assert_array_equal(both, both.swapaxes(-1, -2))


def test_a_run_has_the_bits_that_it_has_alone() -> None:
    A, P = RNG.standard_normal((RUNS, M, N)), covariance(RUNS)
    both, right = congruence(A, P, DIAGONAL)
    for r in range(RUNS):
        alone = congruence(A[r], P[r], DIAGONAL)
        np.testing.assert_array_equal(both[r], alone[0])
        np.testing.assert_array_equal(right[r], alone[1])


@pytest.mark.parametrize("n", [LARGEST, LARGEST + 1])
def test_a_filter_step_is_the_same_on_either_side_of_the_limit(n: int) -> None:
    root = RNG.standard_normal((2, n, n))
    F, H, Q = RNG.standard_normal((n, n)), RNG.standard_normal((M, n)), np.ones(n)
    P = root @ root.swapaxes(-1, -2)
    assert is_small(F) == is_small(H) == (n == LARGEST)
    x, ahead = ekf.predict(np.zeros((2, n)), P, lambda s: s, F, Q)
    joint = ekf.joint(x, ahead, lambda s: s @ H.T, H, DIAGONAL)
    sums = np.abs(F) @ np.abs(P) @ np.abs(F).T
    np.testing.assert_allclose(ahead, F @ P @ F.T + np.diag(Q), rtol=0, atol=rounding(float(sums.max()) + 1, 2 * n + 1))
    expected = H @ ahead @ H.T + np.diag(DIAGONAL)
    sums = np.abs(H) @ np.abs(ahead) @ np.abs(H).T
    np.testing.assert_allclose(joint.S, expected, rtol=0, atol=rounding(float(sums.max()) + M, 2 * n + 1))
    np.testing.assert_allclose(joint.C, ahead @ H.T, rtol=0, atol=rounding(float((np.abs(ahead) @ np.abs(H).T).max()), n))
