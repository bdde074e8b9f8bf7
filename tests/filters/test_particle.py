"""Laws of the particle filters: resampling is fair, and on a linear Gaussian model they approach the Kalman filter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.filters import ekf, particle
from fusion_sfdia.filters.gaussian import condition
from fusion_sfdia.filters.particle import Particles

Array = NDArray[Any]

NAN = np.nan
F = np.array([[1.0, 0.1], [-0.2, 0.9]])
H = np.array([[1.0, 0.0], [0.5, 1.0]])
Q, R = np.array([0.04, 0.09]), np.array([0.2, 0.5])
Y = np.array([[0.5, 0.3], [NAN, 0.8], [NAN, NAN], [0.9, NAN], [0.4, 0.2]])


def f(x: Array) -> Array:
    return np.asarray(x @ F.T)


def h(x: Array) -> Array:
    return np.asarray(x @ H.T)


def kalman() -> tuple[Array, Array]:
    x, P = np.zeros(2), np.eye(2)
    for y in Y:
        x, P = ekf.predict(x, P, f, F, Q)
        x, P = condition(ekf.joint(x, P, h, H, R), y)[:2]
    return x, P


def bootstrap(size: int, runs: int, rng: np.random.Generator) -> tuple[Array, Array]:
    cloud = particle.start(np.zeros(2), np.ones(2), size, rng, (runs,))
    for y in Y:
        cloud = particle.predict(cloud, f, Q, rng)
        cloud, _ = particle.update(cloud, h, y, R, rng)
    return cloud.moments


def gaussian(size: int, runs: int, rng: np.random.Generator) -> tuple[Array, Array]:
    x, P = np.zeros((runs, 2)), np.broadcast_to(np.eye(2), (runs, 2, 2))
    for y in Y:
        x, P = particle.gaussian_predict(x, P, f, Q, size, rng)
        x, P, _ = particle.gaussian_update(x, P, h, y, R, size, rng)
    return x, P


@pytest.mark.parametrize("method", [bootstrap, gaussian])
def test_approaches_the_kalman_filter(method: Any) -> None:
    """The mean of 200 runs lies within 4.5 standard errors and a bias of some 5 / size of the posterior's own spread."""
    size, runs = 1000, 200
    x, P = method(size, runs, np.random.default_rng(2))
    expected_x, expected_P = kalman()
    sigma = np.sqrt(np.diagonal(expected_P))
    assert np.all(np.abs(x.mean(0) - expected_x) < 4.5 * x.std(0) / np.sqrt(runs) + 5 / size * sigma)
    assert np.all(np.abs(P.mean(0) - expected_P) < 4.5 * P.std(0) / np.sqrt(runs) + 5 / size * np.outer(sigma, sigma))


def test_log_likelihoods_far_below_the_smallest_number_still_weigh() -> None:
    """Readings 1e4 sigma away: e^(-5e7) underflows, the differences of its logarithm decide."""
    cloud = Particles(np.array([[0.0], [1.0], [2.0]]), np.log(np.full(3, 1 / 3)))
    weighed, effective = particle.update(cloud, lambda s: s, np.array([1e4]), np.array([1.0]), np.random.default_rng(0), 0.0)
    np.testing.assert_allclose(weighed.weights, [0, 0, 1], atol=1e-12)
    assert effective == pytest.approx(1.0)


def test_full_noise_matrix_and_diagonal_agree() -> None:
    predicted = np.random.default_rng(0).standard_normal((4, 10, 2))
    for y in Y:
        np.testing.assert_allclose(
            particle.log_likelihood(predicted, y, np.diag(R)), particle.log_likelihood(predicted, y, R), rtol=rounding(1, 10)
        )
    correlated = np.array([[0.2, 0.1], [0.1, 0.5]])
    d = Y[0] - predicted
    expected = -0.5 * np.einsum("...i,ij,...j->...", d, np.linalg.inv(correlated), d)
    cond = float(np.linalg.cond(correlated))
    np.testing.assert_allclose(particle.log_likelihood(predicted, Y[0], correlated), expected, rtol=rounding(cond, 10))


@given(
    weights=arrays(float, st.tuples(st.integers(1, 3), st.integers(2, 30)), elements=st.floats(0, 1)),
    offset=st.floats(0, 1, exclude_max=True),
)
def test_systematic_resampling_takes_each_member_by_its_weight_rounded(weights: Array, offset: float) -> None:
    weights[:, 0] += 1e-3
    weights = weights / weights.sum(-1, keepdims=True)
    size = weights.shape[-1]
    index = particle.systematic(weights, np.full(len(weights), offset))
    assert index.shape == weights.shape and np.all(np.diff(index, axis=-1) >= 0)
    for row, w in zip(index, weights, strict=True):
        counts = np.bincount(row, minlength=size)
        assert np.all(np.abs(counts - size * w) < 1 + 1e-9)


def test_systematic_resampling_is_unbiased() -> None:
    """Over equally spaced offsets every member is taken M w_i times on average, up to the spacing."""
    w = np.array([0.05, 0.0, 0.33, 0.12, 0.5])
    offsets = (np.arange(1000) + 0.5) / 1000
    index = particle.systematic(np.broadcast_to(w, (1000, 5)), offsets)
    np.testing.assert_allclose((index[..., None] == np.arange(5)).sum(-2).mean(0), 5 * w, atol=2 / 1000)


def test_without_readings_weights_stay_and_the_stream_moves_on_alike() -> None:
    rng, other = np.random.default_rng(0), np.random.default_rng(0)
    cloud = particle.start(np.zeros(2), np.eye(2), 50, rng, (3,))
    particle.start(np.zeros(2), np.eye(2), 50, other, (3,))
    same, effective = particle.update(cloud, h, np.full(2, NAN), R, rng)
    particle.update(cloud, h, np.full(2, 5.0), R, other)
    assert rng.random() == other.random()
    np.testing.assert_allclose(same.log_weights, cloud.log_weights, rtol=0, atol=rounding(np.log(50), 50))
    np.testing.assert_allclose(effective, 50.0)
    x, P = np.ones((3, 2)), np.broadcast_to(np.eye(2), (3, 2, 2))
    kept = particle.gaussian_update(x, P, h, np.full(2, NAN), R, 50, rng)
    np.testing.assert_array_equal(kept[0], x)
    np.testing.assert_array_equal(kept[1], P)


def test_members_outside_the_model_get_no_weight_and_a_lost_batch_element_is_nan_alone() -> None:
    rng = np.random.default_rng(0)
    cloud = particle.start(np.zeros(2), np.eye(2), 20, rng, (2,))
    members = cloud.members.copy()
    members[0, :5], members[1] = NAN, NAN
    weighed, _ = particle.update(Particles(members, cloud.log_weights), h, np.zeros(2), R, rng, threshold=1.0)
    x, P = weighed.moments
    assert np.isfinite(x[0]).all() and np.isfinite(P[0]).all() and np.isfinite(weighed.members[0]).all()
    inside = particle.weigh(Particles(cloud.members[0, 5:], np.full(15, -np.log(15))), h(cloud.members[0, 5:]), np.zeros(2), R)
    counts = np.sum(np.all(weighed.members[0][:, None] == cloud.members[0, 5:], axis=-1), axis=0)
    assert np.all(np.abs(counts - 20 * inside.weights) < 1 + 1e-9)  # resampled from those inside alone, by their weights
    assert np.isnan(x[1]).all() and np.isnan(weighed.effective_size[1])


def test_too_few_particles() -> None:
    with pytest.raises(ValueError, match="1 particles; a covariance needs at least 2"):
        particle.start(np.zeros(2), np.eye(2), 1, np.random.default_rng(0))
