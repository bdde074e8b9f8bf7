"""The power network: laws of its physics, discretisations, areas that join and leave, the plant."""

from __future__ import annotations

import numpy as np
import pytest
from network_loop import rates

from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.power_network import equations
from fusion_sfdia.models.power_network.area_model import area_model
from fusion_sfdia.models.power_network.control import generation_control
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import AreaFault, Switch
from fusion_sfdia.models.power_network.parameters import load_network
from fusion_sfdia.models.power_network.plant import network_physics, power_network
from fusion_sfdia.plant.plant import Plant

MODEL = network_model()
RNG = np.random.default_rng(1)
X = 0.1 * RNG.standard_normal((15, 4))
LOAD, REFERENCE = 0.2 * RNG.standard_normal((2, 15))
EPS = np.finfo(float).eps


def test_power_balances() -> None:
    """The power into the areas' inertia is generation less consumption: the ties only carry power."""
    taken = 2 * MODEL.constants[:, 0] * rates(MODEL, X, REFERENCE, LOAD)[:, 1]
    made = X[:, 2] - MODEL.constants[:, 2] * X[:, 1] - LOAD
    largest = np.abs(MODEL.stiffness * X[:, 0]).max() + np.abs(taken).max()
    assert abs(taken.sum() - made.sum()) < 200 * EPS * largest  # some hundred additions


def test_a_tie_carries_what_one_end_gives_to_the_other() -> None:
    assert equations.tie_flow(0.3, 0.1, 4.0) == -equations.tie_flow(0.1, 0.3, 4.0)
    at = MODEL.network.topology
    theta = X[:, 0]
    out = np.zeros(15)
    np.add.at(out, at.node, equations.tie_flow(theta[at.node], theta[at.neighbour], MODEL.side_slope))
    expected = MODEL.stiffness * theta - MODEL.external(theta, np.zeros(15))
    assert out == pytest.approx(expected, abs=20 * EPS)


def test_only_differences_of_angles_matter() -> None:
    shifted = X.copy()
    shifted[:, 0] += 0.5
    assert rates(MODEL, shifted, REFERENCE, LOAD) == pytest.approx(rates(MODEL, X, REFERENCE, LOAD), abs=100 * EPS)


@pytest.mark.parametrize("discretisation", ["area-by-area", "exact"])
def test_references_that_follow_the_loads_are_an_equilibrium(discretisation: str) -> None:
    model = network_model(discretisation=discretisation)
    x = np.zeros((15, 4))
    x[:, 2:] = LOAD[:, None]
    assert np.abs(rates(model, x, LOAD, LOAD)).max() < 10 * EPS
    after = x
    for _ in range(50):
        after = model.step(after, LOAD, LOAD)
    assert np.abs(after - x).max() < 1e-11  # rounding of F is 4e-13 a step, and the common angle keeps what it gets


def test_the_matrices_are_those_of_the_paper() -> None:
    H, R, D, T_t, T_g = load_network().constants[3]
    area = area_model(MODEL, "4")
    total = 2 + 3 + 2  # ties to 3, 5, 13
    assert area.A == pytest.approx(
        np.array(
            [
                [0, 1, 0, 0],
                [-total / (2 * H), -D / (2 * H), 1 / (2 * H), 0],
                [0, 0, -1 / T_t, 1 / T_t],
                [0, -1 / (R * T_g), 0, -1 / T_g],
            ]
        ),
        rel=4 * EPS,
    )
    assert area.B.tolist() == [0, 0, 0, 1 / T_g]
    assert area.L.tolist() == [0, -1 / (2 * H), 0, 0]
    assert area.neighbours == ("3", "5", "13")
    assert area.coupling[:, 1, 0] == pytest.approx(np.array([2, 3, 2]) / (2 * H))
    assert np.count_nonzero(area.coupling) == 3


def test_the_physics_has_the_same_matrix() -> None:
    physics, x = network_physics(MODEL), X.ravel()
    u = np.concatenate([REFERENCE, LOAD])
    jacobian = complex_step_jacobian(lambda p: physics.f(0.0, p, p[..., :0], u, None), x)
    a, b, load = MODEL.continuous
    assert jacobian == pytest.approx(a, abs=4 * EPS * np.abs(a).max())
    flat = physics.f(0.0, x, x[:0], u, None)
    assert a @ x + b @ REFERENCE + load @ LOAD == pytest.approx(flat, abs=100 * EPS * np.abs(flat).max())


# the plant


def test_the_plant_has_the_sensors_of_the_paper() -> None:
    plant = power_network()
    assert (len(plant.states), len(plant.sensors), len(plant.inputs)) == (60, 94, 30)
    assert {q: len(s) for q, s in plant.quantities.items()} == {
        "angle": 15 + 34, "speed": 15, "mechanical power": 15, "valve": 15,
    }  # fmt: skip
    readers = {s.owner for s in plant.sensors if s.measures == "theta_4"}
    assert readers == {"area 4", "area 3", "area 5", "area 13"}
    assert plant.sensor_sigma[:4] ** 2 == pytest.approx([1e-5, 1e-5, 1e-4, 1e-4])


@pytest.mark.parametrize(("noise", "variance"), [("lit", [1e-4] * 4), ("small", [1e-5, 1e-5, 1e-4, 1e-4])])
def test_the_two_interpretations_of_the_process_noise(noise: str, variance: list[float]) -> None:
    assert power_network(noise=noise).process_cov[:4].tolist() == variance
    assert power_network(noise=noise, dt=0.5).process_cov[:4].tolist() == [v / 2 for v in variance]


@pytest.mark.parametrize("areas", [15, 6])
@pytest.mark.parametrize("discretisation", ["area-by-area", "exact"])
def test_jacobians_are_those_of_the_step(areas: int, discretisation: str) -> None:
    plant = power_network(areas, discretisation=discretisation)
    x = RNG.standard_normal((2, len(plant.states)))
    u = RNG.standard_normal((2, len(plant.inputs)))
    numerical = complex_step_jacobian(lambda p: plant.step(0.0, p, u[:, None], plant.dt), x)
    assert numerical == pytest.approx(np.broadcast_to(plant.step_jacobian_at(0.0, x, u, plant.dt), numerical.shape), abs=1e-12)
    readout = plant.output_jacobian_at(0.0, x, u)
    assert np.array_equal(x @ readout.T, plant.output(0.0, x, u))


def run(plant: Plant, steps: int) -> np.ndarray:
    x = plant.x0
    for k in range(steps):
        x = plant.step(float(k), x, plant.input_at(float(k)), plant.dt)
    return x


def test_a_step_of_load_with_a_reference_that_follows_shifts_angles_and_nothing_else() -> None:
    plant = power_network(loads=[])
    assert not run(plant, 20).any()
    settled = run(power_network(), 2000).reshape(15, 4)
    assert np.abs(settled[:, 1]).max() < 1e-9
    assert settled[:, 2] == pytest.approx(power_network().input_at(2000.0)[:15], abs=1e-9)


def test_simulations_take_the_exact_network_for_the_truth() -> None:
    plant, exact = power_network(unplugged=iter(["15"])), power_network(unplugged=["15"], discretisation="exact")
    assert exact.truth.finer is None
    a, b = simulate(plant, 30, [0]), simulate(exact, 30, [0], truth="model")
    assert np.array_equal(a.y, b.y)
    assert a.x is not None and not np.array_equal(a.x, simulate(plant, 30, [0], truth="model").x)


def test_its_usual_operation_is_in_closed_loop() -> None:
    plant = power_network()
    found = simulate(plant, 400, [0, 1], process_noise=True)
    load, own = found.u[1:, :, 15:], found.y[:-1, :, :60].reshape(399, 2, 15, 4)
    assert np.array_equal(found.u[1:, :, :15], generation_control(MODEL, own, load))
    # the exact model follows from what is recorded but for the process noise, of known variance: of 48 000 draws none beyond
    # 6 deviations (odds 1e-4)
    exact = power_network(discretisation="exact")
    assert found.x is not None
    predicted = exact.step(0.0, found.x[:-1], found.u[1:], plant.dt)
    assert np.abs((found.x[1:] - predicted) / np.sqrt(plant.process_cov)).max() < 6


def test_faults_and_switches_make_another_truth() -> None:
    settings = {"faults": [AreaFault("governor", "4", 1000.0, onset=42.0)], "switches": [Switch(60.0, unplug=("4",))]}
    healthy, faulty = power_network(), power_network(**settings)  # type: ignore[arg-type]
    readings = {name: simulate(healthy, 80, [3], truth=p).signal[:, 0] for name, p in (("h", healthy), ("f", faulty))}
    different = np.any(readings["h"] != readings["f"], axis=1)
    assert not different[:42].any() and different[42:].all()  # row k is the reading at k + 1 s


def test_impossible_plants_are_refused() -> None:
    for settings, message in (
        ({"areas": 1}, "at least 2"),
        ({"faults": [AreaFault("governor", "16", 1.0)]}, "unknown node '16'"),
        ({"switches": [Switch(1.0, plug_in=("3",))]}, "'3' is plugged in already"),
    ):
        with pytest.raises(ValueError, match=message):
            power_network(**settings)  # type: ignore[arg-type]
