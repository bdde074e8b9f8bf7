"""What is the same for all runs of a batch is computed once, and has the bits that each run has alone."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from fusion_sfdia import simulate
from fusion_sfdia.common.alike import chosen, for_all, joined, repeated, shared_again, single
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.filters.estimators import Extended
from fusion_sfdia.plant.plant import Plant

ONE = np.arange(6.0).reshape(1, 2, 3)


def test_an_array_is_shared_until_its_runs_differ() -> None:
    shared = repeated(ONE, np.empty(4))
    assert shared.shape == (4, 2, 3)
    assert single(shared).shape == (1, 2, 3)
    own = shared.copy()
    assert single(own) is own
    assert single(ONE) is ONE
    assert repeated(own, np.empty(4)) is own


def test_runs_that_are_the_same_still_share_again() -> None:
    shared = repeated(ONE, np.empty(4))
    own = shared.copy()
    assert len(single(shared_again(own, shared))) == 1
    np.testing.assert_array_equal(shared_again(own, shared), shared)
    assert shared_again(own, own) is own
    own[3, 0, 0] += 1.0
    assert shared_again(own, shared) is own


def test_choosing_and_joining_runs_keeps_what_they_share() -> None:
    shared = repeated(ONE, np.empty(4))
    some = chosen(shared, np.array([0, 3]))
    assert some.shape == (2, 2, 3)
    assert len(single(some)) == 1
    assert len(single(joined(some, shared))) == 1
    assert joined(some, shared).shape == (6, 2, 3)
    other = joined(some, repeated(ONE + 1, np.empty(2)))
    assert single(other) is other
    assert np.array_equal(other, np.concatenate([some, shared[:2] + 1]))
    own = np.arange(5.0)
    assert np.array_equal(chosen(own, np.array([4, 1])), [4, 1])
    assert chosen(shared, np.array([], int)).shape == (0, 2, 3)


@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 3)])
def test_a_copy_for_all_runs_has_their_shape(batch: tuple[int, ...]) -> None:
    given = np.arange(3.0)
    found = for_all(given, batch)
    assert found.shape == (*batch, 3)
    assert np.all(found == given)
    assert not np.shares_memory(found, given)
    assert (single(found) is not found) == (batch == (3,))


@pytest.mark.parametrize("bank", [LeaveOneOutBank, partial(FusingBank, estimator=Extended(), thresholds=(np.inf,) * 94)])
def test_runs_of_a_linear_plant_share_covariances_and_have_their_own_bits(bank: Callable[[Plant], Detector]) -> None:
    """Until a reading is missing: then each run has its own."""
    plant = registry.plant("power-network")
    detector = bank(plant)
    recording = simulate(plant, 6, seeds=range(3))
    y, u = recording.y.copy(), recording.u_of_runs
    y[4, 1, 7] = np.nan
    state, alone = detector.init(3), [detector.init(1) for _ in range(3)]
    for k, t in enumerate(recording.t):
        state, decision = detector.step(state, float(t), y[k], u[k])
        covariance = getattr(state.memory, "estimate", state.memory).P
        assert (len(single(covariance)) == 1) == (k < 4)
        for b in range(3):
            alone[b], own = detector.step(alone[b], float(t), y[k, b : b + 1], u[k, b : b + 1])
            for seen, found in zip(
                (own.estimate, own.residual, own.threshold),
                (decision.estimate, decision.residual, decision.threshold),
                strict=True,
            ):
                assert seen.tobytes() == found[b : b + 1].tobytes()
