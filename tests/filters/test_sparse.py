"""Products with Jacobians of which most entries are 0 are those of the dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.detectors import registry
from fusion_sfdia.filters import ekf
from fusion_sfdia.filters.sparse import congruence, variances

Array = NDArray[np.float64]
RNG = np.random.default_rng(0)
RUNS, M, N = 3, 7, 9


def covariance(*batch: int) -> Array:
    root = RNG.standard_normal((*batch, N, N))
    return np.asarray(root @ root.swapaxes(-1, -2))


def few(*shape: int) -> Array:
    return np.asarray(RNG.standard_normal(shape) * (RNG.random(shape) < 0.2))


@pytest.mark.parametrize(
    ("A", "P"),
    [
        (few(M, N), covariance(RUNS)),
        (few(RUNS, M, N), covariance(RUNS)),
        (few(M, N), covariance()),
        (few(M, N), covariance(2, 2)),
    ],
    ids=["one-jacobian", "one-of-each-run", "single", "two-axes"],
)
def test_the_products_are_those_of_dense_matrices(A: Array, P: Array) -> None:
    both, right = congruence(A, P, np.zeros(M))
    largest = np.abs(A) @ np.abs(P)
    np.testing.assert_allclose(right.swapaxes(-1, -2), A @ P, rtol=0, atol=rounding(float(largest.max()), N))
    expected = A @ P @ A.swapaxes(-1, -2)
    allowed = rounding(float((largest @ np.abs(A).swapaxes(-1, -2)).max()), 2 * N)
    np.testing.assert_allclose(both, expected, rtol=0, atol=allowed)
    np.testing.assert_array_equal(both, both.swapaxes(-1, -2))
    np.testing.assert_allclose(variances(A, P), np.diagonal(expected, axis1=-2, axis2=-1), rtol=0, atol=allowed)


def test_variances_of_runs_with_one_covariance_are_computed_once() -> None:
    A, P = few(M, N), covariance(1)
    shared = np.broadcast_to(P, (RUNS, N, N))
    found = variances(A, shared)
    assert found.shape == (RUNS, M) and found.strides[0] == 0
    np.testing.assert_array_equal(found[:1], variances(A, P))


def test_a_run_has_the_bits_that_it_has_alone() -> None:
    A, P = few(RUNS, M, N), covariance(RUNS)
    both, right = congruence(A, P, np.ones(M))
    for r in range(RUNS):
        alone = congruence(A[r : r + 1], P[r : r + 1], np.ones(M))
        np.testing.assert_array_equal(both[r], alone[0][0])
        np.testing.assert_array_equal(right[r], alone[1][0])


def test_what_is_added_may_be_a_diagonal_or_a_matrix() -> None:
    A, P, D = few(M, N), covariance(RUNS), 1.0 + np.arange(M)
    without, _ = congruence(A, P, np.zeros(M))
    np.testing.assert_array_equal(congruence(A, P, D)[0], without + np.diag(D))
    np.testing.assert_array_equal(congruence(A, P, np.diag(D))[0], without + np.diag(D))


def test_a_filter_step_is_the_same_by_sparse_and_dense_products() -> None:
    F, H, P, x, Q, R = few(N, N), few(M, N), covariance(1), np.zeros((1, N)), np.ones(N), np.ones(M)
    (_, dense), (_, sparse) = (ekf.predict(x, P, lambda s: s, F, Q, by) for by in (False, True))
    a, b = (ekf.joint(x, P, lambda s: s[..., :M], H, R, by) for by in (False, True))
    for found, expected in ((sparse, dense), (b.S, a.S), (b.C, a.C)):
        np.testing.assert_allclose(found, expected, rtol=0, atol=rounding(1e3 * float(np.abs(P).max()), 2 * N))


def test_plants_whose_jacobians_have_few_entries() -> None:
    """A pipe depends on itself everywhere, an area on its neighbours; of two tanks nothing is gained."""
    expected = {"gas-pipeline": (False, True), "power-network": (True, True), "two-tanks": (False, False)}
    assert {name: registry.plant(name).sparse for name in expected} == expected
