"""Plants and detectors go to other processes: as pickles that give the same bits."""

from __future__ import annotations

import multiprocessing
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from toy_plants import Array, chain

from fusion_sfdia import Physics, Sensor, Signal, discretise, simulate
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.filters.filterpy_adapter import plant_from_filterpy
from fusion_sfdia.models.marine_engine.equilibrium import equilibrium
from fusion_sfdia.models.marine_engine.faults import EngineFault
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.physics import engine_physics
from fusion_sfdia.models.marine_engine.plant import marine_engine
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import AreaFault, Switch
from fusion_sfdia.models.power_network.plant import network_physics, power_network
from fusion_sfdia.models.two_tanks.plant import tank_physics, two_tanks
from fusion_sfdia.plant.plant import Plant


def fading(t: float, x: Array, z: Array, u: Array, c: object) -> Array:
    return -x + u


def root(x: Array) -> Array:
    return np.sqrt(1 + x**2)


def slope_of_root(x: Array) -> Array:
    return np.asarray(x / root(x)).reshape(1, -1)


def moved(x: Array, dt: float) -> Array:
    return 0.9 * x


def ours() -> Plant:
    physics = Physics("fading", (Signal("x"),), fading, inputs=(Signal("u"),))
    one = np.ones(1)
    return discretise(physics, [Sensor("y", "x", sigma=0.1)], dt=0.1, x0=one, initial_cov=one, process_cov=one)


def linear_filter() -> Plant:
    return plant_from_filterpy(KalmanFilter(dim_x=2, dim_z=1))


def extended_filter() -> Plant:
    return plant_from_filterpy(ExtendedKalmanFilter(dim_x=1, dim_z=1), h=root, h_jacobian=slope_of_root)


def unscented_filter() -> Plant:
    points = MerweScaledSigmaPoints(1, 0.1, 2.0, 2.0)
    return plant_from_filterpy(UnscentedKalmanFilter(dim_x=1, dim_z=1, dt=0.5, hx=root, fx=moved, points=points))


def faulty_engine() -> Plant:
    return marine_engine(process_faults=[EngineFault("turbine-fouling", 0.1)])


def faulty_network() -> Plant:
    return power_network(faults=[AreaFault("governor", "3", 1000.0)], switches=[Switch(1.0, unplug=("5",))])


PLANTS: dict[str, Callable[[], Plant]] = {
    **{name: lambda name=name: registry.plant(name) for name in registry.plants()},
    **{f"{name}, finer": lambda name=name: registry.plant(name).truth.finer()[0] for name in registry.plants()},
    "linear": chain,
    "of one's own": ours,
    "swinging tanks": lambda: two_tanks(swing=0.2),
    "faulty engine": faulty_engine,
    "faulty network": faulty_network,
    "filterpy KalmanFilter": linear_filter,
    "filterpy ExtendedKalmanFilter": extended_filter,
    "filterpy UnscentedKalmanFilter": unscented_filter,
}


def in_other_units(plant: Plant) -> Plant:
    return plant.in_units({plant.sensor_names[0]: ("other", 1e-3)})


def numbers(plant: Plant) -> list[Array]:
    """Of all functions of a plant."""
    t, x, u, dt = 2 * plant.dt, plant.x0 + 1e-3 * plant.state_scale, plant.input_at(2 * plant.dt), plant.dt
    y = plant.output(t, x, u)
    found = [
        plant.step(t, x, u, dt), y, plant.step_jacobian_at(t, x, u, dt), plant.output_jacobian_at(t, x, u), u,
        plant.step(t, np.stack([x, plant.x0]), u, dt),
    ]  # fmt: skip
    if plant.truth.feedback is not None:
        found.append(plant.truth.feedback(t, y, u))
    return found


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("unit", ["as it is", "in other units"])
def test_a_pickled_plant_gives_the_same_bits(name: str, unit: str) -> None:
    plant = PLANTS[name]()
    plant = plant if unit == "as it is" else in_other_units(plant)
    before = pickle.loads(pickle.dumps(plant))
    expected = numbers(plant)
    for copy in (before, pickle.loads(pickle.dumps(plant))):  # the second after the plant was used
        for value, other in zip(expected, numbers(copy), strict=True):
            np.testing.assert_array_equal(value, other)
        assert (copy.truth.finer is None) == (plant.truth.finer is None)


@pytest.mark.parametrize("name", registry.plants())
def test_the_finer_twin_of_a_pickled_plant_is_the_same(name: str) -> None:
    plant = registry.plant(name)
    copy = pickle.loads(pickle.dumps(plant))
    (finer, coarse), (other, as_coarse) = plant.truth.finer(), copy.truth.finer()
    np.testing.assert_array_equal(coarse(finer.x0), as_coarse(other.x0))
    np.testing.assert_array_equal(numbers(finer)[0], numbers(other)[0])


def test_pickled_physics_give_the_same_bits() -> None:
    c = engine_parameters()
    for physics in (tank_physics(), network_physics(network_model()), engine_physics(c, "law", equilibrium(1.0, c), 1.0)):
        copy = pickle.loads(pickle.dumps(physics))
        x, z, u = (np.array([s.nominal for s in group]) for group in (physics.states, physics.algebraic, physics.inputs))
        np.testing.assert_array_equal(physics.f(0.0, x, z, u, physics.parameters), copy.f(0.0, x, z, u, copy.parameters))
        if physics.phi is not None:
            np.testing.assert_array_equal(
                physics.phi(0.0, x, z, u, physics.parameters), copy.phi(0.0, x, z, u, copy.parameters)
            )


@pytest.mark.slow
def test_a_pool_of_processes_takes_plants_and_detectors() -> None:
    """In fresh processes, which have the pickle only."""
    plant = registry.plant("two-tanks")
    detector = registry.detector("loo-glr", plant)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        there = pool.submit(simulate, plant, 20, [7]).result()
        here = simulate(plant, 20, [7])
        np.testing.assert_array_equal(there.y, here.y)
        data = here.t, here.y[:, 0], here.u_of_runs[:, 0]
        _, decided = pool.submit(run, detector, detector.init(), *data).result()
        np.testing.assert_array_equal(decided.residual, run(detector, detector.init(), *data)[1].residual)
