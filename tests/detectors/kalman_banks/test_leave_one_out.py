"""The leave-one-out algebra and the mixture against filters that leave out a sensor."""

from __future__ import annotations

import numpy as np
import pytest
from joints import of_update, random_joint
from toy_plants import chain, tanks

from fusion_sfdia.detectors.kalman_banks.leave_one_out import (
    eliminate,
    local_estimates,
    normalised_innovation_squared,
    posterior,
    posterior_and_gain,
    statistics,
)
from fusion_sfdia.filters import ekf
from fusion_sfdia.filters.gaussian import Joint, gain

SHAPES = (("P", (4, 4)), ("S", (6, 6)), ("C", (4, 6)))


def without(joint: Joint, y: np.ndarray, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Textbook update with row i deleted from everything."""
    keep = np.delete(np.arange(y.size), i)
    gain = joint.C[:, keep] @ np.linalg.inv(joint.S[np.ix_(keep, keep)])
    return joint.x + gain @ (y - joint.y)[keep], joint.P - gain @ joint.C[:, keep].T


@pytest.mark.parametrize(("n", "count"), [(3, 5), (6, 6), (8, 4)])
def test_every_local_filter_equals_the_one_that_deletes_its_sensor(n: int, count: int) -> None:
    rng = np.random.default_rng(n)
    joint, _ = random_joint(rng, n, count)
    y = joint.y + rng.normal(size=count) * 3
    found = statistics(joint, y, np.ones(count, bool))
    tolerance = of_update(joint, y)
    local, gains = local_estimates(joint, found)
    _, p_all = posterior(joint, found)
    for i in range(count):
        x, p = without(joint, y, i)
        np.testing.assert_allclose(local[i], x, rtol=0, atol=tolerance)
        np.testing.assert_allclose(p_all + np.outer(gains[i], gains[i]) / found.weight[i], p, rtol=0, atol=tolerance)
        keep = np.delete(np.arange(count), i)
        conditional = joint.y[i] + joint.S[i, keep] @ np.linalg.solve(joint.S[np.ix_(keep, keep)], (y - joint.y)[keep])
        assert found.innovation[i] == pytest.approx(y[i] - conditional, rel=0, abs=tolerance)


@pytest.mark.parametrize("count", [5, 20])
def test_the_gain_is_that_of_the_inverse_with_and_without_all_readings(count: int) -> None:
    rng = np.random.default_rng(count)
    joint, _ = random_joint(rng, 4, count)
    joint = joint._replace(considered=np.array([1]))
    y = joint.y + rng.normal(size=count) * 3
    tolerance = of_update(joint, y)
    for used in (np.ones(count, bool), np.arange(count) != 2):
        found = statistics(joint, y, used)
        x, p, K = posterior_and_gain(joint, found)
        for same, expected in zip((x, p), posterior(joint, found), strict=True):
            np.testing.assert_array_equal(same, expected)
        np.testing.assert_allclose(K, gain(joint, found.inverse), rtol=0, atol=tolerance)
        assert not K[1].any() and not K[:, ~used].any()


@pytest.mark.parametrize("shared", [False, True])
def test_few_states_of_a_batch_are_updated_as_those_of_each_run(shared: bool) -> None:
    """The products of a batch are written out; those of a single update are NumPy's."""
    rng = np.random.default_rng(3)
    joint, _ = random_joint(rng, 4, 6, batch=(3,))
    if shared:
        joint = joint._replace(**{name: np.broadcast_to(getattr(joint, name)[:1], (3, *shape)) for name, shape in SHAPES})
    y = joint.y + rng.normal(size=(3, 6))
    used = np.ones((3, 6), bool)
    used[1, 2] = shared  # else a run leaves out a reading
    together = statistics(joint, y, used)
    gone = eliminate(together, np.array([0, 1, 5]), np.array([True, False, True]))
    for found, out in ((together, [(), (), ()]), (gone, [(0,), (), (5,)])):
        x, p, K = posterior_and_gain(joint, found)
        for same, expected in zip((x, p), posterior(joint, found), strict=True):
            np.testing.assert_array_equal(same, expected)
        for r in range(3):
            one = Joint(*(a[r] for a in joint[:5]))
            alone = statistics(one, y[r], used[r] & ~np.isin(np.arange(6), out[r]))
            for value, expected in zip((x, p, K), posterior_and_gain(one, alone), strict=True):
                np.testing.assert_allclose(value[r], expected, rtol=0, atol=of_update(joint, y, 3))


@pytest.mark.parametrize("n", [1, 4, 12])
def test_covariances_stay_positive_definite_under_precise_readings(n: int) -> None:
    """Readings 1e-6 of the prior's standard deviation, 50 updates without noise: each subtracts nearly all of P."""
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    p, h, r = root @ root.T + np.eye(n), rng.normal(size=(n, n)), np.full(n, 1e-12)
    for _ in range(50):
        joint = ekf.joint(np.zeros(n), p, lambda s: s @ h.T, h, r)
        _, p = posterior(joint, statistics(joint, rng.normal(size=n), np.ones(n, bool)))
        size = np.sqrt(np.diagonal(p))
        assert np.linalg.eigvalsh(p / np.outer(size, size))[0] > 0


def test_a_missing_reading_equals_a_deleted_one() -> None:
    rng = np.random.default_rng(0)
    joint, _ = random_joint(rng, 4, 6, batch=(1,))
    y, used = joint.y + rng.normal(size=(1, 6)), np.ones((1, 6), bool)
    gone = y.copy()
    gone[0, 2] = np.nan
    found = statistics(joint, gone, used)
    one = joint._replace(x=joint.x[0], P=joint.P[0], y=joint.y[0], S=joint.S[0], C=joint.C[0])
    for got, expected in zip(posterior(joint, found), without(one, y[0], 2), strict=True):
        np.testing.assert_allclose(got[0], expected, rtol=0, atol=of_update(one, y[0]))
    assert found.innovation[0, 2] == 0 and np.isinf(found.variance[0, 2]) and np.all(np.isfinite(found.chi_square))
    nothing = statistics(joint, np.full((1, 6), np.nan), used)
    np.testing.assert_array_equal(posterior(joint, nothing)[0], joint.x)
    assert normalised_innovation_squared(joint, nothing, np.full((1, 6), np.nan)) == 0
    keep = np.delete(np.arange(6), 2)
    d = (y - joint.y)[0, keep]
    nis = d @ np.linalg.solve(one.S[np.ix_(keep, keep)], d) / 5
    assert normalised_innovation_squared(joint, found, gone)[0] == pytest.approx(nis, rel=0, abs=of_update(one, y[0]))


def test_elimination_equals_starting_without_the_sensors_in_any_order() -> None:
    rng = np.random.default_rng(1)
    joint, _ = random_joint(rng, 5, 7, batch=(3,))
    y = joint.y + rng.normal(size=(3, 7)) * 2
    everything = statistics(joint, y, np.ones((3, 7), bool))
    where = np.array([True, True, False])
    once = eliminate(everything, np.array([4, 1, 2]), where)
    twice = eliminate(once, np.array([0, 6, 2]), where)
    assert not once.inverse[0, 4].any() and not once.inverse[0, :, 4].any() and once.inverse[2, 4].all()
    for i, gone in enumerate([(4, 0), (1, 6), ()]):
        used = ~np.isin(np.arange(7), gone)
        direct = statistics(Joint(*(a[i] for a in joint[:5])), y[i], used)
        for name in ("whitened", "weight", "inverse", "used"):
            got, expected = getattr(twice, name)[i], getattr(direct, name)
            np.testing.assert_allclose(got, expected, rtol=0, atol=of_update(joint, y, 3))


def test_chi_square_is_chi_square_with_one_degree_of_freedom() -> None:
    rng = np.random.default_rng(2)
    joint, _ = random_joint(rng, 4, 6)
    runs = 20000
    y = rng.multivariate_normal(joint.y, joint.S, size=runs)
    chi_square = statistics(
        Joint(*(np.broadcast_to(a, (runs, *a.shape)) for a in joint[:5])), y, np.ones((runs, 6), bool)
    ).chi_square
    # mean 1, variance 2 each: four standard errors
    assert np.all(np.abs(chi_square.mean(axis=0) - 1) < 4 * np.sqrt(2 / runs))
    assert abs(np.mean(chi_square > 6.634896601021214) - 0.01) < 4 * np.sqrt(0.01 * 0.99 / (6 * runs)) * 2  # sensors correlate


def test_toy_plants_have_the_jacobians_of_their_functions() -> None:
    for plant in (chain(5), tanks()):
        x, u = plant.x0 + 0.1, plant.input_at(0.0)
        step = 1e-6
        for jacobian, function in (
            (plant.step_jacobian_at(0.0, x, u, plant.dt), lambda s, p=plant, u=u: p.step(0.0, s, u, p.dt)),
            (plant.output_jacobian_at(0.0, x, u), lambda s, p=plant, u=u: p.output(0.0, s, u)),
        ):
            differences = np.stack(
                [(function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(x.size)], axis=-1
            )
            np.testing.assert_allclose(jacobian, differences, rtol=1e-7, atol=1e-9)


def test_a_reading_without_noise_leaves_a_positive_variance() -> None:
    """p - p^2 / (p + r) rounds to 0 or below for r far below p eps; four times its rounding is added."""
    p = np.random.default_rng(7).uniform(0.1, 10.0, (500, 1, 1))
    joint = Joint(np.zeros((500, 1)), p, np.zeros((500, 1)), p + 1e-20, p)
    _, after = posterior(joint, statistics(joint, np.ones((500, 1)), np.ones((500, 1), bool)))
    assert np.all(after > 0) and np.all(after < 16 * np.finfo(float).eps * p)
