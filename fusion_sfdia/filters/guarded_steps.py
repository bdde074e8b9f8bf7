"""Steps of a plant's model that start within its limits and end at finite states.

A step starts from the state moved into the limits. A state whose step ends in no finite value stays where it is (`stuck`). If
the model has a finite value for the plant's x0, a faulty reading may have pulled the estimate outside the model's domain, and
the next readings may pull it back: the estimate is reported as `guarded`. If it has none even there, the estimate is `lost`,
and the detector reports it as diverged.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.limits import finite
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


class Stepped(NamedTuple):
    """A step of states.

    start (..., n): states within the plant's limits. ahead (..., n): states after the step, `start` where stuck. moved (...):
    whether a state was moved into the limits. stuck (...): whether its step ends in no finite value. lost (...): whether a step
    from the plant's x0 does so too.
    """

    start: Array
    ahead: Array
    moved: Array
    stuck: Array
    lost: Array


def guarded_step(plant: Plant, t_start: float, x: Array, u: Array, dt: float) -> Stepped:
    """Step the states x (..., n) from within the plant's limits; ValueError where the plant's step changes their shape."""
    start, moved = plant.guard(x)
    return _stepped(plant, t_start, start, np.asarray(plant.step(t_start, start, u, dt)), moved, u, dt)


def guarded_step_and_jacobian(plant: Plant, t_start: float, x: Array, u: Array, dt: float) -> tuple[Stepped, Array]:
    """`guarded_step` with the Jacobian (..., n, n) of the step, or (n, n), by one call where the model has one for both."""
    if (both := plant.with_jacobians[0]) is None:
        stepped = guarded_step(plant, t_start, x, u, dt)
        return stepped, plant.step_jacobian_at(t_start, stepped.start, u, dt)
    start, moved = plant.guard(x)
    ahead, jacobian = both(t_start, start, u, dt)
    stepped = _stepped(plant, t_start, start, ahead, moved, u, dt)
    return stepped, plant.jacobian_of_shape("step_jacobian", jacobian, len(plant.states))


def _stepped(plant: Plant, t_start: float, start: Array, ahead: Array, moved: Array, u: Array, dt: float) -> Stepped:
    if ahead.shape != start.shape:
        raise ValueError(
            f"step of plant {plant.name!r} gives shape {ahead.shape} for states {start.shape}; expected the same: "
            "a batch is leading axes"
        )
    stuck = ~finite(ahead)
    if not stuck.any():
        return Stepped(start, ahead, moved, stuck, stuck)
    return Stepped(start, np.where(stuck[..., None], start, ahead), moved, stuck, stuck & ~_holds(plant, t_start, u, dt))


def _holds(plant: Plant, t_start: float, u: Array, dt: float) -> Array:
    """Whether the step from the plant's x0 under the inputs u (..., m) is finite (...)."""
    x = np.broadcast_to(plant.x0, (*u.shape[:-1], plant.x0.size))
    return np.asarray(np.all(np.isfinite(plant.step(t_start, x, u, dt)), axis=-1))


def guarded_points(plant: Plant, t_start: float, x: Array, u: Array, dt: float) -> Stepped:
    """Step the points x (..., M, n) of an estimate (members, sigma points) under its input u (..., m); the flags are (...).

    An estimate is stuck where the steps of more than half of its points are. A stuck point moves by the mean of the others'
    steps; at rest, it would enlarge their covariance by the distance that they have moved.
    """
    start, ahead, moved, stuck, lost = guarded_step(plant, t_start, x, np.expand_dims(u, -2), dt)
    ahead = plant.states_near(ahead, ahead[..., :1, :])
    if stuck.any():
        sound = np.maximum(np.sum(~stuck, axis=-1), 1)[..., None]
        drift = np.sum(ahead - start, axis=-2) / sound  # stuck points have not moved
        ahead = np.where(stuck[..., None], start + drift[..., None, :], ahead)
    most = 2 * np.sum(stuck, axis=-1) > x.shape[-2]
    return Stepped(start, ahead, np.any(moved, axis=-1), np.any(stuck, axis=-1), most & np.any(lost, axis=-1))


def readings_of(plant: Plant, t: float, x: Array, u: Array) -> Array:
    """Return the readings (..., N) of the plant in states x (..., n); ValueError where its output has another shape."""
    return _of_sensors(plant, x, np.asarray(plant.output(t, x, u)))


def readings_of_points(plant: Plant, t: float, x: Array, u: Array) -> Array:
    """`readings_of` the points (..., M, n) of an estimate under its input u (..., m), cyclic ones on the turn of the first."""
    y = readings_of(plant, t, x, np.expand_dims(u, -2))
    return plant.near(y, y[..., :1, :])


def readings_and_jacobian(plant: Plant, t: float, x: Array, u: Array) -> tuple[Array, Array]:
    """`readings_of` with their Jacobian (..., N, n), or (N, n), by one call where the model has one for both."""
    if (both := plant.with_jacobians[1]) is None:
        return readings_of(plant, t, x, u), plant.output_jacobian_at(t, x, u)
    y, jacobian = both(t, x, u)
    return _of_sensors(plant, x, y), plant.jacobian_of_shape("output_jacobian", jacobian, len(plant.sensors))


def _of_sensors(plant: Plant, x: Array, y: Array) -> Array:
    if y.shape != (expected := (*x.shape[:-1], len(plant.sensors))):
        raise ValueError(
            f"output of plant {plant.name!r} gives shape {y.shape} for states {x.shape}; expected {expected}, a column a sensor"
        )
    return y
