"""From physics to a plant: order of integration, exact hold, and the algebraic part with its derivative."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from toy_plants import changed, tank_physics, tanks

from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.plant.discretise import discretise
from fusion_sfdia.plant.integration import exponential_midpoint, runge_kutta_4, solve_algebraic
from fusion_sfdia.plant.physics import Physics
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Parameter

EPS = np.finfo(float).eps
NONE = np.zeros(0)


def implicit(phi: Callable[..., Any], nominal: tuple[float, ...] = (1.0,)) -> Physics:
    """x' = -z with z = phi; as many states as algebraic variables."""
    return Physics(
        name="implicit",
        states=tuple(Signal(f"x{i}") for i in range(len(nominal))),
        f=lambda t, x, z, u, c: -z,
        algebraic=tuple(Signal(f"z{i}", nominal=v) for i, v in enumerate(nominal)),
        phi=phi,
    )


def order_of(step: Callable[..., Any], slope: Callable[..., Any], start: np.ndarray, end: float, counts: list[int]) -> float:
    """Order of step(slope, t, x, dt) from its largest errors at `end` after `counts` steps, by a line through logarithms."""
    exact = solve_ivp(slope, (0, end), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    errors = []
    for count in counts:
        x, dt = start, end / count
        for k in range(count):
            x = step(slope, k * dt, x, dt)
        errors.append(np.abs(x - exact).max())
    return float(-np.polyfit(np.log(counts), np.log(errors), 1)[0])


def test_runge_kutta_4_is_of_order_4() -> None:
    def slope(t: float, x: np.ndarray) -> np.ndarray:
        return np.stack([x[..., 1], -np.sin(x[..., 0]) + np.cos(t)], axis=-1)

    order = order_of(runge_kutta_4, slope, np.array([0.5, 0.0]), 2.0, [10, 20, 40, 80])
    assert order == pytest.approx(4.0, abs=0.15)  # the next term of the error tilts the line by its share at 10 steps


def test_the_exponential_midpoint_rule_is_exact_for_a_constant_level_however_stiff() -> None:
    decay, level = np.array([1e-3, 1.0, 1e6]), np.array([2.0, -3.0, 4.0])
    start = np.array([[1.0, 1.0, 1.0], [0.0, -5.0, 9.0]])
    ours = exponential_midpoint(lambda t, x: decay * (level - x), 0.0, start, 0.7, decay)
    np.testing.assert_allclose(ours, level + (start - level) * np.exp(-decay * 0.7), rtol=0, atol=50 * EPS)  # of values up to 9


def test_the_exponential_midpoint_rule_is_of_order_2() -> None:
    decay = np.array([3.0, 50.0])

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(x[..., 1] + t), 50 * np.sin(x[..., 0])], axis=-1) - decay * x

    order = order_of(partial(exponential_midpoint, decay=decay), slope, np.array([0.5, 0.5]), 1.0, [80, 160, 320, 640])
    assert order == pytest.approx(2.0, abs=0.15)  # the stiff state's next terms tilt the line by their share at 80 steps


@pytest.mark.parametrize("decay", [np.ones(1), np.array([1.0, 0.0]), np.array([1.0, np.nan])])
def test_rates_of_decay_that_do_not_fit_are_refused(decay: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"decay of 'two-tanks' is .*; expected 2 positive rates in 1/s, one a state"):
        discretise(
            tank_physics(),
            tanks().sensors,
            dt=1.0,
            x0=np.ones(2),
            initial_cov=np.ones(2),
            process_cov=np.ones(2),
            decay=decay,
        )


def test_substeps_divide_the_step_and_see_the_right_times() -> None:
    physics = Physics("clock", (Signal("x"),), lambda t, x, z, u, c: np.full_like(x, t**2))
    plant = discretise(
        physics,
        [Sensor("s", "x", sigma=1.0)],
        dt=6.0,
        x0=np.zeros(1),
        initial_cov=np.ones(1),
        process_cov=np.ones(1),
        substeps=3,
    )
    # the rule is Simpson's, exact for a cubic: any misplaced substep would show
    assert plant.step(1.0, np.zeros(1), NONE, 6.0)[0] == pytest.approx((7**3 - 1) / 3, rel=4 * EPS)
    tank = tank_physics()
    one, three = (
        discretise(
            tank,
            tanks().sensors,
            dt=9.0,
            x0=np.ones(2),
            initial_cov=np.ones(2),
            process_cov=np.ones(2),
            substeps=count,
        )
        for count in (1, 3)
    )
    x, u = np.array([1.5, 0.5]), np.array([6e-4])
    by_hand = one.step(6.0, one.step(3.0, one.step(0.0, x, u, 3.0), u, 3.0), u, 3.0)
    np.testing.assert_array_equal(three.step(0.0, x, u, 9.0), by_hand)
    with pytest.raises(ValueError, match="substeps is 0; a step of 'two-tanks' takes at least 1"):
        discretise(tank, tanks().sensors, dt=9.0, x0=np.ones(2), initial_cov=np.ones(2), process_cov=np.ones(2), substeps=0)


def test_sensors_read_states_and_algebraic_variables() -> None:
    plant = tanks()
    x = np.array([[1.0, 0.25], [4.0, 1.0]])
    flows = 6e-4 * np.sqrt(x)
    u = plant.input_at(0.0)
    np.testing.assert_allclose(plant.output(0.0, x, u), np.concatenate([x, flows], axis=-1), rtol=4 * EPS)
    jacobian = plant.output_jacobian_at(0.0, x, u)
    assert jacobian.shape == (2, 4, 2)
    np.testing.assert_allclose(jacobian[:, 2:], [np.diag(d) for d in 6e-4 / (2 * np.sqrt(x))], rtol=4 * EPS)
    with pytest.raises(ValueError, match="sensors s, r measure no variable of 'two-tanks'; variables: level_1, level_2"):
        discretise(
            tank_physics(),
            [Sensor("s", "depth", sigma=1.0), Sensor("r", "inflow", sigma=1.0)],
            dt=1.0,
            x0=np.ones(2),
            initial_cov=np.ones(2),
            process_cov=np.ones(2),
        )


def test_sensors_of_states_alone_have_a_constant_jacobian() -> None:
    def build(measured: list[str]) -> Plant:
        return discretise(
            tank_physics(),
            [Sensor(f"s{i}", name, sigma=1.0) for i, name in enumerate(measured)],
            dt=1.0,
            x0=np.ones(2),
            initial_cov=np.ones(2),
            process_cov=np.ones(2),
        )

    plant = build(["level_2", "level_1", "level_2"])
    x = np.array([1.0, 2.0])
    np.testing.assert_array_equal(plant.output(0.0, x, NONE), [2.0, 1.0, 2.0])
    np.testing.assert_array_equal(plant.output_jacobian_at(0.0, x, NONE), [[0, 1], [1, 0], [0, 1]])
    stated = changed(plant, output_jacobian=None)
    np.testing.assert_array_equal(stated.output_jacobian_at(0.0, x, NONE), plant.output_jacobian_at(0.0, x, NONE))


# z = cos(a z) + x: dz/dx = 1 / (1 + a sin(a z)), the implicit function theorem
@pytest.mark.parametrize("batch", [(), (5,), (2, 3)])
def test_the_fixed_point_and_its_derivative_are_settled(batch: tuple[int, ...]) -> None:
    physics = implicit(lambda t, x, z, u, c: np.cos(0.5 * z) + x)
    x = np.random.default_rng(0).uniform(0.0, 2.0, (*batch, 1))
    z = solve_algebraic(physics, 0.0, x, NONE)
    np.testing.assert_allclose(z, np.cos(0.5 * z) + x, atol=4e-13)
    jacobian = complex_step_jacobian(lambda p: solve_algebraic(physics, 0.0, p, NONE), x)
    # a sweep shrinks errors by at most .5, so the last change, 1e-13, bounds what is left
    np.testing.assert_allclose(jacobian[..., 0], 1 / (1 + 0.5 * np.sin(0.5 * z)), rtol=1e-12)


def test_the_derivative_settles_also_from_the_solution_itself() -> None:
    # the real part starts settled; one sweep would give the imaginary part of one sweep, 1 instead of 1 / (1 - .5)
    start = 1.0
    physics = implicit(lambda t, x, z, u, c: 0.5 * z + x, nominal=(start,))
    x = np.array([0.5 * start])
    assert solve_algebraic(physics, 0.0, x, NONE)[0] == pytest.approx(start, rel=1e-15)
    jacobian = complex_step_jacobian(lambda p: solve_algebraic(physics, 0.0, p, NONE), x)
    # of this geometric series the rest is as large as the last term
    assert jacobian[0, 0] == pytest.approx(2.0, rel=1e-13 + 50 * EPS)


def test_a_jacobian_through_an_implicit_plant_equals_that_of_its_explicit_twin() -> None:
    def build(physics: Physics) -> Plant:
        return discretise(
            physics, [Sensor("s", "z0", sigma=1.0)], dt=0.1, x0=np.ones(1), initial_cov=np.ones(1), process_cov=np.ones(1)
        )

    twin = build(implicit(lambda t, x, z, u, c: 2 * np.sin(x)))
    plant = build(implicit(lambda t, x, z, u, c: 0.5 * z + np.sin(x)))
    x = np.array([0.7])
    np.testing.assert_allclose(plant.step(0.0, x, NONE, 0.1), twin.step(0.0, x, NONE, 0.1), rtol=1e-12)
    np.testing.assert_allclose(plant.step_jacobian_at(0.0, x, NONE, 0.1), twin.step_jacobian_at(0.0, x, NONE, 0.1), rtol=1e-12)
    np.testing.assert_allclose(plant.output_jacobian_at(0.0, x, NONE), [[2 * np.cos(0.7)]], rtol=1e-12)


def test_algebraic_variables_in_a_chain_settle_exactly() -> None:
    physics = implicit(lambda t, x, z, u, c: np.stack([x[..., 0] ** 2, z[..., 0] + x[..., 1]], axis=-1), nominal=(1.0, 1.0))
    np.testing.assert_array_equal(solve_algebraic(physics, 0.0, np.array([3.0, 4.0]), NONE), [9.0, 13.0])


def test_a_variable_that_is_zero_by_cancellation_settles() -> None:
    # two branches in balance: their difference is rounding noise, never settled relative to itself
    def phi(t: float, x: np.ndarray, z: np.ndarray, u: np.ndarray, c: Any) -> np.ndarray:
        return np.stack([np.cos(0.5 * z[..., 0]) + x[..., 0], 0.5 * z[..., 1] + z[..., 0] - np.cos(0.5 * z[..., 0])], axis=-1)

    z = solve_algebraic(implicit(phi, nominal=(1.0, 1.0)), 0.0, np.zeros(2), NONE)
    assert abs(z[1]) < 4e-13  # settled to 1e-13 of the terms of up to 2, of which it is twice the difference


def test_sweeps_that_do_not_contract_name_the_variable() -> None:
    def phi(t: float, x: np.ndarray, z: np.ndarray, u: np.ndarray, c: Any) -> np.ndarray:
        return np.stack([0.5 * z[..., 0] + x[..., 0], 3.0 - 1.0 * z[..., 1]], axis=-1)

    with pytest.raises(ArithmeticError, match="the algebraic variables z1 of 'implicit' did not settle in 200 sweeps"):
        solve_algebraic(implicit(phi, nominal=(1.0, 1.0)), 0.0, np.ones(2), NONE)


def test_one_element_of_a_batch_that_does_not_settle_is_not_hidden_by_the_others() -> None:
    physics = implicit(lambda t, x, z, u, c: x * z * (1 - z) + 0.1)
    solve_algebraic(physics, 0.0, np.array([[0.5], [1.0]]), NONE)
    with pytest.raises(ArithmeticError, match="z0"):
        solve_algebraic(physics, 0.0, np.array([[0.5], [3.6]]), NONE)


def test_inputs_broadcast_over_a_batch_of_algebraic_variables() -> None:
    physics = replace(implicit(lambda t, x, z, u, c: 0.5 * z + x + u), inputs=(Signal("u0"),))
    z = solve_algebraic(physics, 0.0, np.zeros(1), np.array([[1.0], [2.0], [3.0]]))
    np.testing.assert_allclose(z, [[2.0], [4.0], [6.0]], rtol=2e-13)  # the last change, at most 1e-13, is as large as the rest


def test_a_rate_for_one_state_of_two_is_refused() -> None:
    tank, settings = tank_physics(), {"dt": 5.0, "x0": np.ones(2), "initial_cov": np.ones(2), "process_cov": np.ones(2)}
    for what, bad, shape in (
        ("f", lambda t, x, z, u, c: -0.1 * x[..., :1], r"\(2, 1, 1\)"),
        ("f", lambda t, x, z, u, c: -0.1 * x[..., 0], r"\(2, 1\)"),
        ("phi", lambda t, x, z, u, c: x[..., :1], r"\(2, 1, 1\)"),
    ):
        with pytest.raises(ValueError, match=rf"{what} of 'two-tanks' gives shape {shape} .*; expected \(2, 1, 2\)"):
            discretise(replace(tank, **{what: bad}), tanks().sensors, **settings)
    constant = replace(tank, f=lambda t, x, z, u, c: np.array([1e-3, -1e-3]))  # the same for each batch, and so it is taken
    moved = discretise(constant, tanks().sensors, **settings).step(0.0, np.ones((3, 2)), np.ones((3, 1)), 5.0)
    np.testing.assert_allclose(moved, np.broadcast_to([1.005, 0.995], (3, 2)), rtol=1e-15)


def leak(rate: float, **settings: Any) -> Plant:
    """x' = -rate x + w."""
    physics = Physics("leak", (Signal("x"),), f=lambda t, x, z, u, c: -rate * x)
    given = {"dt": 1.0, "x0": np.ones(1), "initial_cov": np.full(1, 4.0), "process_cov": np.full(1, 0.01)}
    return discretise(physics, [Sensor("s", "x", sigma=0.1)], **(given | settings))


def test_the_largest_step_keeps_a_tenth_of_its_noise() -> None:
    """The variance that a step of max_dt adds, against the integral of exp(2 A s) Q over it: within a tenth, and near it."""
    for rate in (0.001, 0.02, 0.09):
        plant = leak(rate)
        step = plant.numerics.max_dt
        assert step == pytest.approx(0.1 / rate, rel=1e-7)
        expected = 0.01 * (1 - np.exp(-2 * rate * step)) / (2 * rate)
        assert 0.05 < plant.process_cov_over(step)[0] / expected - 1 < 0.11
    assert leak(0.0).numerics.max_dt == np.inf  # a pure integrator: exact for any step
    assert leak(5.0).numerics.max_dt == 1.0  # dt is the user's own choice
    assert leak(0.02, max_dt=7.0).numerics.max_dt == 7.0
    # two tanks at rest, checked by hand: |A| of [[-r, 0], [r, -r]] is r (1 + sqrt 5) / 2, with r = 1 / 167 s
    r = 6e-4 / (2 * 0.05)
    assert tanks().numerics.max_dt == pytest.approx(0.1 / (r * (1 + np.sqrt(5)) / 2), rel=1e-7)


class Spring(NamedTuple):
    """Of a mass on a spring, with an algebraic force."""

    stiffness: float = 4.0
    mass: float = 2.0


def spring(c: Spring) -> Physics:
    return Physics(
        name="spring",
        states=(
            Signal("place", nominal=1.0, initial_sigma=0.1, process_sigma=0.1),
            Signal("speed", initial_sigma=0.1, process_sigma=0.1),
        ),
        f=lambda t, x, z, u, c: np.stack([x[..., 1], z[..., 0] / c.mass], axis=-1),
        algebraic=(Signal("force", nominal=-4.0),),
        phi=lambda t, x, z, u, c: -(c.stiffness * x[..., 0])[..., None],
        parameters=c,
    )


SENSORS = (Sensor("s", "place", sigma=0.1), Sensor("f", "force", sigma=0.1))


def test_unknown_parameters_are_those_of_the_physics_for_each_of_a_batch() -> None:
    unknown = (Parameter("mass", "kg", 2.0, 0.1), Parameter("stiffness", "N/m", 4.0, 0.4))
    known = discretise(spring(Spring()), SENSORS, dt=0.1, unknown=unknown).uncertainty
    assert known.step is not None and known.output is not None and known.parameters == unknown
    theta = np.array([[2.0, 4.0], [2.5, 3.0], [1.0, 5.0]])
    x = np.array([1.0, -0.5])
    for k, (mass, stiffness) in enumerate(theta):
        other = discretise(spring(Spring(stiffness, mass)), SENSORS, dt=0.1)
        np.testing.assert_allclose(known.step(0.0, x, NONE, 0.1, theta)[k], other.step(0.0, x, NONE, 0.1), rtol=8 * EPS)
        np.testing.assert_allclose(known.output(0.0, x, NONE, theta)[k], other.output(0.0, x, NONE), rtol=8 * EPS)


@pytest.mark.parametrize(
    ("unknown", "message"),
    [
        (Parameter("damping"), "unknown has 'damping', which the parameters of 'spring' do not; they are stiffness, mass"),
        (Parameter("mass", nominal=1.0), "parameter 'mass' is nominally 1.0, but 2.0 in the physics"),
    ],
)
def test_an_unknown_parameter_is_one_of_the_physics_with_its_value(unknown: Parameter, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        discretise(spring(Spring()), SENSORS, dt=0.1, unknown=(unknown,))
