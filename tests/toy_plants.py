"""Small plants for tests: a linear chain, and two water tanks with their flows as algebraic variables."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.discretise import discretise, linear_plant
from fusion_sfdia.modules import Modules
from fusion_sfdia.physics import Block, Physics
from fusion_sfdia.plant import Plant
from fusion_sfdia.signals import Sensor, Signal

Array = NDArray[Any]


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


class Tanks(NamedTuple):
    area: float = 0.05  # m2
    outlet: float = 6e-4  # m2.5/s, flow per root of level


def tank_physics() -> Physics:
    def f(t: float, x: Array, z: Array, u: Array, c: Tanks) -> Array:
        return np.stack([(u[..., 0] - z[..., 0]) / c.area, (z[..., 0] - z[..., 1]) / c.area], axis=-1)

    def phi(t: float, x: Array, z: Array, u: Array, c: Tanks) -> Array:
        return np.stack([c.outlet * np.sqrt(x[..., 0]), c.outlet * np.sqrt(x[..., 1])], axis=-1)

    return Physics(
        name="tanks",
        states=(Signal("level_1", "m", 1.0, 0.01, 3.0), Signal("level_2", "m", 1.0, 0.01, 3.0)),
        inputs=(Signal("inflow", "m3/s", 6e-4, 0.0, 2e-3),),
        algebraic=(Signal("flow_12", "m3/s", 6e-4), Signal("flow_out", "m3/s", 6e-4)),
        f=f,
        phi=phi,
        parameters=Tanks(),
        blocks=(Block("upper", ("level_1", "flow_12")), Block("lower", ("level_2", "flow_out"), ("upper",))),
    )


def tank_modules() -> Modules:
    """The tanks' equations; levels integrate what flows, so that their observers' gains alone make errors decay."""
    return Modules(
        equations={
            "level_1": lambda inflow, flow_12, c: (inflow - flow_12) / c.area,
            "level_2": lambda flow_12, flow_out, c: (flow_12 - flow_out) / c.area,
            "flow_12": lambda level_1, c: c.outlet * np.sqrt(level_1),
            "flow_out": lambda level_2, c: c.outlet * np.sqrt(level_2),
        },
        rates=np.zeros(2),
        nominal={"level_1": 1.0, "level_2": 1.0, "flow_12": 6e-4, "flow_out": 6e-4},
        parameters=Tanks(),
        inputs=("inflow",),
        names={"level_1": "M(1,1)", "flow_12": "M(1,2)", "level_2": "M(2,1)", "flow_out": "M(2,2)"},
        gains={"level_1": 0.05, "level_2": 0.05},
    )


def tanks() -> Plant:
    """Two levels and two flows, all measured; a nonlinear DAE whose sensors have very unlike units."""
    plant = discretise(
        tank_physics(),
        [
            Sensor("l1", "level_1", "m", sigma=0.01, bound=0.04, owner="upper", quantity="level"),
            Sensor("l2", "level_2", "m", sigma=0.01, bound=0.04, owner="lower", quantity="level"),
            Sensor("q12", "flow_12", "m3/s", sigma=6e-6, bound=2.4e-5, owner="upper", quantity="flow"),
            Sensor("q2", "flow_out", "m3/s", sigma=6e-6, bound=2.4e-5, owner="lower", quantity="flow"),
        ],
        dt=5.0,
        x0=np.array([1.0, 1.0]),
        initial_cov=np.full(2, 1e-4),
        process_cov=np.full(2, 1e-6),
    )
    return replace(plant, modules=tank_modules())


def readings(plant: Plant, steps: int, runs: int, seed: int) -> tuple[Array, Array, Array, Array]:
    """Simulate the plant with its own process and reading noise: t (K,), x (K, runs, n), y (K, runs, N), u (K, runs, m)."""
    rng = np.random.default_rng(seed)
    n, count = plant.x0.size, len(plant.sensors)
    x = plant.x0 + np.sqrt(plant.initial_cov) * rng.standard_normal((runs, n))
    u = np.broadcast_to(plant.input_at(0.0), (runs, len(plant.inputs)))
    xs, ys = np.empty((steps, runs, n)), np.empty((steps, runs, count))
    for k in range(steps):
        x = plant.step(k * plant.dt, x, u, plant.dt) + np.sqrt(plant.process_cov) * rng.standard_normal((runs, n))
        xs[k] = x
        ys[k] = plant.output((k + 1) * plant.dt, x, u) + plant.sensor_sigma * rng.standard_normal((runs, count))
    return np.arange(1, steps + 1) * plant.dt, xs, ys, np.broadcast_to(u, (steps, runs, len(plant.inputs)))
