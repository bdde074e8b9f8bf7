"""Bounds from signs of partial derivatives: never narrower than the range, tight to rounding where the function is monotone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.derivatives.intervals.expression import record
from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.derivatives.intervals.interval_kernels import KERNELS
from fusion_sfdia.derivatives.intervals.monotone import DERIVATIVES, gradient, monotone_hull

SMOOTH: dict[str, Callable[..., Any]] = {
    "flow": lambda x, y, z: x * np.sqrt(y**2 + z) / (y + z),
    "powers": lambda x, y, z: x**1.4 * y**-0.3 - z**3 + x**-2,
    "library": lambda x, y, z: np.exp(-x * y) + np.log(z) * np.tanh(x) + np.log10(y) - np.log1p(z) * np.expm1(-y),
    "waves": lambda x, y, z: np.sin(x * y) + np.cos(z) - np.arctanh(x / 20),
    "repeated": lambda x, y, z: x * (1 - x) * y / (x + z) + z * y,
    "exponent": lambda x, y, z: x**y + np.square(z - 2.0) + np.reciprocal(x + y),
}
KINKED: dict[str, Callable[..., Any]] = {
    "kinks": lambda x, y, z: abs(x - y) + np.minimum(z, x) * np.maximum(y, 1.5) + np.positive(-z),
    "flat": lambda x, y, z: 3.0,
    "partial": lambda x, y, z: np.sqrt(x - y) + z,
    "pole": lambda x, y, z: z / (x - y),
}


def boxes(seed: int, n: int = 400) -> Interval:
    """Around positive points, from narrow to wide."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(0.5, 3, (n, 3))
    radius = middle * rng.choice([0.0, 1e-9, 0.02, 0.1, 0.5], (n, 1)) * rng.uniform(0.2, 1, (n, 3))
    return Interval(middle - radius, middle + radius)


@pytest.mark.parametrize("pieces", [1, 3])
@pytest.mark.parametrize("name", SMOOTH | KINKED)
def test_the_hull_contains_the_range(name: str, pieces: int) -> None:
    function = (SMOOTH | KINKED)[name]
    box = boxes(1)
    found = monotone_hull(function, box, pieces)
    assert found.shape == (400,)
    assert np.all(function(*(box[:, i] for i in range(3))).contains(found)) if name != "flat" else found.contains(3.0).all()
    rng = np.random.default_rng(2)
    for _ in range(100):
        share = rng.choice([0.0, 0.3, 1.0], box.shape) if rng.uniform() < 0.5 else rng.uniform(size=box.shape)
        x = np.clip(box.lo + share * (box.hi - box.lo), box.lo, box.hi)
        with np.errstate(all="ignore"):
            y = function(*x.T)
        slack = 1e-13 * (1 + np.abs(y))  # roundings of the sample itself, at most some tens
        assert np.all(~np.isfinite(y) | ((found.lo <= y + slack) & (y - slack <= found.hi)))


def test_monotone_functions_are_bounded_by_corners_to_rounding() -> None:
    """At 5 % around the nominal point every sign is proved, though x and y appear twice."""
    nominal = np.array([2.0, 3.0, 0.5])
    box = Interval(0.95 * nominal, 1.05 * nominal)

    def function(x: Any, y: Any, z: Any) -> Any:
        return x * y / (x + y) * z**2 - z / x

    natural, tight = function(*(box[i] for i in range(3))), monotone_hull(function, box)
    ends = [function(*0.95 * nominal), function(*1.05 * nominal)]
    np.testing.assert_allclose([tight.lo, tight.hi], ends, rtol=1e-13)
    assert tight.width < 0.6 * natural.width


def test_pieces_prove_more_signs() -> None:
    """x y / (x + y) rises in both; over the whole of a wide box the interval derivatives do not show it."""
    box = Interval([1.0, 2.0], [2.0, 3.0])
    whole, parts = (monotone_hull(lambda x, y: x * y / (x + y), box, pieces) for pieces in (1, 4))
    np.testing.assert_allclose([parts.lo, parts.hi], [2 / 3, 6 / 5], rtol=1e-14)
    assert whole.contains(parts)
    assert whole.width > 1.5 * parts.width


def test_a_sign_that_changes_inside_the_box_is_not_proved() -> None:
    """x (1 - x) rises at the middle of [0.2, 0.7] but peaks inside: corners alone would miss 1/4."""
    found = monotone_hull(lambda x: x * (1 - x), Interval([0.2], [0.7]))
    assert found.contains([0.16, 0.25]).all()


@pytest.mark.parametrize("name", SMOOTH)
def test_interval_derivatives_contain_the_derivatives(name: str) -> None:
    """Against the complex step, exact to rounding."""
    box, function = boxes(3), SMOOTH[name]
    expression = record(function, 3)
    slopes = gradient(expression, expression.evaluate([box[:, i] for i in range(3)]))
    rng = np.random.default_rng(4)
    for _ in range(20):
        x = np.clip(box.lo + rng.uniform(size=box.shape) * (box.hi - box.lo), box.lo, box.hi)
        jacobian = complex_step_jacobian(lambda x: function(*np.moveaxis(x, -1, 0))[..., None], x)[:, 0]
        for i, slope in enumerate(slopes):
            slack = 1e-12 * (1 + np.abs(jacobian[:, i]))
            assert np.all((slope.lo <= jacobian[:, i] + slack) & (jacobian[:, i] - slack <= slope.hi))


def test_a_batch_is_a_loop_to_the_bit() -> None:
    box = boxes(5, 40)
    for i, function in enumerate((SMOOTH | KINKED).values()):
        whole = monotone_hull(function, box, 1 + i % 2)
        for k in range(40):
            one = monotone_hull(function, box[k], 1 + i % 2)
            np.testing.assert_array_equal([one.lo, one.hi], [whole.lo[k], whole.hi[k]])


def test_every_function_has_its_derivative() -> None:
    assert set(DERIVATIVES) == set(KERNELS)


def test_bad_input_is_rejected() -> None:
    with pytest.raises(ValueError, match="pieces is 0"):
        monotone_hull(lambda x: x, Interval([0.0], [1.0]), pieces=0)
    with pytest.raises(ValueError, match="the function has 2 results; expected 1: bound one at a time"):
        monotone_hull(lambda x: (x, x), Interval([0.0], [1.0]))
