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

from fusion_sfdia.derivatives.analytic import REFUSED, WRONG
from fusion_sfdia.derivatives.equation import difference_jacobian
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.checks.require import pickled
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

STEPS = 20
ROUNDED = float(np.sqrt(np.finfo(float).eps))  # relative: far above rounding, far below the effect of exchanged axes
DIFFERENCED = 1e-4  # relative: far above the error of central differences, far below a wrong sign or factor
ALONG = 20  # steps of the usual operation after which Jacobians are checked, too
VARIED = 0.01  # of an input: its change between the runs of a batch


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


def batches_are_leading_axes(plant: Plant) -> None:
    """A batch of states is stepped and read as its members are one by one, and the given states stay unchanged."""
    x, u = points(plant), plant.input_at(0.0)
    given = x.copy()
    for what, function in functions(plant).items():
        together = function(x, u)
        alone = np.stack([function(point, u) for point in x])
        nested = function(x[:, None], u)[:, 0]
        for other, shape in ((alone, "(n,) each"), (nested, f"({len(x)}, 1, n)")):
            _require_close(
                together,
                other,
                f"{what} of plant {plant.name!r}: states ({len(x)}, n) give other numbers than {shape}; write it for batches, "
                "which are leading axes: x[..., 0], not x[0]",
            )
        assert_array_equal(x, given, err_msg=f"{what} of plant {plant.name!r} writes into the states it is given; copy them")


def inputs_are_of_each_run(plant: Plant) -> None:
    """Runs with inputs of their own, u (..., m), are stepped and read as they are one by one."""
    if not plant.inputs:
        return
    x, usual = points(plant), plant.input_at(0.0)
    low, high = (np.array([getattr(s, end) for s in plant.inputs]) for end in ("low", "high"))
    u = usual + VARIED * np.arange(len(x))[:, None] * np.where(usual == 0, 1.0, np.abs(usual))
    u = np.clip(u, low, high)
    for what, function in functions(plant).items():
        cure = "write it for batches, which are leading axes: u[..., 0], not u[0]"
        try:
            together = function(x, u)
        except (IndexError, ValueError) as error:
            raise AssertionError(
                f"{what} of plant {plant.name!r} fails for states {x.shape} and inputs {u.shape}: {error}; {cure}"
            ) from error
        alone = np.stack([function(point, of_run) for point, of_run in zip(x, u, strict=True)])
        text = f"{what} of plant {plant.name!r}: inputs {u.shape}, a row a run, give other numbers than each run alone; {cure}"
        if together.shape != alone.shape:
            raise AssertionError(text)
        _require_close(together, alone, text)


def states_have_their_own_rates(plant: Plant) -> None:
    """The states do not all change by the same amount, which depends on the states: one derivative was broadcast to all."""
    n, x = len(plant.states), points(plant)
    change = functions(plant)["step"](x, plant.input_at(0.0)) - x
    size = np.max(np.abs(change))
    rounding = 64 * np.finfo(float).eps * (np.max(np.abs(x)) + size)
    alike = np.ptp(change, axis=-1) <= rounding
    if n > 1 and size > 1e3 * rounding and np.all(alike) and np.ptp(change[:, 0]) > 1e3 * rounding:
        raise AssertionError(
            f"step of plant {plant.name!r} changes all {n} states by the same amount, {change[0, 0]:g} at one point: a single "
            "derivative was broadcast to all states; give one for each, np.stack([...], axis=-1)"
        )


def jacobians_are_derivatives(plant: Plant) -> None:
    """The Jacobians of step and output agree with central differences, each row relative to its largest entry, about x0 and
    along the usual operation.
    """
    on_turn = {"step": plant.states_near, "output": plant.near}
    for t, x in ((0.0, points(plant)), along_operation(plant)):
        u = plant.input_at(t)
        of_runs = np.broadcast_to(u, (len(x), u.size))
        jacobians = {
            "step": plant.step_jacobian_at(t, x, of_runs, plant.dt),
            "output": np.broadcast_to(plant.output_jacobian_at(t, x, of_runs), (len(x), len(plant.sensors), x.shape[-1])),
        }
        for (what, function), used in zip(functions(plant, t).items(), plant.non_analytic, strict=True):
            expected = (
                difference_jacobian(partial(_at, function, u, x, on_turn[what]), x, plant.state_scale) * plant.state_scale
            )
            scale = np.abs(expected).max(axis=-1, keepdims=True) + np.finfo(float).tiny
            if getattr(plant.numerics, f"{what}_jacobian") is not None:
                text = f"{what}_jacobian of plant {plant.name!r} is not the derivative of {what}; correct it or leave it out"
            else:
                at = ", ".join(f"{s.name} = {v:.4g}" for s, v in zip(plant.states, x[0], strict=True))
                text = (
                    f"the complex step gives another Jacobian of {what} of plant {plant.name!r} than differences do near {at}, "
                    f"{t:g} s: a function that is not analytic stands there, perhaps behind an `if` or in compiled code: "
                    + ("; ".join(f"{use}: {use.cure}" for use in used if use.effect in (WRONG, REFUSED)) or "abs, sign, .real")
                    + f"; or give Numerics({what}_jacobian=...)"
                )
            assert_allclose(
                jacobians[what] * plant.state_scale / scale, expected / scale, rtol=0, atol=DIFFERENCED, err_msg=text
            )


def along_operation(plant: Plant, steps: int = ALONG) -> tuple[float, Array]:
    """The time after some steps of the usual operation from x0, and states (3, n) about the one that is reached."""
    x = plant.x0
    with np.errstate(all="ignore"):
        for k in range(steps):
            x = plant.guard(plant.step(k * plant.dt, x, plant.input_at(k * plant.dt), plant.dt))[0]
    if not np.all(np.isfinite(x)):
        at = ", ".join(f"{s.name} = {v:.4g}" for s, v in zip(plant.states, x, strict=True))
        raise AssertionError(
            f"the usual operation of plant {plant.name!r} leads to {at} after {steps} steps of {plant.dt:g} s; correct the "
            "model, its inputs or x0, or take a shorter dt or substeps"
        )
    return steps * plant.dt, points(plant, x)


def points(plant: Plant, centre: Array | None = None) -> Array:
    """Some states (3, n) about x0 or another one, inside the limits of the model."""
    x = plant.x0 if centre is None else centre
    spread = plant.state_scale * np.random.default_rng(1).standard_normal((3, x.size))
    return np.asarray(x + (plant.guard(x + spread)[0] - x) / 2)


def functions(plant: Plant, t: float = 0.0) -> dict[str, Callable[[Array, Array], Array]]:
    """Step and output at t as functions of states (..., n) and inputs (m,) or (..., m)."""
    return {
        "step": lambda x, u: plant.step(t, x, np.broadcast_to(u, (*x.shape[:-1], u.shape[-1])), plant.dt),
        "output": lambda x, u: plant.output(t, x, np.broadcast_to(u, (*x.shape[:-1], u.shape[-1]))),
    }


def _require_close(found: Array, expected: Array, text: str) -> None:
    scale = np.abs(expected).max(axis=0) + np.finfo(float).tiny
    assert_allclose(found / scale, expected / scale, rtol=0, atol=ROUNDED, err_msg=text)


def _at(function: Callable[[Array, Array], Array], u: Array, about: Array, near: Callable[..., Array], x: Array) -> Array:
    """The values at the points x (B, k, n), cyclic ones on the turn of those at `about` (B, n)."""
    return near(function(x, u), function(about, u)[:, None])


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
