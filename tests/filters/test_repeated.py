"""Several sensors that read the same quantity: the same estimates as with the inverse of their whole covariance."""

from __future__ import annotations

import numpy as np
import pytest
from joints import of_update
from numpy.typing import NDArray

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.leave_one_out import posterior, statistics
from fusion_sfdia.filters import ekf
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.filters.repeated import repeated_readings

Array = NDArray[np.float64]
STATES, SENSORS, RUNS = 5, 18, 4  # enough sensors for statistics that are not written out


def joint_of(batch: tuple[int, ...], seed: int = 0) -> Joint:
    """Of sensors of 7 quantities: one read by 6 sensors, one by 1 alone, the others by 2 or 3."""
    rng = np.random.default_rng(seed)
    group = np.array([0, 1, 2, 0, 3, 4, 0, 5, 1, 2, 0, 3, 4, 0, 6, 1, 0, 3])
    root = rng.normal(size=(*batch, STATES, STATES))
    P = root @ np.swapaxes(root, -1, -2) + np.eye(STATES)
    H, R, x = rng.normal(size=(7, STATES))[group], rng.uniform(0.5, 2.0, SENSORS), rng.normal(size=(*batch, STATES))
    found = repeated_readings(group, H, R)
    assert found is not None and found.quantities == 7
    return ekf.joint(x, P, lambda s: s @ H.T, H, R)._replace(repeated=found)


def uses(batch: tuple[int, ...]) -> Array:
    """All readings; all but one quantity's; but the first of its quantity; none."""
    used = np.ones((RUNS, SENSORS), bool)
    used[1, [7, 14]], used[2, [0, 1, 5]], used[3] = False, False, False
    return used if batch == (RUNS,) else used[2:3]


@pytest.mark.parametrize("batch", [(1,), (RUNS,)], ids=str)
def test_statistics_and_estimates_are_those_of_the_whole_covariance(batch: tuple[int, ...]) -> None:
    joint, used = joint_of(batch), uses(batch)
    y = joint.y + np.random.default_rng(1).normal(size=joint.y.shape) * 3
    found, whole = statistics(joint, y, used), statistics(joint._replace(repeated=None), y, used)
    close = {"rtol": 0, "atol": of_update(joint, y)}
    assert found.half is not None and found.scores is not None and whole.scores is not None
    np.testing.assert_allclose(found.inverse, whole.inverse, **close)
    np.testing.assert_allclose(found.whitened, whole.whitened, **close)
    np.testing.assert_allclose(found.weight, whole.weight, **close)
    np.testing.assert_allclose(np.sum(found.scores**2, axis=-1), np.sum(whole.scores**2, axis=-1), **close)
    np.testing.assert_allclose(found.half @ np.swapaxes(found.half, -1, -2), found.inverse, **close)
    np.testing.assert_allclose((joint.C @ found.half)[..., found.rank :], 0.0, **close)
    for a, b in zip(posterior(joint, found), posterior(joint, whole), strict=True):
        np.testing.assert_allclose(a, b, **close)


def test_a_run_has_the_bits_it_has_alone() -> None:
    joint, used = joint_of((RUNS,)), uses((RUNS,))
    y = joint.y + 1.0
    together = statistics(joint, y, used)
    for r in range(RUNS):
        of = slice(r, r + 1)
        one = joint._replace(x=joint.x[of], P=joint.P[of], y=joint.y[of], S=joint.S[of], C=joint.C[of])
        alone = statistics(one, y[of], used[of])
        for name in ("whitened", "weight", "inverse", "used", "half", "scores"):
            np.testing.assert_array_equal(getattr(together, name)[of], getattr(alone, name))
        for a, b in zip(posterior(joint, together), posterior(one, alone), strict=True):
            np.testing.assert_array_equal(a[of], b)


def test_rows_that_are_no_longer_the_same_are_taken_one_by_one() -> None:
    plant = registry.plant("power-network")
    group, H = plant.same_readings, plant.output_jacobian_at(0.0, plant.x0, plant.input_at(0.0))
    assert group is not None and group.max() + 1 == len(plant.states) < len(plant.sensors)
    assert repeated_readings(group, H, plant.sensor_cov) is not None
    other = H.copy()
    other[-1] *= 1.5
    assert repeated_readings(group, other, plant.sensor_cov) is None
    assert repeated_readings(group, np.stack([H, H]), plant.sensor_cov) is None
    assert registry.plant("gas-pipeline").same_readings is None
