"""Compiled loops of the banks give what the library gives."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from toy_plants import Array, tanks

from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.kalman_banks import leave_one_out
from fusion_sfdia.detectors.kalman_banks.leave_one_out import statistics
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.robust_bank import RobustBank
from fusion_sfdia.detectors.kalman_banks.window_kernels import subtract_product
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.plant.plant import Plant

EPS = np.finfo(float).eps


@pytest.fixture
def library() -> Iterator[pytest.MonkeyPatch]:
    """Within its context all products are left to the library."""
    with pytest.MonkeyPatch.context() as patch:
        yield patch


def _to_the_library(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(leave_one_out, "WRITTEN_OUT", 0)


def test_statistics_are_those_of_the_inverse(library: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((6, 5, 5)) * [1e-3, 1.0, 1e2, 1e5, 1.0]
    S = root.swapaxes(-1, -2) @ root
    S[5] = -np.eye(5)  # no covariance: NaN there alone
    y, used = rng.standard_normal((6, 5)), rng.random((6, 5)) < 0.8
    joint = Joint(np.zeros((6, 1)), np.ones((6, 1, 1)), np.zeros((6, 5)), S, np.zeros((6, 1, 5)))
    found = statistics(joint, y, used)
    _to_the_library(library)
    expected = statistics(joint, y, used)
    whole = np.ones(6, bool)
    whole[5] = False
    scale = np.sqrt(np.diagonal(S[whole], axis1=-2, axis2=-1))
    unit = np.linalg.cond(S[whole] / (scale[..., :, None] * scale[..., None, :])).max()
    for name, factor in (("whitened", scale), ("weight", scale**2), ("inverse", scale[..., None] * scale[..., None, :])):
        a, b = getattr(found, name)[whole] * factor, getattr(expected, name)[whole] * factor
        np.testing.assert_allclose(a, b, atol=50 * EPS * unit * np.abs(b).max())
    assert found.half is not None
    product = found.half @ found.half.swapaxes(-1, -2)
    np.testing.assert_allclose(product[whole], found.inverse[whole], rtol=1e-12, atol=0)
    assert not found.weight[whole][~used[whole]].any() and np.isnan(found.weight[5][used[5]]).all()


@pytest.mark.parametrize("share", [0.0, 0.05, 1.0])
def test_a_product_by_entries_is_that_of_the_library(share: float) -> None:
    rng = np.random.default_rng(0)
    A, B = rng.standard_normal((6, 12)), rng.standard_normal((6, 9))
    H = rng.standard_normal((9, 10)) * (rng.random((9, 10)) < share)
    expected = A.copy()
    expected[:, :10] -= B @ H
    largest = float((np.abs(A[:, :10]) + np.abs(B) @ np.abs(H)).max())
    subtract_product(A, B, H, np.empty((6, 10)))
    np.testing.assert_allclose(A, expected, rtol=0, atol=20 * EPS * largest)


def _faulty(plant: Plant) -> tuple[Array, Array, Array]:
    healthy = simulate(plant, 100, [1, 2], truth="model")
    y = healthy.y.copy()
    y[50:70, 0, 1] += 6.0 * plant.sensor_sigma[1]
    y[60:, 1, 3] += 4.0 * plant.sensor_sigma[3]
    y[10:15, 1, 0] = np.nan
    return healthy.t, y, healthy.u


@pytest.mark.parametrize("bank", [LeaveOneOutBank, RobustBank])
def test_a_bank_decides_as_by_the_library(bank: type[LeaveOneOutBank] | type[RobustBank], library: pytest.MonkeyPatch) -> None:
    plant = tanks()
    data = _faulty(plant)

    def decisions() -> Decision:
        detector = bank(plant)
        return run(detector, detector.init((2,), t=-plant.dt), *data)[1]

    found = decisions()
    _to_the_library(library)
    expected = decisions()
    assert expected.isolated[55, 0, 1] and expected.isolated[-1, 1, 3]
    np.testing.assert_array_equal(found.isolated, expected.isolated)
    scale = np.abs(expected.residual).max(axis=(0, 1))
    np.testing.assert_allclose(found.residual / scale, expected.residual / scale, rtol=0, atol=1e3 * np.finfo(np.float32).eps)
