"""Checks that every plant passes. Tests of another package call them for its own plants:

def test_my_tank() -> None:
    check_plant(my_tank)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.checks.models import (
    ROUNDED,
    batches_are_leading_axes,
    functions,
    inputs_are_of_each_run,
    jacobians_are_derivatives,
    points,
    states_have_their_own_rates,
)
from fusion_sfdia.learning.checks.require import pickled
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

STEPS = 20


def check_plant(plant: Any) -> None:
    """Run PLANT_CHECKS on a plant: whether its functions keep the contract.

    `inspect` states what can be diagnosed with them.

    Parameters
    ----------
    plant : Plant, str or callable
        As in `registry.find_plant`.

    Raises
    ------
    AssertionError, ValueError
        With the reason and the cure.

    Examples
    --------
    >>> from fusion_sfdia import check_plant
    >>> check_plant("two-tanks")  # silent where the contract is kept
    """
    found = registry.plant(plant)
    for check in PLANT_CHECKS:
        check(found)


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
    x, u = points(plant), plant.input_at(plant.dt)
    for _ in range(2):
        copy = pickled(plant, f"plant {plant.name!r}")
        for (what, function), other in zip(functions(plant).items(), functions(copy).values(), strict=True):
            assert_array_equal(function(x, u), other(x, u), err_msg=f"{what} of plant {plant.name!r}, pickled")
        assert_array_equal(
            plant.input_at(plant.dt), copy.input_at(plant.dt), err_msg=f"inputs of plant {plant.name!r}, pickled"
        )


def uncertainty_is_of_this_plant(plant: Plant) -> None:
    """The model at the nominal parameters is the plant's, and `augment` gives a plant that keeps the checks above."""
    if not plant.uncertainty.stated:
        return
    augmented = augment(plant)
    x, u = points(plant), plant.input_at(0.0)
    added = np.broadcast_to(augmented.x0[plant.x0.size :], (len(x), augmented.x0.size - plant.x0.size))
    z = np.concatenate([x, added], axis=-1)
    for (what, function), larger in zip(functions(plant).items(), functions(augmented).values(), strict=True):
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
    inputs_are_of_each_run,
    states_have_their_own_rates,
    jacobians_are_derivatives,
    operation_is_within_limits,
    readings_can_be_simulated,
    pickles_give_the_same_bits,
    uncertainty_is_of_this_plant,
)
