"""The mixture of the leave-one-out filters in closed form against the printed sum of inverses."""

from __future__ import annotations

import numpy as np
import pytest
from joints import of_update, random_joint

from fusion_sfdia.detectors.kalman_banks import mixing
from fusion_sfdia.detectors.kalman_banks.leave_one_out import (
    posterior,
    statistics,
)
from fusion_sfdia.filters import ekf
from fusion_sfdia.filters.gaussian import Joint


@pytest.mark.parametrize("missing", [(), (1,), (0, 3, 4)])
def test_mixture_in_closed_form_equals_the_printed_sum_of_inverses(missing: tuple[int, ...]) -> None:
    rng = np.random.default_rng(3)
    joint, r = random_joint(rng, 5, 6)
    y = joint.y + rng.normal(size=6)
    y[list(missing)] = np.nan
    used = np.isfinite(y)
    parts = []
    for i in range(6):
        found = statistics(joint, y, used & (np.arange(6) != i))
        parts.append(posterior(joint, found))
    x, p = mixing.mix(np.stack([a for a, _ in parts]), np.stack([b for _, b in parts]), np.ones(5))
    close = mixing.mixture(joint, y, used, r)[:2]
    general = mixing.mixture_of_any_joint(joint, statistics(joint, y, used))
    tolerance = np.linalg.cond(p) * of_update(joint, y)  # both invert the mixture's covariance
    np.testing.assert_array_equal(general[1], general[1].T)
    for got_x, got_p in (close, general):
        np.testing.assert_allclose(got_x, x, rtol=0, atol=tolerance)
        np.testing.assert_allclose(got_p, p, rtol=0, atol=tolerance)


def test_a_state_without_variance_stays_as_it_is_and_changes_nothing_else() -> None:
    joint, _ = random_joint(np.random.default_rng(6), 4, 5)
    wide = [np.insert(joint.x, 2, 7.0), np.insert(np.insert(joint.P, 2, 0.0, -1), 2, 0.0, -2), np.insert(joint.C, 2, 0.0, 0)]
    y = joint.y + 1.0
    found = statistics(joint, y, np.ones(5, bool))
    x, p = mixing.mixture_of_any_joint(joint, found)
    more_x, more_p = mixing.mixture_of_any_joint(Joint(wide[0], wide[1], joint.y, joint.S, wide[2]), found)
    rest = np.arange(5) != 2
    assert more_x[2] == 7.0 and not more_p[2].any() and not more_p[:, 2].any()
    tolerance = np.linalg.cond(p) * of_update(joint, y)
    np.testing.assert_allclose(more_x[rest], x, rtol=0, atol=tolerance)
    np.testing.assert_allclose(more_p[np.ix_(rest, rest)], p, rtol=0, atol=tolerance)


def test_federated_factors_make_the_mixture_the_central_filter() -> None:
    """Carlson's information sharing: local priors N P and noises (N - 1) R fuse to the central filter with all readings."""
    rng = np.random.default_rng(4)
    joint, r = random_joint(rng, 5, 6)
    y = joint.y + rng.normal(size=6)
    h = np.linalg.solve(joint.P, joint.C).T
    wide = ekf.joint(joint.x, 6 * joint.P, lambda s: joint.y, h, 5 * r)
    x, p = mixing.mixture(wide, y, np.ones(6, bool), 5 * r)[:2]
    central_x, central_p = posterior(joint, statistics(joint, y, np.ones(6, bool)))
    tolerance = np.linalg.cond(joint.P) * of_update(joint, y)  # H was solved for with P
    np.testing.assert_allclose(x, central_x, rtol=0, atol=tolerance)
    np.testing.assert_allclose(p, central_p, rtol=0, atol=tolerance)


def test_mixture_of_singular_covariances_stays_on_their_range() -> None:
    """An ensemble smaller than the state: P has no inverse, the mixture still exists."""
    rng = np.random.default_rng(5)
    anomalies = rng.normal(size=(4, 9))
    anomalies -= anomalies.mean(axis=0)
    p = anomalies.T @ anomalies / 3
    r = np.ones(9)
    joint = Joint(np.zeros(9), p, np.zeros(9), p + np.diag(r), p)
    y = rng.normal(size=9)
    used = np.ones(9, bool)
    x, p_m = mixing.mixture(joint, y, used, r)[:2]
    parts = [posterior(joint, statistics(joint, y, np.arange(9) != i)) for i in range(9)]
    literal_x, literal_p = mixing.mix(np.stack([a for a, _ in parts]), np.stack([b for _, b in parts]), np.ones(9))
    assert np.linalg.matrix_rank(p_m, rtol=1e-9, hermitian=True) == 3
    ranged = np.linalg.eigvalsh(p)[-3:]  # the inverted part: P on its range, of rank 3
    tolerance = ranged[-1] / ranged[0] * of_update(joint, y)
    np.testing.assert_allclose(x, literal_x, rtol=0, atol=tolerance)
    np.testing.assert_allclose(p_m, literal_p, rtol=0, atol=tolerance)


def test_the_mixture_does_not_depend_on_the_units_of_the_states() -> None:
    """Two states, one in units 1e-6 times those of the other: directions with variances of 1e-12 are kept."""
    size = np.array([1.0, 1e-6])
    x, p = np.array([[1.0, 1.0], [3.0, 2.0]]), np.array([[[1.0, 0.5], [0.5, 2.0]], [[3.0, -1.0], [-1.0, 2.0]]])
    information = np.linalg.inv(p)
    expected = np.linalg.inv(information.sum(axis=0))
    found_x, found_p = mixing.mix(x * size, p * np.outer(size, size), size)
    np.testing.assert_allclose(found_x / size, expected @ np.einsum("ijk,ik->j", information, x), rtol=1e-12)
    np.testing.assert_allclose(found_p / np.outer(size, size), expected, rtol=1e-12)


@pytest.mark.parametrize("sensors", [4, 20])
def test_the_mixture_without_a_sensor_is_that_of_the_other_readings(sensors: int) -> None:
    rng = np.random.default_rng(sensors)
    n, batch = 3, 5
    root, H, r = rng.normal(size=(batch, n, n)), rng.normal(size=(batch, sensors, n)), rng.uniform(0.5, 2.0, sensors)
    P = root @ np.swapaxes(root, -1, -2)
    C = P @ np.swapaxes(H, -1, -2)
    x, y = rng.normal(size=(batch, n)), rng.normal(size=(batch, sensors))
    joint = Joint(x, P, (H @ x[..., None])[..., 0], H @ C + np.diag(r), C)
    used, sensor = np.ones((batch, sensors), bool), rng.integers(sensors, size=batch)
    used[:, 1] = sensor == 1  # a missing reading
    got = mixing.mixture_without(sensor, *mixing.mixture(joint, y, used, r), C)
    others = used & (np.arange(sensors) != sensor[:, None])
    for a, b in zip(got, mixing.mixture(joint, y, others, r)[:2], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-13)
