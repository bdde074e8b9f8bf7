"""States within limits, and numbers that are finite, are those that NumPy finds."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.plant.limits import finite, within

VALUES = np.array([-2.0, -1.0, 0.5, 1.0, 3.0, np.nan, np.inf, -np.inf])
LOW, HIGH = np.array([-1.0, -np.inf, 0.0]), np.array([1.0, 2.0, np.inf])


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_states_are_moved_as_by_numpy(batch: tuple[int, ...]) -> None:
    x = np.random.default_rng(0).choice(VALUES, (*batch, 3))
    inside, moved = within(x, LOW, HIGH)
    expected = np.minimum(np.maximum(x, LOW), HIGH)
    np.testing.assert_array_equal(inside, expected)
    np.testing.assert_array_equal(moved, (expected != x).any(axis=-1))
    np.testing.assert_array_equal(finite(x), np.isfinite(x).all(axis=-1))


def test_runs_that_share_a_state_are_moved_alike() -> None:
    x = np.broadcast_to(np.array([2.0, 0.0, 1.0]), (5, 3))
    inside, moved = within(x, LOW, HIGH)
    assert moved.all() and (inside == [1.0, 0.0, 1.0]).all() and finite(x).all()
