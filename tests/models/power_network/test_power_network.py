"""The power network: laws of its physics, discretisations, areas that join and leave, the plant."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from fusion_sfdia.core.equation import complex_step_jacobian
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.simulate import simulate
from fusion_sfdia.models.power_network import equations
from fusion_sfdia.models.power_network.control import generation_control
from fusion_sfdia.models.power_network.model import NetworkModel, network_model
from fusion_sfdia.models.power_network.operation import AreaFault, Switch
from fusion_sfdia.models.power_network.parameters import generate_network, load_network
from fusion_sfdia.models.power_network.plant import network_physics, network_sensors, power_network

MODEL = network_model()
NAMES = MODEL.names
RNG = np.random.default_rng(1)
X = 0.1 * RNG.standard_normal((15, 4))
LOAD, REFERENCE = 0.2 * RNG.standard_normal((2, 15))
EPS = np.finfo(float).eps


def rates(model: NetworkModel, x: np.ndarray, reference: np.ndarray, load: np.ndarray) -> np.ndarray:
    physics = network_physics(model)
    n = len(model.names)
    flat = x.reshape(*x.shape[:-2], 4 * n)
    u = np.concatenate(np.broadcast_arrays(reference, load), axis=-1)
    return physics.f(0.0, flat, flat[..., :0], u, None).reshape(*flat.shape[:-1], n, 4)


def test_power_balances() -> None:
    """What the areas' inertia takes up is what is made less what is used: the ties only carry it."""
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
    area = MODEL.area_model("4")
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


@pytest.mark.parametrize("governor_time", [0.1, 1000.0, 1e-3])
def test_the_hold_is_the_matrix_exponential(governor_time: float) -> None:
    constants = load_network().constants.copy()
    constants[:, 4] = governor_time
    matrices = equations.area_matrices(MODEL.stiffness, constants)
    whole = np.zeros((15, 6, 6))
    whole[:, :4] = matrices
    held = equations.hold(matrices, 1.0)
    # squaring s times multiplies rounding by 2^s, some norm of A dt
    assert np.abs(held - expm(whole)[:, :4]).max() < 20 * EPS * np.abs(matrices).sum(axis=2).max() * np.abs(held).max()


def advanced(discretisation: str, parts: int) -> np.ndarray:
    """The transition of the whole network over 1 s in equal parts."""
    return np.linalg.matrix_power(network_model(discretisation=discretisation, dt=1 / parts).matrices[0], parts)


def test_the_exact_discretisation_does_not_depend_on_the_step() -> None:
    a = network_model().continuous[0]
    for parts in (1, 4):
        assert np.abs(advanced("exact", parts) - expm(a)).max() < 1e-11


def test_area_by_area_is_of_first_order() -> None:
    exact = expm(network_model().continuous[0])
    error = [np.abs(advanced("area-by-area", parts) - exact).max() for parts in (64, 128, 256)]
    # halving the step halves the error, but for the second order, which halves itself
    assert abs(error[1] / error[2] - 2) < 0.6 * abs(error[0] / error[1] - 2) < 0.2


def test_how_far_area_by_area_is_from_exact_at_one_second() -> None:
    difference = np.abs(MODEL.matrices[0] - network_model(discretisation="exact").matrices[0])
    assert [round(float(difference[k::4].max()), 2) for k in range(4)] == [0.04, 0.11, 0.73, 1.86]


def test_an_area_by_itself_is_exact() -> None:
    alone = {d: network_model(unplugged=NAMES, discretisation=d) for d in ("area-by-area", "exact")}
    a, b = (model.step(X, REFERENCE, LOAD) for model in alone.values())
    assert a == pytest.approx(b, abs=1e-11)


@pytest.mark.parametrize("discretisation", ["area-by-area", "exact"])
def test_steps_are_the_matrices_for_any_batch(discretisation: str) -> None:
    model = network_model(discretisation=discretisation, unplugged=["7"])
    f, by_reference, by_load = model.matrices
    x = RNG.standard_normal((3, 2, 15, 4))
    reference, load = RNG.standard_normal((2, 1, 2, 15))
    after = model.step(x, reference[0], load[0])
    expected = x.reshape(3, 2, 60) @ f.T + reference[0] @ by_reference.T + load[0] @ by_load.T
    assert after.shape == (3, 2, 15, 4)
    assert after.reshape(3, 2, 60) == pytest.approx(expected, abs=1000 * EPS * np.abs(f).max())
    one = model.step(x[1:2, 1:2], reference[0, 1], load[0, 1])
    assert np.array_equal(one[0, 0], after[1, 1])


def changed_rows(before: NetworkModel, after: NetworkModel) -> set[str]:
    return {NAMES[i] for i in range(15) if before.area[i].tobytes() != after.area[i].tobytes()}


def test_unplugging_changes_the_neighbours_alone() -> None:
    without = MODEL.switched(unplug=["4"])
    assert changed_rows(MODEL, without) == {"3", "4", "5", "13"}
    for name in set(NAMES) - {"3", "4", "5", "13"}:
        before, after = MODEL.area_model(name), without.area_model(name)
        assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True) if not isinstance(a, dict))
    joined = network_model(unplugged=["15"]).switched(plug_in=["15"])
    assert changed_rows(network_model(unplugged=["15"]), joined) == {"14", "15"}


def test_unplugging_takes_the_slope_out_of_both_ends_at_once() -> None:
    without = MODEL.switched(unplug=["4"])
    before, after = MODEL.area_model("5"), without.area_model("5")
    assert after.neighbours == ("2", "6")
    assert after.A[1, 0] - before.A[1, 0] == pytest.approx(3 / (2 * 10), abs=4 * EPS)  # P_45 / 2 H_5
    assert without.area_model("4").A[1, 0] == 0 and without.area_model("4").neighbours == ()
    # with the tie out of `external` alone, a common shift of the others' angles would drive area 5
    flat = np.zeros((15, 4))
    flat[:, 0] = 0.3
    assert np.abs(rates(without, flat, np.zeros(15), np.zeros(15))).max() < 10 * EPS


@pytest.mark.parametrize(("plug_in", "unplug"), [((), ("4",)), (("15",), ()), (("15",), ("4", "9"))])
def test_a_switched_model_is_the_one_built_so(plug_in: tuple[str, ...], unplug: tuple[str, ...]) -> None:
    switched = network_model(unplugged=["15"]).switched(plug_in=plug_in, unplug=unplug)
    built = network_model(unplugged=(*unplug, *(() if plug_in else ("15",))))
    assert np.array_equal(switched.area, built.area) and np.array_equal(switched.side_slope, built.side_slope)
    assert np.array_equal(switched.stiffness, built.stiffness)


def test_there_and_back_restores_every_bit() -> None:
    again = MODEL.switched(unplug=["4", "5"]).switched(plug_in=["5"]).switched(plug_in=["4"])
    assert np.array_equal(again.area, MODEL.area)
    exact = network_model(discretisation="exact")
    assert np.array_equal(exact.switched(unplug=["4"]).switched(plug_in=["4"]).matrices[0], exact.matrices[0])


def test_other_constants_change_one_area() -> None:
    slow = MODEL.altered("4", governor_time=1000.0)
    assert changed_rows(MODEL, slow) == {"4"}
    assert slow.area_model("4").A[3].tolist() == [0, -1 / (0.08 * 1000.0), 0, -1 / 1000.0]
    for change, message in (({"governor_time": 0.0}, "governor_time of area 4 is 0"), ({"T_g": 1.0}, "unknown constants T_g")):
        with pytest.raises(ValueError, match=message):
            MODEL.altered("4", **change)
    with pytest.raises(ValueError, match="unknown node '16'"):
        MODEL.altered("16", governor_time=1.0)


def test_an_area_predicts_itself_from_what_crosses_its_border() -> None:
    after = MODEL.step(X, REFERENCE, LOAD)
    for i, name in enumerate(NAMES):
        area = MODEL.area_model(name)
        theta = X[[NAMES.index(j) for j in area.neighbours], 0]
        own = area.transition @ X[i] + area.by_reference * REFERENCE[i] + area.by_load * LOAD[i] + area.by_angles @ theta
        assert own == pytest.approx(after[i], abs=100 * EPS * np.abs(area.transition).max())


def test_what_crosses_the_border_of_an_area() -> None:
    area = network_model(unplugged=["13"]).area_model("4")
    assert area.received == ("theta_3", "theta_5") and area.shared == ("theta_3@4", "theta_5@4")
    assert area.sharers == {"4": ("4", "3", "5"), "3": ("3", "2", "4"), "5": ("5", "2", "4", "6")}
    owners = {s.name: s.owner for s in network_sensors(MODEL)}
    assert all(owners[name] == "area 4" for name in area.shared) and owners["theta_3"] == "area 3"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"unplugged": ["16"]}, "unknown node '16'"),
        ({"unplugged": ["4", "4"]}, "the names 4 stand more than once"),
        ({"noise": "large"}, "noise is 'large'; known: lit, small"),
        ({"discretisation": "euler"}, "known: area-by-area, exact"),
        ({"dt": 0.0}, "positive and finite"),
    ],
)
def test_settings_that_do_not_fit(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        network_model(**settings)  # type: ignore[arg-type]


def test_large_networks_have_no_dense_matrices() -> None:
    large = generate_network(300, 0)
    assert network_model(large).step(np.zeros((300, 4)), np.zeros(300), np.zeros(300)).shape == (300, 4)
    with pytest.raises(ValueError, match="at most 250 areas"):
        network_model(large, discretisation="exact")
    with pytest.raises(ValueError, match="at most 250 areas"):
        power_network(300)


@pytest.mark.slow
def test_a_network_of_150_000_areas_fits_in_memory() -> None:
    n = 150_000
    c = generate_network(n, 0)
    model = network_model(c)
    at = model.network.topology
    arrays = (model.area, model.side_slope, model.constants, at.links, at.node, at.neighbour, at.link, at.start, c.side_slope)
    assert sum(a.nbytes for a in arrays) < 400 * n  # bytes: 24 numbers of its discretisation, five constants, 4.5 sides
    x = np.random.default_rng(0).standard_normal((n, 4))
    after = model.step(x, np.zeros(n), np.zeros(n))
    area = model.area_model("75000")
    theta = x[[int(j) - 1 for j in area.neighbours], 0]
    assert area.transition @ x[74999] + area.by_angles @ theta == pytest.approx(after[74999], abs=1e-11)
    without = model.switched(unplug=["75000"])
    rows = np.flatnonzero(np.any(without.area != model.area, axis=(1, 2)))
    assert {model.names[i] for i in rows} == {"75000", *area.neighbours}


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
def test_the_two_readings_of_the_process_noise(noise: str, variance: list[float]) -> None:
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


def test_plants_that_cannot_be() -> None:
    for settings, message in (
        ({"areas": 1}, "at least 2"),
        ({"faults": [AreaFault("governor", "16", 1.0)]}, "unknown node '16'"),
        ({"switches": [Switch(1.0, plug_in=("3",))]}, "'3' is plugged in already"),
    ):
        with pytest.raises(ValueError, match=message):
            power_network(**settings)  # type: ignore[arg-type]
