"""What the plants declare as not known: each parameter is the one of the equations, and changes the readings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.derivatives.equation import difference_jacobian
from fusion_sfdia.detectors import registry
from fusion_sfdia.models.gas_pipeline.physics import pipeline_parameters
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.models.marine_engine.faults import EngineFault
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.plant import marine_engine
from fusion_sfdia.models.power_network.operation import AreaFault, Switch
from fusion_sfdia.models.power_network.parameters import generate_network
from fusion_sfdia.models.power_network.plant import power_network
from fusion_sfdia.models.power_network.unknown import altered
from fusion_sfdia.models.two_tanks.plant import INFLOW, two_tanks
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
EPS = np.finfo(float).eps
PLANTS = sorted(registry.plants())
AREAS = generate_network(6, 3)


def states(plant: Plant, count: int = 3) -> tuple[Array, Array]:
    """States and inputs about the initial ones, within the limits of the model."""
    rng = np.random.default_rng(8)
    x = plant.x0 + plant.state_scale * rng.standard_normal((count, plant.x0.size))
    u = np.broadcast_to(plant.input_at(0.0), (count, len(plant.inputs)))
    return plant.guard(x)[0], u * (1 + 0.01 * rng.standard_normal(u.shape))


def at(plant: Plant, theta: Array, x: Array, u: Array) -> tuple[Array, Array]:
    """Step and output at theta."""
    known = plant.uncertainty
    assert known.step is not None
    y = plant.output(0.0, x, u) if known.output is None else known.output(0.0, x, u, theta)
    return known.step(0.0, x, u, plant.dt, theta), y


def other_engine(values: dict[str, float]) -> Plant:
    return marine_engine(parameters=engine_parameters()._replace(**values))


def other_pipe(values: dict[str, float]) -> Plant:
    return gas_pipeline(nodes=11, parameters=pipeline_parameters(**values))


def other_network(values: dict[str, float]) -> Plant:
    return power_network(altered(AREAS, **values), loads=())


@pytest.mark.parametrize(
    ("plant", "rebuild", "operations"),
    [
        (marine_engine(), other_engine, 20),
        (gas_pipeline(nodes=11), other_pipe, 20),
        (power_network(AREAS, loads=()), other_network, 60),
    ],
    ids=["marine-engine", "gas-pipeline", "power-network"],
)
def test_the_model_at_other_values_is_the_plant_built_with_them(
    plant: Plant, rebuild: Callable[[dict[str, float]], Plant], operations: int
) -> None:
    """The same equations, compiled into another driver, or sums of areas in another order."""
    known, rng = plant.uncertainty, np.random.default_rng(9)
    x, u = states(plant)
    theta = known.nominal + known.sd * rng.uniform(-1.0, 1.0, (3, known.sd.size))
    together = at(plant, theta, x, u)
    for k in range(3):
        other = rebuild({p.name: float(value) for p, value in zip(known.parameters, theta[k], strict=True)})
        for found, expected in zip(
            (a[k] for a in together), (other.step(0.0, x[k], u[k], plant.dt), other.output(0.0, x[k], u[k])), strict=True
        ):
            np.testing.assert_allclose(found, expected, rtol=0, atol=rounding(1.0, operations) * np.abs(expected).max())


def test_outlets_and_leak_of_the_tanks_by_hand() -> None:
    plant = two_tanks()
    level, dt = np.array([0.81, 1.21]), 1e-6
    known = plant.uncertainty
    assert known.step is not None and known.output is not None
    theta = np.array([5e-4, 7e-4, 1e-5])
    flow = known.output(0.0, level, np.full(1, INFLOW), theta)[2:]
    np.testing.assert_allclose(flow, [5e-4 * 0.9, 7e-4 * 1.1], rtol=4 * EPS)
    rise = (known.step(0.0, level, np.full(1, INFLOW), dt, theta) - level) / dt
    # the difference of levels loses eps / dt; the step errs by dt / tau of the rise, tau > 100 s
    expected = [(INFLOW - flow[0]) / 0.05, (flow[0] - flow[1] - 1e-5) / 0.05]
    np.testing.assert_allclose(rise, expected, rtol=0, atol=4 * EPS / dt + 0.01 * dt)


@pytest.mark.parametrize(
    "plant",
    [two_tanks(), marine_engine(load=0.6, slip="constant"), gas_pipeline(nodes=11), power_network(AREAS)],
    ids=lambda plant: plant.name,
)
def test_derivatives_hold_away_from_the_nominal_values(plant: Plant) -> None:
    """The sensitivity to states is that at the parameters of the state, too, not at the nominal ones."""
    larger = augment(plant)
    n, rng = plant.x0.size, np.random.default_rng(10)
    z = np.broadcast_to(larger.x0, (3, larger.x0.size)).copy()
    z[:, :n], u = states(plant)
    z[:, n:] += larger.state_scale[n:] * rng.uniform(-0.9, 0.9, (3, larger.x0.size - n))
    for jacobian, function in (
        (larger.step_jacobian_at(0.0, z, u, plant.dt), partial(_step, larger, u)),
        (
            np.broadcast_to(larger.output_jacobian_at(0.0, z, u), (3, len(plant.sensors), z.shape[-1])),
            partial(_read, larger, u),
        ),
    ):
        expected = difference_jacobian(function, z, larger.state_scale) * larger.state_scale
        scale = np.abs(expected).max(axis=-1, keepdims=True)
        # differences of width eps^(1/3): eps^(2/3) of the third derivative, and the rounding of x over the scale, 1e4 in Pa
        np.testing.assert_allclose(jacobian * larger.state_scale / scale, expected / scale, rtol=0, atol=1e4 * EPS ** (2 / 3))


def _step(plant: Plant, u: Array, z: Array) -> Array:
    return plant.step(0.0, z, u[:, None], plant.dt)


def _read(plant: Plant, u: Array, z: Array) -> Array:
    return plant.output(0.0, z, np.broadcast_to(u[:, None], (*z.shape[:-1], u.shape[-1])))


@pytest.mark.parametrize("name", PLANTS)
def test_each_parameter_has_a_source_and_is_within_its_limits(name: str) -> None:
    known = registry.plant(name).uncertainty
    assert known.parameters and known.inputs
    for p in known.parameters:
        assert p.source and p.unit and p.low < p.nominal - p.sd and p.nominal + p.sd < p.high
    inputs = {s.name: s for s in registry.plant(name).inputs}
    assert all(sd < 0.2 * max(1.0, abs(inputs[n].nominal)) for n, sd in known.inputs.items())


@pytest.mark.parametrize(
    ("name", "steps", "least"), [("two-tanks", 100, 1.0), ("gas-pipeline", 60, 0.2), ("marine-engine", 500, 0.2)]
)
def test_each_changes_the_readings(name: str, steps: int, least: float) -> None:
    """By so many standard deviations of a reading, for one of the parameter; hundreds of readings show a fifth."""
    plant = registry.plant(name)
    larger = augment(plant)
    n = plant.x0.size
    z = np.repeat(larger.x0[None], 1 + larger.x0.size - n, axis=0)
    z[1:, n:] += np.diag(larger.state_scale[n:])
    largest = np.zeros(len(z) - 1)
    for k in range(steps):
        u = np.broadcast_to(plant.input_at(k * plant.dt), (len(z), len(plant.inputs)))
        z = larger.step(k * plant.dt, z, u, plant.dt)
        y = larger.output((k + 1) * plant.dt, z, u)
        largest = np.maximum(largest, np.max(np.abs(y[1:] - y[0]) / plant.sensor_sigma, axis=-1))
    assert np.all(largest > least), dict(zip([s.name for s in larger.states[n:]], largest, strict=True))


def test_a_smooth_or_insulated_pipe_does_not_declare_what_it_has_not() -> None:
    names = [p.name for p in gas_pipeline(nodes=11, parameters=pipeline_parameters(friction=0.01)).uncertainty.parameters]
    assert names == ["ambient", "heat_transfer", "gas_constant"]
    insulated = gas_pipeline(nodes=11, parameters=pipeline_parameters(heat_transfer=0.0))
    assert [p.name for p in insulated.uncertainty.parameters] == ["roughness", "ambient", "gas_constant"]
    x, u = states(insulated)
    theta = insulated.uncertainty.nominal
    np.testing.assert_array_equal(at(insulated, theta, x, u)[0], insulated.step(0.0, x, u, 10.0))


def test_a_plant_with_a_fault_is_a_truth_and_declares_nothing() -> None:
    assert not marine_engine(process_faults=[EngineFault("heavy-propeller", 0.1)]).uncertainty.stated
    assert not power_network(AREAS, loads=(), faults=[AreaFault("load-loss", "1", 0.1)]).uncertainty.stated


def test_slopes_of_open_ties_have_no_effect_and_switches_are_known() -> None:
    plant = power_network(AREAS, loads=(), switches=[Switch(10.0, unplug=("2",))])
    known = plant.uncertainty
    x, u = states(plant)
    assert known.step is not None and known.step_jacobian is not None
    for t in (0.0, 20.0):
        close = rounding(1.0, 60) * np.abs(x).max()
        np.testing.assert_allclose(known.step(t, x, u, 1.0, known.nominal), plant.step(t, x, u, 1.0), rtol=0, atol=close)
    ties = [i for i, p in enumerate(known.parameters) if p.name.startswith("slope") and "2" in p.name[6:].split("-")]
    columns = x.shape[-1] + u.shape[-1] + np.array(ties)
    assert known.step_jacobian(0.0, x, u, 1.0, known.nominal)[..., columns].any(axis=(0, 1)).all()
    assert not known.step_jacobian(20.0, x, u, 1.0, known.nominal)[..., columns].any()


def test_the_exact_network_declares_the_same_by_secants() -> None:
    plant, local = power_network(AREAS, loads=(), discretisation="exact"), power_network(AREAS, loads=())
    known = plant.uncertainty
    assert [p.name for p in known.parameters] == [p.name for p in local.uncertainty.parameters]
    x, u = states(plant)
    first = known.parameters[0]
    theta = known.nominal.copy()
    theta[0] += first.sd
    other = power_network(altered(AREAS, **{first.name: theta[0]}), loads=(), discretisation="exact")
    close = rounding(1.0, 200) * np.abs(x).max()  # f + (f+ - f-) / 2 + ... of sums over 24 states, each pair without effect
    np.testing.assert_allclose(at(plant, theta, x, u)[0], other.step(0.0, x, u, 1.0), rtol=0, atol=close)


def test_what_a_plant_in_other_units_declares_is_the_same() -> None:
    plant = marine_engine()
    bar = plant.in_units({"S(3){1}": ("bar", 1e-5)})
    x, u = states(plant)
    theta = plant.uncertainty.nominal + plant.uncertainty.sd
    ratio = np.where(np.array(plant.sensor_names) == "S(3){1}", 1e-5, 1.0)
    np.testing.assert_allclose(at(bar, theta, x, u)[1], at(plant, theta, x, u)[1] * ratio, rtol=2 * EPS)
    assert replace(bar.uncertainty, output=None).parameters == plant.uncertainty.parameters
