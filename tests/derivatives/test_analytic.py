"""Functions that are not analytic are found and named, on branches not taken, too; what only decides is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from toy_plants import Array, chain

from fusion_sfdia.derivatives.analytic import KINK, REFUSED, WRONG, non_analytic
from fusion_sfdia.derivatives.equation import difference_jacobian

X = np.array([[1.0, 2.0], [0.5, 3.0]])


def hidden_abs(x: Array) -> Array:
    return np.where(x > 10, abs(x - 10), 0.0) + x


def filled(x: Array) -> Array:
    out = np.empty_like(x)
    out[..., 0] = np.sign(x[..., 1])
    out[..., 1] = 1.0
    return out


def squared_in_place(x: Array) -> Array:
    x = x.copy()
    x *= x.conj()
    return x


def by_contraction(x: Array) -> Array:
    for _ in range(50):
        if not np.any(np.abs(x.real) > 1e-3):  # |x| only decides
            break
        x = 0.5 * x
    return x


@pytest.mark.parametrize(
    ("function", "names", "effect"),
    [
        (lambda x: np.abs(x), {"absolute"}, WRONG),
        (filled, {"sign"}, WRONG),
        (lambda x: x.real + 1, {"real"}, WRONG),
        (lambda x: 1 - np.imag(x), {"imag"}, WRONG),
        (squared_in_place, {"conjugate"}, WRONG),
        (lambda x: np.round(x, 2), {"round"}, WRONG),
        (lambda x: x.astype(float), {"astype"}, WRONG),
        (lambda x: np.stack([np.floor(x[..., 0]), x[..., 1]], axis=-1), {"floor"}, REFUSED),
        (lambda x: np.interp(x, [0, 1, 2], [0, 1, 4]), {"interp"}, REFUSED),
        (lambda x: np.hypot(x[..., :1], x[..., 1:]), {"hypot"}, REFUSED),
        (lambda x: np.maximum(x, 0), {"maximum"}, KINK),
        (lambda x: x.max(axis=-1, keepdims=True), {"maximum"}, KINK),
        (lambda x: np.minimum.reduce(x, axis=-1), {"minimum"}, KINK),
        (lambda x: x.clip(0, 1), {"clip"}, KINK),
        (lambda x: np.where(x < 0, -x, x), {"less", "where"}, KINK),
        (lambda x: x * (x >= 0), {"greater_equal"}, KINK),
        (lambda x: np.sqrt(x) @ np.ones((2, 2)) + np.einsum("...i->...", x)[..., None], set(), ""),
        (by_contraction, set(), ""),
        (lambda x: np.where(np.abs(x) > 2, 2 * x, x), {"greater", "where"}, KINK),
    ],
)
def test_a_function_that_is_not_analytic_is_named(function: Callable[[Array], Array], names: set[str], effect: str) -> None:
    found = non_analytic(function, X)
    assert {use.name for use in found} == names
    assert {use.effect for use in found} <= {effect}
    assert all(use.place.startswith("test_analytic.py:") for use in found)


def test_the_branch_that_is_not_taken_counts() -> None:
    found = non_analytic(hidden_abs, X)
    assert {use.name for use in found} == {"absolute", "greater", "where"}
    assert str(found[0]) == f"abs (test_analytic.py:{hidden_abs.__code__.co_firstlineno + 1})"


def test_a_function_that_fails_has_none() -> None:
    assert non_analytic(lambda x: x.nothing, X) == ()


def backwards(t: float, x: Array, u: Array, dt: float) -> Array:
    """A flow that reverses above 3, far from x0 = 0."""
    return x - 0.1 * np.where(x > 3, np.abs(x - 4), x)


def test_the_jacobian_is_right_where_a_branch_with_abs_is_taken() -> None:
    plant = chain(2)
    plant = replace(plant, step=backwards, numerics=replace(plant.numerics, step_jacobian=None))
    x, u = np.array([3.5, 5.0]), np.zeros(0)
    expected = difference_jacobian(lambda p: plant.step(0.0, p, u, 1.0), x, plant.state_scale)
    np.testing.assert_allclose(plant.step_jacobian_at(0.0, x, u, 1.0), expected, rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.diag(expected), [1.1, 0.9], rtol=0, atol=1e-8)
