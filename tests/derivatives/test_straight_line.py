"""Straight-line programs: the same numbers as the functions that they are recorded from, and derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import count
from typing import Any, NamedTuple

import numpy as np
import pytest
from toy_plants import Array

from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.derivatives.straight_line import record
from fusion_sfdia.plant.discretise import discretise
from fusion_sfdia.plant.integration import Integrated
from fusion_sfdia.plant.physics import Physics
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Parameter

RNG = np.random.default_rng(0)


class C(NamedTuple):
    a: float = 1.3
    b: float = 0.4


def _every(t: Any, x: Array, z: Array, u: Array, c: C) -> Array:
    """Every function and operator, with products of matrices and sums."""
    p, q = x[..., 0], x[..., 1]
    waves = np.sin(p) * np.cos(q) + np.tanh(p - q) - np.arctan(c.b * p / q) + 0.1 * t
    grows = np.exp(-p) + np.expm1(-q) + np.log(p) + np.log10(q) + np.log1p(p * q)
    powers = p**2 + q**0.5 + p**1.7 + 2.0**q + p**q + (+p) ** 1 - q**c.a
    mixed = (x @ np.array([[0.1, 0.2], [0.3, -0.4]])).sum(axis=-1)
    return np.stack([waves + z[..., 0], c.a * grows - u[..., 0] + mixed - powers], axis=-1)


def _implicit(t: Any, x: Array, z: Array, u: Array, c: C) -> Array:
    return np.stack([0.3 * np.cos(z[..., 0]) + 0.1 * x[..., 0] * c.a], axis=-1)


def _plant(f: Callable[..., Array] = _every, *, decay: bool = False, substeps: int = 1) -> Plant:
    physics = Physics(
        "toy",
        (Signal("p", nominal=1.1), Signal("q", nominal=0.8)),
        f,
        (Signal("w", nominal=0.5),),
        (Signal("z", nominal=0.3),),
        _implicit,
        C(),
    )
    sensors = [Sensor(f"s_{v}", v, sigma=0.1) for v in ("q", "z", "p")]
    unknown = [Parameter(name, "1", getattr(C(), name), 0.1, source="a test") for name in ("a", "b")]
    return discretise(
        physics, sensors, dt=0.05, initial_cov=np.ones(2), process_cov=np.ones(2), unknown=unknown, substeps=substeps,
        decay=np.array([2.0, 0.5]) if decay else None,
    )  # fmt: skip


def _model(plant: Plant) -> Integrated:
    model = plant.step.model  # type: ignore[attr-defined]
    assert isinstance(model, Integrated)
    return model


@pytest.mark.parametrize(("decay", "substeps"), [(False, 1), (False, 3), (True, 2)])
def test_a_program_has_the_numbers_and_the_derivatives_of_its_functions(decay: bool, substeps: int) -> None:
    plant = _plant(decay=decay, substeps=substeps)
    model, shape = _model(plant), (3, 2)
    assert model.program is not None and model.program.implicit
    x, u = RNG.uniform(0.5, 1.5, (*shape, 2)), RNG.uniform(0.5, 1.5, (*shape, 1))
    theta = RNG.uniform(0.8, 1.2, (*shape, 2)) * [1.3, 0.4]
    every = np.concatenate([x, u, theta], axis=-1)

    def step(v: Array) -> Array:  # complex numbers run the functions
        return model.step_at(0.7, v[..., :2], v[..., 2:3], plant.dt, v[..., 3:])

    def output(v: Array) -> Array:
        return model.output_at(0.7, v[..., :2], v[..., 2:3], v[..., 3:])

    for function, found, by in (
        (step, model.step_at(0.7, x, u, plant.dt, theta), model.step_and_jacobian_at(0.7, x, u, plant.dt, theta)[1]),
        (output, model.output_at(0.7, x, u, theta), model.output_and_jacobian_at(0.7, x, u, theta)[1]),
    ):
        np.testing.assert_allclose(found, function(every + 0j).real, rtol=1e-12)  # z settles to 1e-13
        np.testing.assert_allclose(by, complex_step_jacobian(function, every), rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(
        plant.step_jacobian_at(0.7, x, u, plant.dt),
        complex_step_jacobian(lambda p: plant.step(0.7, p, u[..., None, :], plant.dt), x),
        rtol=1e-11, atol=1e-13,
    )  # fmt: skip
    np.testing.assert_allclose(
        plant.output_jacobian_at(0.7, x, u),
        complex_step_jacobian(lambda p: plant.output(0.7, p, u[..., None, :]), x),
        rtol=1e-11, atol=1e-13,
    )  # fmt: skip


def test_a_state_has_the_same_bits_in_any_batch() -> None:
    plant = _plant()
    x, u = RNG.uniform(0.5, 1.5, (4, 2)), np.array([0.7])
    ahead, by = plant.step(0.0, x, u, plant.dt), plant.step_jacobian_at(0.0, x, u, plant.dt)
    for i in range(4):
        np.testing.assert_array_equal(plant.step(0.0, x[i], u, plant.dt), ahead[i])
        np.testing.assert_array_equal(plant.step_jacobian_at(0.0, x[i][None], u[None], plant.dt)[0], by[i])
    np.testing.assert_array_equal(plant.step(0.0, x[None].repeat(2, 0), u, plant.dt)[1], ahead)


def _branching(t: float, x: Array, z: Array, u: Array, c: C) -> Array:
    return np.stack([-x[..., 0], -x[..., 1] * (2.0 if t > 0.01 else 1.0)], axis=-1)


def _kinked(t: float, x: Array, z: Array, u: Array, c: C) -> Array:
    return np.stack([-np.abs(x[..., 0]), np.where(x[..., 1] > 0.5, -1.0, 1.0)], axis=-1)


def _compared(t: float, x: Array, z: Array, u: Array, c: C) -> Array:
    return np.stack([-x[..., 0], -x[..., 1] * (x[..., 0] == 1.0)], axis=-1)


def _of_a_float(t: float, x: Array, z: Array, u: Array, c: C) -> Array:
    return np.stack([-x[..., 0] * math.sin(t), -x[..., 1]], axis=-1)


def _remembering(calls: Any, t: float, x: Array, z: Array, u: Array, c: C) -> Array:
    return -x * float(next(calls))


@pytest.mark.parametrize("f", [_branching, _kinked, _compared, _of_a_float, partial(_remembering, count(1))])
def test_what_cannot_be_recorded_runs_its_functions(f: Callable[..., Array]) -> None:
    plant = _plant(f)
    assert _model(plant).program is None and plant.jacobians == (None, None)
    if f is _branching:
        x, u = plant.x0, plant.input_at(0.0)
        assert plant.step(1.0, x, u, plant.dt)[1] < plant.step(-1.0, x, u, plant.dt)[1]


def test_a_plant_with_another_step_has_another_jacobian() -> None:
    plant = replace(_plant(), step=lambda t, x, u, dt: 0.5 * x)
    np.testing.assert_array_equal(plant.step_jacobian_at(0.0, plant.x0, plant.input_at(0.0), plant.dt), 0.5 * np.eye(2))


def test_repeated_operations_are_recorded_once() -> None:
    def f(t: float, x: Array, z: Array, u: Array, theta: Array) -> Array:
        return np.stack([np.sqrt(x[..., 0] * x[..., 0]) + np.sqrt(x[..., 0] * x[..., 0])], axis=-1)

    none = np.empty(0)
    program = record(f, None, [np.ones(1), none, none, none])
    assert program is not None and len(program.value) == 2 + 3  # t, x; the product, its root, the sum
