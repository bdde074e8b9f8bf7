"""Signals, sensors, physics and plants: what they hold, what they compute, and what they refuse."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from toy_plants import chain, changed, tank_physics, tanks

from fusion_sfdia.common.covariance import diagonal, require_covariance
from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.physics import Physics
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.secants import secants
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.slow_noise import SlowNoise
from fusion_sfdia.plant.uncertainty import Disturbance, Parameter

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        ({"nominal": 2.0, "high": 1.0}, r"2.0 Pa is outside \[-inf, 1.0\] Pa: correct it, or the limits"),
        ({"nominal": -1.0, "low": 0.0}, r"-1.0 Pa is outside \[0.0, inf\] Pa: correct it, or the limits"),
        ({"nominal": NAN}, "is nan; expected a finite number"),
        ({"nominal": INF}, "is inf; expected a finite number"),
    ],
)
def test_a_nominal_value_is_within_its_limits(limits: dict[str, float], text: str) -> None:
    with pytest.raises(ValueError, match=f"signal 'p': nominal {text}"):
        Signal("p", "Pa", **limits)


@pytest.mark.parametrize("what", ["sigma", "bound"])
@pytest.mark.parametrize("value", [0.0, -1.0, NAN, INF])
def test_a_sensor_states_positive_finite_noise(what: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"sensor 's': {what} is {value}; it must be positive and finite"):
        Sensor("s", "x", **{what: value})


def test_the_slow_noise_of_a_plant_is_in_samples() -> None:
    plant = chain(3)
    slow = (SlowNoise(0.5, 20.0), None, SlowNoise(0.2, 1e300))
    sensors = tuple(replace(s, noise=noise) for s, noise in zip(plant.sensors, slow, strict=True))
    share, kept = replace(plant, sensors=sensors).slow_noise
    np.testing.assert_array_equal(share, [0.5, 0.0, 0.2])
    np.testing.assert_allclose(kept, np.exp([-1 / 20, -1, -1e-6]), rtol=1e-15)


def test_a_sensor_without_noise_is_refused_and_one_figure_gives_the_other() -> None:
    with pytest.raises(ValueError, match="sensor 's' states no noise"):
        Sensor("s", "x")
    bounded = Sensor("s", "x", bound=3.0)
    # variance of a uniform error within +-b is b^2 / 3
    assert bounded.noise_sigma == pytest.approx(np.sqrt(3.0)) and bounded.noise_bound == 3.0
    gaussian = Sensor("s", "x", sigma=2.0)
    assert gaussian.noise_sigma == 2.0 and gaussian.noise_bound == INF
    both = Sensor("s", "x", sigma=2.0, bound=3.0)
    assert (both.noise_sigma, both.noise_bound) == (2.0, 3.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"states": (Signal("level_1"), Signal("level_1"))}, "the names level_1 occur more than once"),
        ({"inputs": (Signal("level_1"),)}, "the names level_1 occur more than once"),
        ({"algebraic": (Signal("level_2"), Signal("inflow"))}, "the names inflow, level_2 occur more than once"),
        ({"phi": None}, "algebraic variables and phi go together"),
        ({"algebraic": ()}, "algebraic variables and phi go together"),
    ],
)
def test_physics_that_does_not_fit_together_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(tank_physics(), **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"states": (Signal("a"), Signal("a"), Signal("b"))}, "plant 'chain': the names a occur more than once"),
        ({"inputs": (Signal("x0"),)}, "plant 'chain': the names x0 occur more than once"),
        ({"sensors": (Sensor("s", "x0", sigma=1.0),) * 2}, "sensors of plant 'chain': the names s occur more than once"),
        ({"sensors": ()}, "3 states and 0 sensors; give at least one of each"),
        ({"dt": 0.0}, "dt is 0.0 s; it must be positive and finite"),
        ({"dt": NAN}, "dt is nan s; it must be positive and finite"),
        ({"dt": INF}, "dt is inf s; it must be positive and finite"),
        ({"x0": np.zeros(2)}, r"x0 has shape \(2,\); expected 3 finite values"),
        ({"x0": np.array([0.0, NAN, 0.0])}, "expected 3 finite values"),
        ({"initial_cov": np.array([1.0, -2.0, 1.0])}, r"initial_cov has a negative variance \(-2\)"),
        ({"process_cov": np.ones(4)}, r"process_cov has shape \(4,\); expected \(3,\) variances or a \(3, 3\) matrix"),
        ({"process_cov": np.array([1.0, INF, 1.0])}, "process_cov has entries that are not finite"),
        ({"initial_cov": np.eye(3) + np.diag([0.5, 0.0], 1)}, "initial_cov is not symmetric positive semi-definite"),
        ({"initial_cov": np.eye(3) + 2 * np.eye(3)[::-1]}, "initial_cov is not symmetric positive semi-definite"),
        ({"process_bound": np.ones(2)}, r"process_bound has shape \(2,\); expected \(3,\)"),
        ({"process_bound": np.array([1.0, -1.0, 1.0])}, "expected .* numbers of at least 0"),
        ({"printed_process_noise": -0.1}, "printed_process_noise is -0.1; it must be finite and at least 0"),
    ],
)
def test_a_plant_that_does_not_fit_together_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(chain(3), **change)


def test_a_singular_covariance_is_one_and_its_definiteness_is_judged_free_of_units() -> None:
    require_covariance("P", np.ones((2, 2)), 2)
    require_covariance("P", np.zeros(2), 2)
    # in raw units the smallest eigenvalue, -1e-6, would vanish next to 1e12
    with pytest.raises(ValueError, match="not symmetric positive semi-definite"):
        require_covariance("P", np.array([[1e12, 2.0], [2.0, 1e-12]]), 2)
    np.testing.assert_array_equal(diagonal(np.diag([1.0, 2.0])), [1.0, 2.0])


def test_sensors_by_name_and_by_quantity() -> None:
    plant = tanks()
    assert plant.sensor_names == ("l1", "l2", "q12", "q2") and plant.sensor_index("q12") == 2
    assert {k: v.tolist() for k, v in plant.quantities.items()} == {"level": [0, 1], "flow": [2, 3]}
    assert list(chain(3).quantities) == ["s0", "s1", "s2"]
    np.testing.assert_array_equal(plant.sensor_cov, plant.sensor_sigma**2)
    with pytest.raises(ValueError, match="unknown sensor 'l3' of plant 'two-tanks'; known: l1, l2, q12, q2"):
        plant.sensor_index("l3")


def test_state_scale_is_positive_even_for_states_known_exactly() -> None:
    plant = replace(chain(3), initial_cov=np.array([4.0, 0.0, 0.0]), process_cov=np.array([1.0, 9.0, 0.0]))
    np.testing.assert_array_equal(plant.state_scale, [2.0, 3.0, 1.0])


@pytest.mark.parametrize("scale", [1e2, -1e2])
def test_another_unit_is_the_same_plant(scale: float) -> None:
    plant = tanks()
    other = plant.in_units({"l1": ("cm", scale)})
    x, u = np.array([[1.0, 0.9], [1.1, 1.2]]), plant.input_at(0.0)
    factor = np.array([scale, 1.0, 1.0, 1.0])
    np.testing.assert_array_equal(other.output(0.0, x, u), plant.output(0.0, x, u) * factor)
    np.testing.assert_array_equal(other.output_jacobian_at(0.0, x, u), plant.output_jacobian_at(0.0, x, u) * factor[:, None])
    np.testing.assert_allclose(other.sensor_sigma, plant.sensor_sigma * np.abs(factor))
    assert other.sensors[0].unit == "cm" and other.sensors[1:] == plant.sensors[1:]


def test_another_unit_scales_what_the_plant_does_not_know() -> None:
    """An uncertain plant in other units, augmented, is the augmented plant in other units."""
    off = Disturbance("offset", np.array([0.1, 0.0]), np.array([0.0, 0.2, 0.0, 1e-5]))
    outlet = Parameter("outlet", "1", 1.0, 0.05)
    plant = replace(tanks(), uncertainty=secants(tanks(), (outlet,), tanks, inputs={"inflow": 3e-5}, disturbances=(off,)))
    units = {"l1": ("cm", 1e2), "q2": ("l/h", 3.6e6)}
    one, two = augment(plant).in_units(units), augment(plant.in_units(units))
    z, u = np.array([1.0, 0.9, 1.03, 2e-5, 0.4]), plant.input_at(0.0)
    np.testing.assert_allclose(two.output(0.0, z, u), one.output(0.0, z, u), rtol=1e-14)
    np.testing.assert_allclose(two.output_jacobian_at(0.0, z, u), one.output_jacobian_at(0.0, z, u), rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(two.step(0.0, z, u, 5.0), one.step(0.0, z, u, 5.0))


def test_another_unit_scales_bounds_and_stated_jacobians_and_refuses_no_scale() -> None:
    bounded = replace(chain(2), sensors=(Sensor("a", "x0", sigma=1.0, bound=3.0), Sensor("b", "x1", bound=2.0)))
    other = bounded.in_units({"a": ("mV", 1e3), "b": ("mV", 1e3)})
    assert (other.sensors[0].sigma, other.sensors[0].bound) == (1e3, 3e3)
    assert (other.sensors[1].sigma, other.sensors[1].bound) == (None, 2e3)
    np.testing.assert_array_equal(other.output_jacobian_at(0.0, np.zeros(2), np.zeros(0)), 1e3 * np.eye(2))
    for scale in (0.0, NAN, INF):
        with pytest.raises(ValueError, match="must be positive and finite"):
            bounded.in_units({"a": ("V", scale)})
    with pytest.raises(ValueError, match="unknown sensor 'c'"):
        bounded.in_units({"c": ("V", 1.0)})
    with pytest.raises(ValueError, match=r"units are 'mV'; expected those of sensors by name, as in "):
        bounded.in_units("mV")  # type: ignore[arg-type]


def test_guard_moves_states_into_the_limits_and_reports_it() -> None:
    x, moved = tanks().guard(np.array([[1.0, 2.0], [-1.0, 2.0], [1.0, 9.0]]))
    np.testing.assert_array_equal(x, [[1.0, 2.0], [0.01, 2.0], [1.0, 3.0]])
    np.testing.assert_array_equal(moved, [False, True, True])
    x, moved = chain(2).guard(np.array([1e300, -1e300]))
    assert not moved and x.tolist() == [1e300, -1e300]


def test_a_plant_is_linear_where_constant_jacobians_explain_its_changes_and_no_state_has_limits() -> None:
    plant = chain(3)
    assert plant.linear == (True, True)
    assert replace(plant, step=lambda t, x, u, dt: plant.step(t, x, u, dt) + 1e-3 * x**2).linear == (False, True)
    assert replace(plant, states=(replace(plant.states[0], low=-9.0), *plant.states[1:])).linear == (False, True)
    assert tanks().linear == (False, False)
    assert registry.plant("gas-pipeline").linear == (False, True)


def test_steps_for_which_the_model_does_not_hold_are_refused() -> None:
    plant = changed(tanks(), max_dt=20.0)
    plant.check_dt(20.0)
    plant.check_dt(0.1)
    for dt in (0.0, -5.0, NAN, INF):
        with pytest.raises(ValueError, match="times must be finite and increase"):
            plant.check_dt(dt)
    with pytest.raises(ValueError, match="the largest admissible step of plant 'two-tanks' is 20 s"):
        plant.check_dt(20.1)
    chain(2).check_dt(1.0 + 1e-12)
    with pytest.raises(ValueError, match=r"plant 'chain' holds for 1\.0 s only"):
        chain(2).check_dt(2.0)


@pytest.mark.parametrize("full", [False, True])
def test_process_noise_grows_with_the_step(full: bool) -> None:
    plant = tanks()
    if full:
        plant = replace(plant, process_cov=np.array([[2.0, 1.0], [1.0, 3.0]]))
    assert plant.process_cov_over(plant.dt) is plant.process_cov
    np.testing.assert_allclose(plant.process_cov_over(3 * plant.dt), 3 * plant.process_cov, rtol=1e-15)
    halves = plant.process_cov_over(plant.dt / 2)
    np.testing.assert_allclose(halves + halves, plant.process_cov, rtol=1e-15)


def test_inputs_follow_the_operation_or_the_nominal_values() -> None:
    plant = tanks()
    np.testing.assert_array_equal(plant.input_at(7.0), [6e-4])
    np.testing.assert_array_equal(changed(plant, operation=lambda t: [2 * t]).input_at(7.0), [14.0])


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_jacobians_come_from_the_complex_step_where_none_is_stated(batch: tuple[int, ...]) -> None:
    plant = linear_plant(
        "cart",
        np.array([[1.0, 0.1], [-0.2, 0.9]]),
        np.array([[1.0, 2.0], [0.0, 1.0], [3.0, 0.0]]),
        [Sensor(f"s{i}", "x0", sigma=1.0) for i in range(3)],
        dt=0.1,
        x0=np.zeros(2),
        initial_cov=np.ones(2),
        process_cov=np.ones(2),
        input_matrix=np.array([[0.0], [1.0]]),
        inputs=[Signal("force", "N")],
    )
    unstated: Plant = changed(plant, step_jacobian=None, output_jacobian=None)
    rng = np.random.default_rng(0)
    x, u = rng.normal(size=(*batch, 2)), rng.normal(size=(*batch, 1))
    f, h = unstated.step_jacobian_at(0.0, x, u, 0.1), unstated.output_jacobian_at(0.0, x, u)
    assert f.shape == (*batch, 2, 2) and h.shape == (*batch, 3, 2)
    for one, two in zip(unstated.step_with_jacobian(0.0, x, u, 0.1), (plant.step(0.0, x, u, 0.1), f), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-13, atol=1e-15)
    np.testing.assert_array_equal(f, np.broadcast_to(plant.step_jacobian_at(0.0, x, u, 0.1), f.shape))
    np.testing.assert_array_equal(h, np.broadcast_to(plant.output_jacobian_at(0.0, x, u), h.shape))
    # an input shared by the whole batch serves, too
    np.testing.assert_array_equal(unstated.step_jacobian_at(0.0, x, np.zeros(1), 0.1), f)


def test_the_jacobian_of_a_step_is_that_of_its_substeps() -> None:
    plant = tanks()
    x, u = np.array([1.2, 0.8]), plant.input_at(0.0)
    half = plant.step(0.0, x, u, 2.5)
    chained = plant.step_jacobian_at(2.5, half, u, 2.5) @ plant.step_jacobian_at(0.0, x, u, 2.5)
    whole = complex_step_jacobian(lambda p: plant.step(2.5, plant.step(0.0, p, u, 2.5), u, 2.5), x)
    np.testing.assert_allclose(chained, whole, rtol=1e-13)


def test_physics_without_algebraic_variables_needs_no_phi() -> None:
    physics = Physics("decay", (Signal("a"),), lambda t, x, z, u, c: -x)
    assert physics.phi is None and physics.algebraic == ()


def roots(output: Any, x0: float = 2.0) -> Plant:
    """A random walk read through a function of the state."""
    return Plant(
        name="walk",
        states=(Signal("x0"),),
        sensors=(Sensor("s", "x0", sigma=0.1), Sensor("r", "x0", sigma=0.1)),
        step=lambda t, x, u, dt: 0.99 * x,
        output=lambda t, x, u: np.concatenate([output(x), 2 * output(x)], axis=-1),
        dt=1.0,
        x0=np.array([x0]),
        initial_cov=np.array([0.25]),
        process_cov=np.array([0.01]),
    )


NOT_ANALYTIC = {
    "abs": (np.abs, lambda x: x),
    "sign": (lambda x: x * np.sign(x), lambda x: x),
    "interp": (lambda x: np.interp(x, [0.0, 10.0], [0.0, 30.0]), lambda x: 3 * x),
    "real": (lambda x: np.real(x) ** 2, lambda x: x**2),
    "hidden": (lambda x: x**2 + 1e-3 * np.abs(x), lambda x: x**2 + 1e-3 * x),
}


@pytest.mark.parametrize(("output", "same"), NOT_ANALYTIC.values(), ids=NOT_ANALYTIC)
def test_where_the_complex_step_is_wrong_differences_stand_for_it(output: Any, same: Any) -> None:
    plant, analytic = roots(output), roots(same)
    x, u = np.array([[1.9], [2.3]]), np.zeros((2, 0))
    # central differences of width eps^(1/3) sigma: of second order, exact for a quadratic but for rounding, 4 eps^(2/3)
    np.testing.assert_allclose(plant.output_jacobian_at(0.0, x, u), analytic.output_jacobian_at(0.0, x, u), rtol=1e-8)
    t, y = np.arange(1.0, 31.0), analytic.output(0.0, np.full((30, 1), 1.5), u) + 0.0
    found, expected = (run(CentralFilter(p), CentralFilter(p).init(), t, y, np.zeros((30, 0)))[1] for p in (plant, analytic))
    np.testing.assert_allclose(found.estimate, expected.estimate, rtol=1e-6)
    assert abs(found.estimate[-1, 0] - 1.5) < 0.1  # it moves: 2 would be no filter at all


def test_a_step_that_the_complex_step_cannot_take_is_differentiated_all_the_same() -> None:
    def capped(t: float, x: Any, u: Any, dt: float) -> Any:
        return np.array([[math.copysign(min(abs(v), 9.0), v)] for v in x.ravel()]).reshape(x.shape)

    plant = replace(roots(lambda x: x), step=capped)
    found = plant.step_jacobian_at(0.0, np.array([[1.5], [9.5]]), np.zeros((2, 0)), 1.0)
    np.testing.assert_allclose(found[:, 0, 0], [1.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    "output",
    [
        lambda x: np.where(x > 2.0, 5 * (x - 2.0), 0.0),  # a valve that opens at x0
        lambda x: np.maximum(x, 2.0),
        lambda x: np.clip(x, 1.9, 2.1),
        lambda x: 1e6 + x,
        lambda x: np.exp(-50 * x) * np.sin(20 * x),
    ],
)
def test_what_the_complex_step_can_differentiate_keeps_it(output: Any) -> None:
    plant = roots(output)
    x, u = np.array([[1.95], [2.05]]), np.zeros((2, 0))
    exact = complex_step_jacobian(lambda p: plant.output(0.0, p, u[:, None]), x)
    np.testing.assert_array_equal(plant.output_jacobian_at(0.0, x, u), exact)


@pytest.mark.parametrize("name", ["gas-pipeline", "marine-engine", "power-network", "two-tanks"])
def test_our_plants_are_analytic(name: str) -> None:
    plant = registry.plant(name)
    assert plant._complex_step_holds == (True, True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step": lambda t, x, u, dt: x[..., :1]}, r"step of plant 'chain' gives shape \(2, 1, 1\) .*; expected \(2, 1, 3\)"),
        ({"step": lambda t, x, u, dt: x[0]}, r"step of plant 'chain' gives shape \(1, 3\)"),
        ({"output": lambda t, x, u: x[..., :2]}, r"output of plant 'chain' gives shape \(2, 1, 2\) .*; expected \(2, 1, 3\)"),
        ({"output": lambda t, x, u: np.zeros(3)}, r"output of plant 'chain' gives shape \(3,\)"),
        (
            {"step": lambda t, x, u, dt: np.array([x[0], x[1], x[2]])},
            "step of plant 'chain' fails .*: index 2 is out of bounds",
        ),
    ],
)
def test_models_of_another_shape_are_refused_when_the_plant_is_built(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(chain(3), **change)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_functions_that_index_states_along_the_first_axis_are_refused(n: int) -> None:
    with pytest.raises(ValueError, match=r"step of plant 'chain' (gives shape|fails for states)"):
        replace(chain(n), step=lambda t, x, u, dt: np.array([x[i] for i in range(n)]))
    with pytest.raises(ValueError, match=r"output of plant 'chain' (gives shape|fails for states)"):
        replace(chain(n), output=lambda t, x, u: np.array([x[i] for i in range(n)]))


def test_an_input_that_is_not_declared_is_named_as_the_cause() -> None:
    message = r"of plant 'chain' uses an input, and the plant declares none; pass inputs=\(Signal\(\.\.\.\), \.\.\.\)"
    with pytest.raises(ValueError, match=f"step {message}"):
        replace(chain(2), inputs=(), step=lambda t, x, u, dt: x + dt * u[..., 0, None])
    with pytest.raises(ValueError, match=f"output {message}"):
        replace(chain(2), inputs=(), output=lambda t, x, u: x + u[..., 0, None])
