"""Checks that every plant passes. Tests of another package call them for its own plants:

def test_my_tank() -> None:
    check_plant(my_tank)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from fusion_sfdia import registry
from fusion_sfdia.checks.require import pickled
from fusion_sfdia.core.augment import augment
from fusion_sfdia.core.equation import difference_jacobian
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.simulate import simulate

Array = NDArray[Any]

STEPS = 20
ROUNDED = float(np.sqrt(np.finfo(float).eps))  # relative: far above rounding, far below the effect of exchanged axes
DIFFERENCED = 1e-4  # relative: far above the error of central differences, far below a wrong sign or factor


def check_plant(plant: Any) -> None:
    """Run PLANT_CHECKS on a plant, given as in `registry.find_plant`. Raises AssertionError or ValueError with the reason."""
    found = registry.plant(plant)
    for check in PLANT_CHECKS:
        check(found)


def batches_are_leading_axes(plant: Plant) -> None:
    """A batch of states is stepped and read as its members are one by one, and the given states stay unchanged."""
    x, u = _points(plant), plant.input_at(0.0)
    given = x.copy()
    for what, function in _functions(plant).items():
        together = function(x, u)
        alone = np.stack([function(point, u) for point in x])
        nested = function(x[:, None], u)[:, 0]
        scale = np.abs(alone).max(axis=0) + np.finfo(float).tiny
        for other, shape in ((alone, "(n,) each"), (nested, f"({len(x)}, 1, n)")):
            assert_allclose(
                together / scale, other / scale, rtol=0, atol=ROUNDED,
                err_msg=f"{what} of plant {plant.name!r}: states ({len(x)}, n) give other numbers than {shape}; "
                "write it for batches, which are leading axes",
            )  # fmt: skip
        assert_array_equal(x, given, err_msg=f"{what} of plant {plant.name!r} writes into the states it is given; copy them")


def jacobians_are_derivatives(plant: Plant) -> None:
    """The Jacobians of step and output agree with central differences, each row relative to its largest entry."""
    x = _points(plant)
    u = np.broadcast_to(plant.input_at(0.0), (len(x), len(plant.inputs)))
    jacobians = {
        "step": plant.step_jacobian_at(0.0, x, u, plant.dt),
        "output": np.broadcast_to(plant.output_jacobian_at(0.0, x, u), (len(x), len(plant.sensors), x.shape[-1])),
    }
    for what, function in _functions(plant).items():
        expected = difference_jacobian(partial(_at, function, plant.input_at(0.0)), x, plant.state_scale) * plant.state_scale
        scale = np.abs(expected).max(axis=-1, keepdims=True) + np.finfo(float).tiny
        assert_allclose(
            jacobians[what] * plant.state_scale / scale, expected / scale, rtol=0, atol=DIFFERENCED,
            err_msg=f"{what}_jacobian of plant {plant.name!r} is not the derivative of {what}; correct it or leave it out",
        )  # fmt: skip


def operation_is_within_limits(plant: Plant) -> None:
    """x0 and the usual inputs are within the limits of their signals."""
    low, high = plant.state_limits
    if not np.all((plant.x0 >= low) & (plant.x0 <= high)):
        raise AssertionError(f"x0 of plant {plant.name!r} is outside the limits of its states")
    for k in range(STEPS):
        for value, signal in zip(plant.input_at(k * plant.dt), plant.inputs, strict=True):
            if not signal.low <= value <= signal.high:
                raise AssertionError(
                    f"plant {plant.name!r}: the usual input {signal.name} is {value:g} {signal.unit} at {k * plant.dt:g} s; "
                    f"its limits are {signal.low:g} and {signal.high:g}"
                )


def readings_can_be_simulated(plant: Plant) -> None:
    """Healthy readings of both truths are finite, and the same for the same seed in any batch."""
    for truth in ("finer", "model"):
        both = simulate(plant, STEPS, [1, 2], truth=truth)
        if not np.isfinite(both.y).all():
            raise AssertionError(f"plant {plant.name!r}, truth {truth!r}: simulated readings are not finite")
        alone = simulate(plant, STEPS, [2], truth=truth)
        assert_array_equal(
            both.y[:, 1:],
            alone.y,
            err_msg=f"plant {plant.name!r}, truth {truth!r}: a run depends on the other runs of its batch",
        )


def pickles_give_the_same_bits(plant: Plant) -> None:
    """A pickled plant, before it was used and after, gives the same bits; its functions are those of a module or partials."""
    x, u = _points(plant), plant.input_at(plant.dt)
    for _ in range(2):
        copy = pickled(plant, f"plant {plant.name!r}")
        for (what, function), other in zip(_functions(plant).items(), _functions(copy).values(), strict=True):
            assert_array_equal(function(x, u), other(x, u), err_msg=f"{what} of plant {plant.name!r}, pickled")
        assert_array_equal(
            plant.input_at(plant.dt), copy.input_at(plant.dt), err_msg=f"inputs of plant {plant.name!r}, pickled"
        )


def uncertainty_is_of_this_plant(plant: Plant) -> None:
    """The model at the nominal parameters is the plant's, and `augment` gives a plant that keeps the checks above."""
    if not plant.uncertainty.stated:
        return
    augmented = augment(plant)
    x, u = _points(plant), plant.input_at(0.0)
    added = np.broadcast_to(augmented.x0[plant.x0.size :], (len(x), augmented.x0.size - plant.x0.size))
    z = np.concatenate([x, added], axis=-1)
    for (what, function), larger in zip(_functions(plant).items(), _functions(augmented).values(), strict=True):
        expected, found = function(x, u), larger(z, u)
        scale = np.abs(expected).max(axis=0) + np.finfo(float).tiny
        assert_allclose(
            found[:, : scale.size] / scale, expected / scale, rtol=0, atol=ROUNDED,
            err_msg=f"{what} of the uncertainty of plant {plant.name!r} at the nominal parameters is not the plant's; correct "
            "the nominal values, or the model at other values",
        )  # fmt: skip
    for check in (batches_are_leading_axes, jacobians_are_derivatives, pickles_give_the_same_bits):
        check(replace(augmented, name=f"{plant.name} augmented"))


PLANT_CHECKS: tuple[Callable[[Plant], None], ...] = (
    batches_are_leading_axes,
    jacobians_are_derivatives,
    operation_is_within_limits,
    readings_can_be_simulated,
    pickles_give_the_same_bits,
    uncertainty_is_of_this_plant,
)


def _points(plant: Plant) -> Array:
    """Some states (3, n) about x0, inside the limits of the model."""
    spread = plant.state_scale * np.random.default_rng(1).standard_normal((3, plant.x0.size))
    return plant.x0 + (plant.guard(plant.x0 + spread)[0] - plant.x0) / 2


def _functions(plant: Plant) -> dict[str, Callable[[Array, Array], Array]]:
    """Step and output as functions of states (..., n) and inputs (m,)."""
    return {
        "step": lambda x, u: plant.step(0.0, x, np.broadcast_to(u, (*x.shape[:-1], u.size)), plant.dt),
        "output": lambda x, u: plant.output(0.0, x, np.broadcast_to(u, (*x.shape[:-1], u.size))),
    }


def _at(function: Callable[[Array, Array], Array], u: Array, x: Array) -> Array:
    return function(x, u)
