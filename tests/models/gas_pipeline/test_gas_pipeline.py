"""The plant gas-pipeline: published numbers, balances, orders of convergence, Jacobian, limits, bad input."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.filters.estimators import Ensemble, Unscented
from fusion_sfdia.learning.builders import PAPER_FILTERS
from fusion_sfdia.models.gas_pipeline import equations
from fusion_sfdia.models.gas_pipeline.physics import (
    INLET_PRESSURE,
    INLET_TEMPERATURE,
    pipeline_parameters,
    pipeline_physics,
    steady_state,
)
from fusion_sfdia.models.gas_pipeline.plant import SIGMA, coarse_state, demand, gas_pipeline
from fusion_sfdia.plant.integration import runge_kutta_4
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

C = pipeline_parameters()
AREA = np.pi / 4 * C.diameter**2
SCALE = np.repeat([500.0, 2.5, 1.5], 21)  # moderate sigma, to put Pa, kg/s and K on one footing


@pytest.fixture(scope="module")
def plant() -> Plant:
    return gas_pipeline()


def trajectory(plant: Plant, seconds: float, flow: Any = demand) -> Array:
    """States (1 + steps, n) under the boundary values at the ends of the steps."""
    x, states = plant.x0, [plant.x0]
    for k in range(round(seconds / plant.dt)):
        u = np.array([INLET_PRESSURE, INLET_TEMPERATURE, flow((k + 1) * plant.dt)])
        x = plant.step(k * plant.dt, x, u, plant.dt)
        states.append(x)
    return np.array(states)


def rms(difference: Array) -> Array:
    """Over time and nodes, of pressure, flow and temperature (3,)."""
    root: Array = np.sqrt(np.mean(difference.reshape(-1, 3, difference.shape[-1] // 3) ** 2, axis=(0, 2)))
    return root


# --- published values


def test_the_pipe_the_noise_and_the_filters_are_the_papers() -> None:
    """Shaheen 2024: Table II (the pipe), Table III (noise of MPa, kg/s and K, there in MPa) and sec. V-A (the filters)."""
    assert (C.length, C.diameter, C.roughness, C.ambient, C.heat_transfer) == (150e3, 1.4, 0.016e-3, 278.15, 2.84)
    assert SIGMA == {"high": (50.0, 0.25, 0.15), "moderate": (500.0, 2.5, 1.5), "low": (1000.0, 10.0, 6.0)}
    unscented, ensemble = PAPER_FILTERS["ukf"], PAPER_FILTERS["enkf"]
    assert isinstance(unscented, Unscented) and isinstance(ensemble, Ensemble)
    assert (unscented.points.alpha, unscented.points.beta, ensemble.settings.size) == (1e-3, 2.0, 40)


def test_dimensions_and_names(plant: Plant) -> None:
    assert plant.name == "gas-pipeline"
    assert len(plant.states) == len(plant.sensors) == 63
    assert [plant.states[i].name for i in (0, 20, 21, 62)] == ["p_0", "p_20", "m_0", "T_20"]
    assert [plant.sensors[i].measures for i in (0, 20, 21, 62)] == ["p_0", "p_20", "m_0", "T_20"]
    assert {k: v.size for k, v in plant.quantities.items()} == {"pressure": 21, "mass flow": 21, "temperature": 21}
    assert plant.x0[0] == 8.4e6
    assert plant.x0[42] == 303.15


@pytest.mark.parametrize("snr", ["high", "moderate", "low"])
def test_noise_settings(snr: str) -> None:
    p, m, T = SIGMA[snr]
    plant = gas_pipeline(snr=snr)
    np.testing.assert_array_equal(plant.sensor_sigma, np.repeat([p, m, T], 21))
    np.testing.assert_array_equal(plant.initial_cov, plant.sensor_cov)
    np.testing.assert_allclose(plant.process_cov, 0.01 * plant.sensor_cov, rtol=1e-14)
    np.testing.assert_allclose(gas_pipeline(snr=snr, process_noise="nine-tenths").process_cov, 0.81 * plant.sensor_cov)
    assert gas_pipeline(snr=snr, initial="identity").initial_cov[[0, 21, 42]] == pytest.approx([1e12, 1.0, 1.0])


# --- balances


def linepack(x: Array) -> Array:
    """Mass in the pipe, kg, by Simpson's rule over the nodes (odd in number)."""
    n = x.shape[-1] // 3
    p, T = x[..., :n], x[..., 2 * n :]
    weights = np.full(n, 2.0)
    weights[1::2], weights[[0, -1]] = 4.0, 1.0
    mass: Array = p / (equations.gas(p, T, C)[0] * C.gas_constant * T) @ weights * AREA * C.length / (n - 1) / 3
    return mass


def test_mass_balance() -> None:
    """Change of linepack = inflow - outflow over the fast ramp, to the error of the scheme."""
    plant = gas_pipeline(nodes=81)
    x = trajectory(plant, 1200.0)
    gained = linepack(x) - linepack(x[0])
    net = x[:, 81] - x[:, 161]
    exchanged = np.concatenate([[0.0], np.cumsum((net[1:] + net[:-1]) / 2) * plant.dt])  # m runs linearly in a step
    assert np.abs(gained - exchanged).max() < 1e-4 * np.abs(gained).max()
    mean_p, mean_T = x[0, :81].mean(), x[0, 162:].mean()
    rho = mean_p / (equations.gas(mean_p, mean_T, C)[0] * C.gas_constant * mean_T)
    assert linepack(x[0]) == pytest.approx(rho * C.length * AREA, rel=3e-3)  # the profile is nearly linear


def test_energy_balance_of_an_insulated_pipe() -> None:
    """With no heat exchanged, h + v^2/2 is the same everywhere: friction heats what throttling cools."""
    c = pipeline_parameters(heat_transfer=0.0)
    n = 301
    x = steady_state(n, 450.0, c)
    p, T = x[:n], x[2 * n :]
    z, alpha_1, _, cp = equations.gas(p, T, c)
    rho = p / (z * c.gas_constant * T)
    h_p = (1 - alpha_1) / rho
    change = np.sum((cp[1:] + cp[:-1]) / 2 * np.diff(T)) + np.sum((h_p[1:] + h_p[:-1]) / 2 * np.diff(p))
    kinetic = np.diff((450.0 / (rho * AREA))[[0, -1]] ** 2)[0] / 2
    throttling = cp.mean() * (T[0] - T[-1])
    assert throttling > 5e3  # J/kg: what would be missing otherwise
    assert abs(change + kinetic) < 1e-5 * throttling  # trapezoidal rule, ds^2


# --- numerics


def test_boundary_reaches_its_input(plant: Plant) -> None:
    u = np.array([8.41e6, 302.0, 312.0])
    for p in (plant, gas_pipeline(substeps=3)):
        x = p.step(0.0, p.x0, u, 10.0)
        np.testing.assert_allclose(x[[0, 42, 41]], u, rtol=1e-14)


def test_step_is_runge_kutta_of_the_physics(plant: Plant) -> None:
    """The compiled step against RK4 over the arrays' right-hand side, in one and in two substeps."""
    physics = pipeline_physics(21, C)
    rng = np.random.default_rng(4)
    x = plant.x0 + SCALE * rng.normal(size=(5, 63))
    u = np.array([8.41e6, 303.0, 320.0])
    rate = (u - x[:, [0, 42, 41]]) / 10.0
    for substeps in (1, 2):
        slow = x
        for _ in range(substeps):
            slow = runge_kutta_4(lambda t, s: physics.f(t, s, np.zeros(0), rate, C), 0.0, slow, 10.0 / substeps)
        fast = gas_pipeline(substeps=substeps).step(0.0, x, u, 10.0)
        np.testing.assert_allclose(fast / SCALE, slow / SCALE, atol=1e-8)  # pressures are 16 800 sigma: 12 digits


def test_batch_is_a_loop(plant: Plant) -> None:
    rng = np.random.default_rng(5)
    x = plant.x0 + SCALE * rng.normal(size=(2, 3, 63))
    u = plant.input_at(0.0) + rng.normal(size=(2, 1, 3)) * [1e3, 0.1, 5.0]
    together, jacobians = plant.step(0.0, x, u, 10.0), plant.step_jacobian_at(0.0, x, u, 10.0)
    assert together.shape == (2, 3, 63)
    assert jacobians.shape == (2, 3, 63, 63)
    for i in range(2):
        for j in range(3):
            np.testing.assert_array_equal(together[i, j], plant.step(0.0, x[i, j], u[i, 0], 10.0))
            np.testing.assert_array_equal(jacobians[i, j], plant.step_jacobian_at(0.0, x[i, j], u[i, 0], 10.0))


@pytest.mark.parametrize(("nodes", "substeps"), [(21, 1), (21, 3), (41, None)])
def test_jacobian_is_that_of_the_step(nodes: int, substeps: int | None) -> None:
    plant = gas_pipeline(nodes=nodes, substeps=substeps)
    scale = np.repeat([500.0, 2.5, 1.5], nodes)
    x = plant.x0 + scale * np.random.default_rng(6).normal(size=3 * nodes)
    u = np.array([8.41e6, 303.0, 320.0])
    ours = plant.step_jacobian_at(0.0, x, u, 10.0)
    exact = complex_step_jacobian(lambda s: plant.step(0.0, s, u, 10.0), x)
    # the chain rule of four stages in each substep, of sums of five terms and products of twenty factors, entries of some 10
    near = rounding(10, 4 * (substeps or 4) * (5 + 20))
    np.testing.assert_allclose(ours * scale / scale[:, None], exact * scale / scale[:, None], rtol=0, atol=near)
    # the inputs' part: the boundary forgets where it was
    np.testing.assert_allclose(ours[[0, 2 * nodes, 2 * nodes - 1]], 0.0, atol=near)


def test_order_in_time() -> None:
    """RK4 at 21 nodes: errors of 2, 4, 8 substeps against 64 fall as the fourth power."""

    def flow(t: float) -> float:
        return 300.0 + 100.0 * np.sin(np.pi * t / 3600.0) ** 6

    best = trajectory(gas_pipeline(substeps=64), 1200.0, flow)
    errors = np.array([rms(trajectory(gas_pipeline(substeps=s), 1200.0, flow) - best) for s in (2, 4, 8)])
    orders = -np.polyfit(np.log([2, 4, 8]), np.log(errors), 1)[0]
    # the next order halves from pair to pair: 4.25 and 4.12 between neighbours
    np.testing.assert_allclose(orders, 4, rtol=0, atol=0.3)


def test_order_in_space() -> None:
    """The five-point stencil on 30 km, where the slow thermal wave (5 m/s) is resolved, by grids that are twice as fine.

    Its error is of fourth order inside and at the boundary, and one of order p at the boundary is one of order p + 1 in the
    solution (Gustafsson 1975): flow and temperature show the inside, 4, pressure the boundary, 5. All grids take the same
    substeps, so that the error of the time cancels.
    """
    c = pipeline_parameters(length=30e3)

    def run(nodes: int) -> Array:
        plant = gas_pipeline(nodes=nodes, dt=1.0, substeps=4, parameters=c)
        x = trajectory(plant, 3600.0, lambda t: 300.0 + 100.0 * np.sin(np.pi * t / 3600.0) ** 6)
        return coarse_state(x, 21)

    coarse, middle, fine = (run(nodes) for nodes in (41, 81, 161))
    orders = np.log2(rms(coarse - middle) / rms(middle - fine))
    # the next order is not nothing yet: on 61, 121 and 241 nodes the orders found differ by 0.2 from these
    np.testing.assert_allclose(orders, [5, 4, 4], rtol=0, atol=0.25)


def test_against_a_finer_grid(plant: Plant) -> None:
    """An hour of the demand, 21 nodes against 161, both with the same boundary values at the same times."""
    fine = gas_pipeline(nodes=161, stations=21)
    error = rms(trajectory(plant, 3600.0) - coarse_state(trajectory(fine, 3600.0), 21))
    # ten or more times below moderate sigma: the grid is no source of false alarms
    assert np.all(error < [12.0, 0.03, 0.015]), error
    assert np.all(error < 0.1 * np.array(SIGMA["moderate"]))


# --- sensors at every k-th node


def test_stations_of_a_finer_truth(plant: Plant) -> None:
    fine = gas_pipeline(nodes=81, stations=21)
    assert fine.sensor_names == plant.sensor_names
    assert fine.sensors[1].measures == "p_4"
    np.testing.assert_allclose(coarse_state(fine.x0, 21), plant.x0, rtol=1e-11)
    np.testing.assert_array_equal(fine.output(0.0, fine.x0, np.zeros(3)), coarse_state(fine.x0, 21))
    np.testing.assert_array_equal(fine.output_jacobian_at(0.0, fine.x0, np.zeros(3)) @ fine.x0, coarse_state(fine.x0, 21))
    recording = simulate(plant, 12, [1, 2], truth=fine, to_states=lambda x: coarse_state(x, 21))
    assert recording.x is not None
    assert recording.x[-1, 0, 41] == pytest.approx(demand(120.0), rel=1e-12)  # the outlet is where the demand is
    np.testing.assert_array_equal(recording.x, recording.signal)


def test_other_pipes_differ() -> None:
    """Truth and filter may be of different pipes: a rougher one loses more pressure, a colder ground cools more."""
    base = steady_state(21, 300.0, C)
    assert steady_state(21, 300.0, C._replace(roughness=0.03e-3))[20] < base[20] - 1e4
    assert steady_state(21, 300.0, C._replace(ambient=276.15))[62] < base[62] - 1.0
    assert np.any(gas_pipeline(parameters=pipeline_parameters(diameter=1.39)).x0 != gas_pipeline().x0)


@pytest.mark.parametrize("nodes", [201, 2001])
def test_large_grids(nodes: int) -> None:
    plant = gas_pipeline(nodes=nodes, stations=21)
    assert plant.initial_cov.shape == plant.process_cov.shape == (3 * nodes,)
    x = plant.step(0.0, plant.x0, plant.input_at(0.0), 10.0)
    expected = gas_pipeline().step(0.0, gas_pipeline().x0, plant.input_at(0.0), 10.0)
    np.testing.assert_allclose(coarse_state(x, 21) / SCALE, expected / SCALE, atol=0.02)
    if nodes > 600:
        with pytest.raises(ValueError, match="use the ensemble filter"):
            plant.step_jacobian_at(0.0, plant.x0, plant.input_at(0.0), 10.0)


# --- limits and bad input


def test_limits_flag_what_leaves_the_model(plant: Plant) -> None:
    assert not plant.guard(plant.x0)[1]
    for i, value in ((3, 1.3e7), (3, 0.5e6), (30, -5.0), (50, 350.0), (50, np.nan)):
        x = plant.x0.copy()
        x[i] = value
        assert plant.guard(x)[1]
    # several standard deviations of the noisiest setting fit in
    low, high = plant.state_limits
    margin = 4 * np.repeat(SIGMA["low"], 21)
    assert np.all((plant.x0 - margin > low) & (plant.x0 + margin < high))


def test_simulation_stops_where_the_model_ends(plant: Plant) -> None:
    with pytest.raises(ArithmeticError):
        simulate(plant, 400, [1], inputs=lambda t: np.array([INLET_PRESSURE, INLET_TEMPERATURE, 1900.0]))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"nodes": 6}, "at least 7 nodes"),
        ({"nodes": 81, "stations": 22}, "every k-th"),
        ({"stations": 0}, "every k-th"),
        ({"dt": -1.0}, "dt is -1.0 s"),
        ({"dt": float("nan")}, "dt is nan s"),
        ({"substeps": 0}, "use substeps=1"),
        ({"snr": "medium"}, "known: high, moderate, low"),
        ({"process_noise": "10 %"}, "known: tenth, nine-tenths"),
        ({"initial": "zero"}, "known: noise, identity"),
        ({"parameters": C._replace(length=-1.0)}, "length is -1.0"),
        ({"parameters": C._replace(z=np.zeros((4, 5)))}, r"expected \(6, 7\)"),
    ],
)
def test_bad_settings(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        gas_pipeline(**settings)


def test_second_process_starts_from_the_cache(root: Path) -> None:
    """Machine code on disk, parameters as a NamedTuple included: nothing is compiled twice."""
    gas_pipeline().step(0.0, gas_pipeline().x0, np.array([8.4e6, 303.15, 300.0]), 10.0)
    script = (
        "from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline, equations\n"
        "p = gas_pipeline(); p.step(0.0, p.x0, p.input_at(0.0), 10.0)\n"
        "print(sum(equations.advance.stats.cache_hits.values()), sum(equations.advance.stats.cache_misses.values()))"
    )
    environment = os.environ | {"PYTHONPATH": str(root)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    hits, misses = map(int, done.stdout.split())
    assert hits > 0 and misses == 0


def test_the_outlet_flow_can_be_set() -> None:
    plant = gas_pipeline(outlet_flow=lambda t: 200.0 + t)
    np.testing.assert_array_equal(plant.x0[21:42], 200.0)
    assert plant.input_at(0.0)[2] == 210.0  # at the end of the step, to which it runs
    same = gas_pipeline(outlet_flow=demand)
    np.testing.assert_array_equal(same.x0, gas_pipeline().x0)
    assert plant.truth.finer is not None and plant.truth.finer()[0].input_at(0.0)[2] == 210.0
