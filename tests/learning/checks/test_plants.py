"""Mistakes in a plant's functions: each is found, and the error states the cure."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from toy_plants import Array

from fusion_sfdia import Plant, Sensor, Signal, check_plant

OUT = 3.0


def out(t: float, x: Array, u: Array) -> Array:
    return x


def rates(x: Array, inflow: Array) -> list[Array]:
    return [inflow - 0.1 * np.sqrt(x[..., 0]), 0.1 * np.sqrt(x[..., 0]) - 0.1 * np.sqrt(x[..., 1])]


def right(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.asarray(x + dt * np.stack(rates(x, u[..., 0]), axis=-1))


def first_axis(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.stack(rates(x, u[..., 0]))


def unbatched(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.array([x[0] + dt * (u[0] - 0.1 * x[0]), x[1] + dt * 0.1 * (x[0] - x[1])])


def joined_first(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.asarray(x + dt * np.array(rates(x, u[..., 0])))


def of_one_number(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.stack([x[..., 0] - dt * 0.1 * math.sqrt(x[..., 0]), x[..., 1]], axis=-1)


def branching(t: float, x: Array, u: Array, dt: float) -> Array:
    return x - 0.1 * dt * x if x[..., 0] > 1 else x


def one_derivative(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.asarray(x + dt * (u[..., :1] - 0.1 * np.sqrt(x[..., :1])))


def first_input(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.asarray(x + dt * np.stack(rates(x, u[0]), axis=-1))


def far_abs(t: float, x: Array, u: Array, dt: float) -> Array:
    """A derivative that only the complex step gets wrong, behind an `if` and beyond x0 = 1."""
    level = np.abs(x) if np.min(x.real) > OUT else x
    return np.asarray(x + dt * (0.5 - 0.05 * level))


def runaway(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.asarray(x + dt * x**3)


def tank(step: Any, **changes: Any) -> Plant:
    given: dict[str, Any] = {
        "states": [Signal(name, "m", nominal=1.0, initial_sigma=0.05, process_sigma=0.01) for name in ("upper", "lower")],
        "sensors": [Sensor(f"{name} level", name, "m", sigma=0.01) for name in ("upper", "lower")],
        "inputs": [Signal("inflow", "m/s", nominal=0.1)],
        "dt": 1.0,
    }
    return Plant("own tank", step=step, output=out, **given | changes)


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (first_axis, r"gives shape \(2, 3, 1\) .* stack them along the last axis, np.stack\(\[...\], axis=-1\)"),
        (unbatched, r"gives shape .*; expected \(3, 1, 2\): .* with a batch as leading axes \(x\[..., 0\]\)"),
        (joined_first, r"fails for .*: x\[..., 0\], not x\[0\], and join states along the last axis, np.stack\(\[...\], axis"),
        (of_one_number, r"functions of `math` and float\(\) take one number; write those of numpy, np.sqrt"),
        (branching, "`if`, `min` and `max` of Python take one number; write np.where, np.minimum and np.maximum"),
    ],
)
def test_a_plant_with_a_mistake_is_not_made(step: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        tank(step)


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (one_derivative, r"changes all 2 states by the same amount.* give one for each, np.stack\(\[...\], axis=-1\)"),
        (first_input, r"inputs \(3, 1\), a row a run, give other numbers .*: u\[..., 0\], not u\[0\]"),
        (far_abs, r"the complex step gives another Jacobian of step .* or give Numerics\(step_jacobian=...\)"),
        (runaway, "the usual operation of plant 'own tank' leads to .* take a shorter dt or substeps"),
    ],
)
def test_a_plant_with_a_mistake_fails_its_check(step: Any, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_plant(tank(step))


def walk(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.asarray(x + dt * u)  # both integrate the same input


def decay(t: float, x: Array, u: Array, dt: float) -> Array:
    return x * (1 - 0.1 * dt)


@pytest.mark.parametrize("step", [right, walk, decay])
def test_a_plant_without_a_mistake_passes(step: Any) -> None:
    check_plant(tank(step))
