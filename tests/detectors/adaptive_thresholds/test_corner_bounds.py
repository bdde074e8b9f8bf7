"""Slopes proved over an envelope: exact where known, few boxes where they vanish, proved once; unbounded slopes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from fusion_sfdia.detectors.adaptive_thresholds import corner_bounds
from fusion_sfdia.detectors.adaptive_thresholds.corner_bounds import prove, slopes


def test_slopes_of_a_known_function_are_proved() -> None:
    low, high = np.array([1.0, -1.0, 0.5]), np.array([2.0, 1.0, 3.0])
    least, most = slopes(lambda a, b, c: a * a * c - b * c + b * b, low, high)
    # derivatives 2ac in [1, 12], 2b - c in [-5, 1.5], a^2 - b in [0, 5]
    assert np.all(least <= [1, -5, 0]) and np.all(most >= [12, 1.5, 5])
    np.testing.assert_allclose(least[[0, 2]], [1, 0], atol=1e-9)


def test_a_slope_that_vanishes_in_the_middle_takes_few_boxes() -> None:
    """The middle is an end of the halves, where rounding leaves both signs: the halving must end."""
    peak = lambda x, y: y * (1.0 - 0.25 * (x / 3.0 - 1.0) ** 2)  # noqa: E731
    least, most = slopes(peak, np.array([2.4, 1.0]), np.array([3.6, 2.0]), budget=40)
    steepest = 2.0 * 0.5 * 0.2 / 3.0  # at y = 2, x = 2.4 or 3.6
    np.testing.assert_allclose([least[0], most[0]], [-steepest, steepest], rtol=1e-9)


class Constant(NamedTuple):
    a: Any


def test_a_proof_is_made_once_unless_parameters_hold_arrays() -> None:
    def double(x: Any, c: Any) -> Any:
        return c.a * x

    ends = np.array([1.0]), np.array([2.0])
    prove({"y": double}, ("x",), *ends, Constant(2.0))
    before = corner_bounds._proved.cache_info()
    again = prove({"y": double}, ("x",), *ends, Constant(2.0))
    after = corner_bounds._proved.cache_info()
    assert (after.hits, after.misses) == (before.hits + 1, before.misses)
    other = prove({"y": double}, ("x",), *ends, Constant(np.array(-3.0)))
    assert corner_bounds._proved.cache_info() == after
    assert (again.signs[0, 0], other.signs[0, 0]) == (1.0, -1.0)
    np.testing.assert_allclose([again.size[0, 0], other.size[0, 0]], [2.0, 3.0])


def test_unbounded_slopes_are_rejected() -> None:
    table = {"y": lambda x, c: np.sqrt(x)}
    with pytest.raises(ValueError, match="equation of y has no bounded slope in x over the envelope"):
        prove(table, ("x",), np.array([0.0]), np.array([1.0]), None)
    with pytest.raises(ValueError, match="envelope of x is not a finite range"):
        prove(table, ("x",), np.array([1.0]), np.array([1.0]), None)
    with pytest.raises(ValueError, match="envelope of x is not a finite range"):
        prove(table, ("x",), np.array([1.0]), np.array([np.inf]), None)
