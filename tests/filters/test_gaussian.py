"""Laws of the Gaussian algebra: factorisations of batches, conditioning with missing readings, units, extreme precision."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.filters import gaussian
from fusion_sfdia.filters.gaussian import Joint, condition

Array = NDArray[Any]

SIZES = (1, 3, 4, 15, 16, 40)  # of whole and broken groups of four rows
NAN = np.nan


def covariances(rng: np.random.Generator, *shape: int) -> Array:
    a = rng.standard_normal((*shape, shape[-1]))
    return np.asarray(a @ np.swapaxes(a, -1, -2) + 0.5 * np.eye(shape[-1]))


def joints(seed: int, batch: tuple[int, ...], n: int, N: int) -> tuple[Joint, Array, Array, Array]:
    """A linear Gaussian joint, and its H (N, n), R (N,) and readings (*batch, N)."""
    rng = np.random.default_rng(seed)
    x, P = rng.standard_normal((*batch, n)), covariances(rng, *batch, n)
    H, R = rng.standard_normal((N, n)), rng.uniform(0.5, 2.0, N)
    C = P @ H.T
    return Joint(x, P, x @ H.T, H @ C + np.diag(R), C), H, R, rng.standard_normal((*batch, N))


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_factorisations_multiply_back(n: int, batch: tuple[int, ...]) -> None:
    A = covariances(np.random.default_rng(n), *batch, n)
    L = gaussian.cholesky(A)
    tolerance = rounding(np.linalg.cond(A).max(), 3 * n)  # factor, its inverse, the product
    largest = np.abs(A).max()
    np.testing.assert_allclose(L @ np.swapaxes(L, -1, -2), A, rtol=0, atol=rounding(largest, 2 * n))
    np.testing.assert_allclose(gaussian.inverse(A) @ A, np.broadcast_to(np.eye(n), A.shape), rtol=0, atol=tolerance)


@pytest.mark.parametrize("batch", [(), (3,)])
def test_solutions_of_triangular_systems_multiply_back_in_any_order_of_memory(batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(5)
    L, B = np.tril(rng.normal(size=(*batch, 6, 6))) + 3 * np.eye(6), rng.normal(size=(*batch, 4, 6))
    tolerance = rounding(np.linalg.cond(L).max() * np.abs(B).max(), 2 * 6)  # the solution, the product
    for right in (np.swapaxes(B, -1, -2), np.ascontiguousarray(np.swapaxes(B, -1, -2))):
        kept = right.copy()
        np.testing.assert_allclose(L @ gaussian.solve_lower(L, right), right, rtol=0, atol=tolerance)
        np.testing.assert_array_equal(right, kept)


@pytest.mark.parametrize("n", SIZES)
def test_a_bad_element_is_nan_alone(n: int) -> None:
    A = covariances(np.random.default_rng(n), 5, n)
    A[1] = NAN
    A[2] = -A[2]
    A[3, 0, 0] = np.inf
    for function in (gaussian.cholesky, gaussian.square_root, gaussian.inverse):
        result = function(A)
        assert not np.isfinite(result[1]).all() and not np.isfinite(result[2]).any() and not np.isfinite(result[3]).all()
        for good in (0, 4):
            np.testing.assert_array_equal(result[good], function(A[[good]])[0])


@pytest.mark.parametrize("n", SIZES)
def test_units_change_nothing_beyond_rounding(n: int) -> None:
    """A in other units is D A D; its inverse D^-1 A^-1 D^-1, even when the units span twenty decades."""
    rng = np.random.default_rng(n)
    A = covariances(rng, 3, n)
    D = 10.0 ** rng.uniform(-10, 10, n)
    scaled = gaussian.inverse(A * np.outer(D, D)) * np.outer(D, D)
    size = np.sqrt(np.einsum("bii->bi", gaussian.inverse(A)))
    unit = size[:, :, None] * size[:, None, :]
    root = np.sqrt(np.einsum("bii->bi", A))
    condition = np.linalg.cond(A / (root[:, :, None] * root[:, None, :])).max()  # of that with a unit diagonal, in any units
    np.testing.assert_allclose(scaled / unit, gaussian.inverse(A) / unit, rtol=0, atol=rounding(condition, 2 * n))


def test_square_root_of_a_singular_covariance() -> None:
    rng = np.random.default_rng(0)
    a = rng.standard_normal((6, 4)) * 10.0 ** np.arange(6)[:, None]
    A = np.stack([a @ a.T, np.diag([1.0, 0.0, 2.0, 0.0, 0.0, 3.0])])
    L = gaussian.square_root(A)
    scale = np.sqrt(np.where(np.einsum("bii->bi", A) > 0, np.einsum("bii->bi", A), 1.0))
    np.testing.assert_allclose(
        (L @ np.swapaxes(L, -1, -2) - A) / (scale[:, :, None] * scale[:, None, :]), 0.0, atol=gaussian.ROUNDING
    )
    assert np.isnan(gaussian.square_root(np.diag([1.0, -1e-3]))).all()


@pytest.mark.parametrize("as_matrix", [False, True])
def test_sample_has_the_covariance(as_matrix: bool) -> None:
    """Sample variances of 1e5 draws stand within 5 standard errors (variance times sqrt(2/draws)); a zero variance is exact."""
    variances, draws = np.array([4.0, 0.0, 9.0]), 100_000
    cov = np.diag(variances) if as_matrix else variances
    z = gaussian.sample(cov, np.random.default_rng(1), (draws,))
    error = np.abs(np.cov(z.T) - np.diag(variances))
    assert np.all(error <= 5 * np.sqrt(2 / draws) * np.sqrt(np.outer(variances, variances)))
    np.testing.assert_array_equal(z[:, 1], 0.0)


def test_add_and_dense_take_diagonals_and_matrices() -> None:
    P, q = covariances(np.random.default_rng(0), 2, 3), np.array([1.0, 2.0, 3.0])
    np.testing.assert_array_equal(gaussian.add(P, q), P + np.diag(q))
    np.testing.assert_array_equal(gaussian.add(P, np.diag(q)), gaussian.add(P, q))
    np.testing.assert_array_equal(gaussian.dense(q), np.diag(q))
    assert gaussian.dense(P) is P


@pytest.mark.parametrize(("n", "N"), [(3, 2), (2, 5), (20, 17)])
def test_condition_is_the_information_form(n: int, N: int) -> None:
    """P^-1 + H' R^-1 H over the readings used, for a different subset in every element of the batch, none and all included."""
    joint, H, R, y = joints(0, (6,), n, N)
    missing = np.random.default_rng(1).random((6, N)) < 0.5
    missing[0], missing[1] = False, True
    found = condition(joint, np.where(missing, NAN, y))
    for b in range(6):
        h, r, d = H[~missing[b]], R[~missing[b]], (y - joint.y)[b, ~missing[b]]
        P = np.linalg.inv(np.linalg.inv(joint.P[b]) + h.T / r @ h)
        tolerance = rounding(np.linalg.cond(joint.P[b]), 2 * (n + N)) * np.linalg.norm(joint.P[b])
        np.testing.assert_allclose(found.P[b], P, atol=tolerance)
        np.testing.assert_allclose(found.x[b], joint.x[b] + P @ (h.T / r @ d), atol=10 * tolerance)
        S = h @ joint.P[b] @ h.T + np.diag(r)
        np.testing.assert_allclose(found.inverse[b][np.ix_(~missing[b], ~missing[b])], np.linalg.inv(S), atol=tolerance)
        if len(d):
            assert found.nis[b] == pytest.approx(d @ np.linalg.solve(S, d) / len(d))
    np.testing.assert_array_equal(np.isnan(found.innovation), missing)
    assert not np.any(found.inverse[missing]) and not np.any(np.swapaxes(found.inverse, -1, -2)[missing])
    np.testing.assert_array_equal(found.x[1], joint.x[1])
    np.testing.assert_allclose(
        found.P[1], joint.P[1], rtol=rounding(1, 4 * (n + N))
    )  # twice what keeps P positive, 4 eps (n + N)
    assert np.isnan(found.nis[1])


def test_excluded_and_missing_readings_are_the_same() -> None:
    joint, _, _, y = joints(2, (3,), 4, 5)
    used = np.array([True, False, True, True, False])
    excluded, missing = condition(joint, y, used), condition(joint, np.where(used, y, NAN))
    for a, b in zip(excluded, missing, strict=True):
        np.testing.assert_array_equal(a, b)
    y[0, 0] = NAN  # a reading that is missing is not used, whatever the mask says
    np.testing.assert_array_equal(condition(joint, y, used).used[0], [False, False, True, True, False])


def test_one_prior_serves_a_batch_of_readings() -> None:
    joint, _, _, _ = joints(3, (), 4, 3)
    y = np.random.default_rng(0).standard_normal((5, 3))
    y[2, 1] = NAN
    together = condition(Joint(joint.x, joint.P, joint.y, joint.S, joint.C), y)
    tolerance = rounding(np.linalg.cond(joint.S), 2 * 3 + 4) * np.abs(together.x).max()
    for b in range(5):
        np.testing.assert_allclose(together.x[b], condition(joint, y[b]).x, rtol=0, atol=tolerance)


def test_readings_one_after_another_are_readings_at_once() -> None:
    joint, H, R, y = joints(4, (), 5, 4)
    at_once = condition(joint, y)
    x, P = joint.x, joint.P
    for i in range(4):
        C = P @ H[[i]].T
        x, P = condition(Joint(x, P, x @ H[[i]].T, H[[i]] @ C + R[i], C), y[[i]])[:2]
    tolerance = rounding(np.linalg.cond(joint.P), 4 * (5 + 4)) * np.linalg.norm(joint.P)  # of four updates
    np.testing.assert_allclose(x, at_once.x, rtol=0, atol=tolerance)
    np.testing.assert_allclose(P, at_once.P, rtol=0, atol=tolerance)


@pytest.mark.parametrize("n", [1, 2, 8, 30])
def test_covariances_stay_positive_definite_under_precise_readings(n: int) -> None:
    """Readings 1e-6 of the prior's standard deviation, coupled states whose units span 12 decades, 50 updates, no noise."""
    rng = np.random.default_rng(n)
    unit = 10.0 ** rng.uniform(-6, 6, n)
    P = covariances(rng, n) * np.outer(unit, unit)
    H, R = rng.standard_normal((n, n)) / unit, np.full(n, 1e-12)
    x = np.zeros(n)
    for _ in range(50):
        C = P @ H.T
        found = condition(Joint(x, P, x @ H.T, gaussian.symmetrise(H @ C) + np.diag(R), C), np.zeros(n))
        x, P = found.x, found.P
        scale = np.sqrt(np.diagonal(P))
        assert np.linalg.eigvalsh(P / np.outer(scale, scale))[0] > 0
        np.testing.assert_array_equal(P, P.T)


def test_a_diffuse_scalar_prior_is_safe() -> None:
    """A prior 1e10 times the reading's standard deviation leaves a variance that is positive and not below the reading's."""
    x, P, R = np.zeros(1), np.array([[1e20]]), 1.0
    for k in range(1, 4):
        x, P = condition(Joint(x, P, x, P + R, P), np.array([5.0]))[:2]
        assert P[0, 0] >= R / k * (1 - 1e-9)
        assert x == pytest.approx(5.0)


def considering(joint: Joint, y: Array, theta: Array) -> tuple[Array, Array, Array]:
    """Estimate, covariance and gain after Schmidt, by Joseph's form: the optimal gain with the rows of theta set to 0."""
    used = np.isfinite(y)
    K = np.zeros(joint.C.shape)
    K[:, used] = joint.C[:, used] @ np.linalg.inv(joint.S[np.ix_(used, used)])
    K[theta] = 0.0
    P = joint.P - K @ joint.C.T - joint.C @ K.T + K @ joint.S @ K.T
    return joint.x + K @ np.where(used, y - joint.y, 0.0), P, K


@pytest.mark.parametrize("missing", [(), (1, 3)])
@pytest.mark.parametrize("theta", [(4,), (1, 3), (0, 1, 2, 3, 4)])
def test_considered_states_are_those_of_josephs_form(theta: tuple[int, ...], missing: tuple[int, ...]) -> None:
    joint, *_, y = joints(11, (), 5, 6)
    y[list(missing)] = NAN
    held = np.array(theta)
    x, P, K = considering(joint, y, held)
    given = joint._replace(considered=held)
    found = condition(given, y)
    tolerance = rounding(np.linalg.cond(joint.S), 60) * np.abs(joint.P).max()
    np.testing.assert_allclose(found.x, x, rtol=0, atol=tolerance)
    np.testing.assert_allclose(found.P, P, rtol=0, atol=tolerance)
    np.testing.assert_allclose(gaussian.gain(given, found.inverse), K, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(found.x[held], joint.x[held])
    np.testing.assert_array_equal(found.P[np.ix_(held, held)], joint.P[np.ix_(held, held)])
    # never better than the optimal gain, and no less than a covariance
    assert np.linalg.eigvalsh(found.P - condition(joint, y).P).min() > -tolerance
    assert np.linalg.eigvalsh(found.P).min() > 0


def test_the_given_joint_is_left_as_it_is_and_a_batch_is_its_elements() -> None:
    joint, *_, y = joints(12, (3,), 4, 5)
    given = joint._replace(considered=np.array([3]))
    before = joint.P.copy()
    together = condition(given, y)
    np.testing.assert_array_equal(joint.P, before)
    for b in range(3):
        alone = condition(Joint(*(a[b] for a in joint[:5]), given.considered), y[b])
        tolerance = rounding(np.linalg.cond(joint.S).max(), 40) * np.abs(joint.P).max()
        np.testing.assert_allclose(together.P[b], alone.P, rtol=0, atol=tolerance)
