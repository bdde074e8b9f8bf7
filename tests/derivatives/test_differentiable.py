"""Steps and outputs that give their Jacobian by the same call give what each gives by itself."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.derivatives.differentiable import Differentiable, with_jacobian
from fusion_sfdia.detectors import registry
from fusion_sfdia.filters.estimators import Extended, GaussianState
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
ROUNDING = 1e-12  # of some thousand operations
PLANTS = ("two-tanks", "marine-engine", "gas-pipeline")
LARGER = (*((name, larger) for name in PLANTS for larger in (False, True)), ("power-network", True))
READ = ("two-tanks", "marine-engine")  # the readings of the others are states


def states(plant: Plant, batch: tuple[int, ...]) -> tuple[Array, Array]:
    """States near x0 and inputs of a batch."""
    noise = np.random.default_rng(1).standard_normal((*batch, len(plant.states)))
    u = plant.input_at(0.0)
    return plant.guard(plant.x0 + 0.1 * plant.state_scale * noise)[0], np.broadcast_to(u, (*batch, u.size))


@pytest.mark.parametrize(("name", "larger"), LARGER)
@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_both_by_one_call_are_those_of_two(name: str, batch: tuple[int, ...], larger: bool) -> None:
    plant = augment(registry.plant(name)) if larger else registry.plant(name)
    (x, u), (step, output) = states(plant, batch), plant.with_jacobians
    assert step is not None and (output is not None) == (name in READ)
    ahead, tangent = step(0.0, x, u, plant.dt)
    np.testing.assert_allclose(ahead, plant.step(0.0, x, u, plant.dt), rtol=ROUNDING)
    np.testing.assert_array_equal(tangent, plant.step_jacobian_at(0.0, x, u, plant.dt))
    if output is not None:
        y, by_x = output(0.0, x, u)
        np.testing.assert_allclose(y, plant.output(0.0, x, u), rtol=ROUNDING)
        np.testing.assert_array_equal(by_x, plant.output_jacobian_at(0.0, x, u))


@pytest.mark.parametrize("name", PLANTS)
def test_an_extended_filter_calls_the_model_once(name: str) -> None:
    plant, calls = registry.plant(name), []

    def never(*arguments: Any) -> Array:
        raise AssertionError("the step was called by itself")

    def both(*arguments: Any) -> tuple[Array, Array]:
        calls.append(arguments)
        found: tuple[Array, Array] = given(*arguments)
        return found

    given = plant.with_jacobians[0]
    step = Differentiable(never, both)
    x, u = states(plant, (2,))
    P = np.broadcast_to(np.diag(plant.state_scale**2), (2, x.shape[-1], x.shape[-1]))
    rng = np.random.default_rng(0)
    expected = Extended().predict(plant, GaussianState(x, P), 0.0, u, plant.dt, rng)
    watched = replace(plant, numerics=replace(plant.numerics, step_jacobian=step.jacobian))
    object.__setattr__(watched, "step", step)  # no probing call of the constructor
    found = Extended().predict(watched, GaussianState(x, P), 0.0, u, plant.dt, rng)
    assert sum(of.ndim == x.ndim for _, of, *_ in calls) == 1  # besides that at x0, whether the Jacobian is sparse
    np.testing.assert_array_equal(found.core.x, expected.core.x)
    np.testing.assert_array_equal(found.core.P, expected.core.P)


def test_another_stated_jacobian_is_not_passed_over() -> None:
    """A plant whose Jacobian has been replaced keeps it: the step's own, and what comes with it, no longer count."""
    plant = registry.plant("two-tanks")
    other = replace(plant, numerics=replace(plant.numerics, step_jacobian=lambda t, x, u, dt: np.eye(2)))
    assert other.with_jacobians[0] is None and plant.with_jacobians[0] is not None
    assert with_jacobian(lambda t, x, u, dt: x, None) is None


@pytest.mark.parametrize("what", ["step", "output"])
def test_shapes_that_do_not_fit_are_reported_at_the_first_step(what: str) -> None:
    plant = registry.plant("two-tanks")
    x, u = states(plant, (2,))
    core = GaussianState(x, np.broadcast_to(np.diag(plant.state_scale**2), (2, 2, 2)))
    jacobian, value = plant.jacobians[what == "output"], getattr(plant, what)
    assert jacobian is not None
    none = replace(plant.numerics, step_jacobian=None, output_jacobian=None)
    for wrong, message in (
        (lambda *a: (value(*a), np.eye(7)), f"{what}_jacobian of plant 'two-tanks' gives shape \\(7, 7\\)"),
        (lambda *a: (value(*a)[..., :1], jacobian(*a)), f"{what} of plant 'two-tanks' gives shape \\(2, 1\\)"),
    ):
        other = replace(plant, numerics=none, **{what: Differentiable(value, wrong)})
        with pytest.raises(ValueError, match=message):
            prior = Extended().predict(other, core, 0.0, u, plant.dt, np.random.default_rng(0))
            Extended().joint(other, prior, plant.dt, u)
