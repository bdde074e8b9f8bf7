"""Small plants for tests: a linear chain, and the two water tanks, a nonlinear DAE whose sensors have very unlike units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.filters.gaussian import sample
from fusion_sfdia.models.two_tanks.plant import tank_modules as tank_modules
from fusion_sfdia.models.two_tanks.plant import tank_physics as tank_physics
from fusion_sfdia.models.two_tanks.plant import two_tanks as tanks  # noqa: F401
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty

Array = NDArray[Any]


def changed(plant: Plant, **changes: Any) -> Plant:
    """The plant with some fields changed, its own or those of its groups."""
    found = {name: value for name, value in changes.items() if name in {f.name for f in fields(plant)}}
    for group in ("numerics", "truth", "structure"):
        now = getattr(plant, group)
        if inner := {name: changes[name] for name in changes if name in {f.name for f in fields(now)}}:
            found[group] = replace(now, **inner)
            changes = {name: value for name, value in changes.items() if name not in inner}
    assert changes.keys() <= found.keys(), f"a plant has no {', '.join(changes.keys() - found.keys())}"
    return replace(plant, **found)


def chain(n: int = 12, sensors: int | None = None, sigma: float = 1.0, process: float = 0.1) -> Plant:
    """n coupled first-order states, each read by one sensor, or by `sensors` sensors that read sums of neighbours."""
    count = n if sensors is None else sensors
    readout = (
        np.eye(n)
        if sensors is None
        else np.array([[1.0 if j in (i % n, (i + 1) % n) else 0.0 for j in range(n)] for i in range(count)])
    )
    return linear_plant(
        "chain",
        0.95 * np.eye(n) + 0.03 * np.eye(n, k=1),
        readout,
        [Sensor(f"s{i}", f"x{i % n}", sigma=sigma) for i in range(count)],
        dt=1.0,
        x0=np.zeros(n),
        initial_cov=np.full(n, sigma**2),
        process_cov=np.full(n, (process * sigma) ** 2),
    )


DIRECTIONS = np.array([[1.0, 0.5, 0.0, -0.5], [0.0, 0.0, 1.0, 0.3]])  # of the parameter and the input on the states


def pushed(plant: Plant, directions: Array, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
    """The step of a plant without inputs whose states a parameter and an input change along fixed directions."""
    return np.asarray(plant.step(t_start, x, u[..., :0], dt) + np.concatenate([theta, u], axis=-1) @ directions)


def unpushed(plant: Plant, directions: Array, t_start: float, x: Array, u: Array, dt: float) -> Array:
    """The same at a parameter of 0."""
    return np.asarray(plant.step(t_start, x, u[..., :0], dt) + u @ directions[1:])


def declared(load: float = 0.2, push: float = 0.1, **parameter: Any) -> Plant:
    """A chain of 4 states and 7 sensors with an uncertain parameter, load, and an error of its input, push: sd of each, 0
    where it is not declared.
    """
    plain = chain(4, sensors=7)
    plant = replace(plain, inputs=(Signal("push"),), step=partial(unpushed, plain, DIRECTIONS))
    parameters = (Parameter("load", sd=load, **parameter),) if load else ()
    at = partial(pushed, plain, DIRECTIONS) if load else None
    return replace(plant, uncertainty=Uncertainty(parameters, at, inputs={"push": push} if push else {}))


def readings(
    plant: Plant, steps: int, runs: int, seed: int, jumps: Mapping[int, Array] | None = None
) -> tuple[Array, Array, Array, Array]:
    """Simulate the plant with its own process and reading noise: t (K,), x (K, runs, n), y (K, runs, N), u (K, runs, m).

    jumps: changes of the state (n,) before the k-th step, by k from 0.
    """
    rng = np.random.default_rng(seed)
    n, count = plant.x0.size, len(plant.sensors)
    x = plant.x0 + sample(plant.initial_cov, rng, (runs,))
    u = np.broadcast_to(plant.input_at(0.0), (runs, len(plant.inputs)))
    xs, ys = np.empty((steps, runs, n)), np.empty((steps, runs, count))
    for k in range(steps):
        x = x + jumps[k] if jumps and k in jumps else x
        x = plant.step(k * plant.dt, x, u, plant.dt) + np.sqrt(plant.process_cov) * rng.standard_normal((runs, n))
        xs[k] = x
        ys[k] = plant.output((k + 1) * plant.dt, x, u) + plant.sensor_sigma * rng.standard_normal((runs, count))
    return np.arange(1, steps + 1) * plant.dt, xs, ys, np.broadcast_to(u, (steps, runs, len(plant.inputs)))


BOUND = 0.3


def bounded_chain() -> Plant:
    """A linear plant, all states read, with noise of stated bounds and a disturbance of stated bound."""
    plant = chain(6)
    sensors = tuple(Sensor(s.name, s.measures, s.unit, bound=BOUND, owner=s.owner) for s in plant.sensors)
    return replace(plant, sensors=sensors, process_bound=np.full(6, 0.05))
