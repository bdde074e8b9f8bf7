"""The engine as a plant: its operating points, its transients against an implicit integrator, its drivers, bad settings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from scipy.integrate import solve_ivp

from fusion_sfdia.derivatives.equation import complex_step_jacobian, difference_jacobian
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.marine_engine import equations
from fusion_sfdia.models.marine_engine.equilibrium import engine_variables, equilibrium
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.physics import decay_rates, engine_physics
from fusion_sfdia.models.marine_engine.plant import SENSORS, SUBSYSTEMS, marine_engine
from fusion_sfdia.plant.discretise import discretise
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
EPS = np.finfo(float).eps
C = engine_parameters()
PLANT = marine_engine()
FULL = np.ones(1)


def array_plant(slip: str = "law", substeps: int = 2) -> Plant:
    """The plant without compiled drivers: equations on arrays, sweeps over all algebraic variables."""
    physics = engine_physics(C, slip, PLANT.x0, 1.0)
    return discretise(
        physics,
        PLANT.sensors,
        dt=0.01,
        x0=PLANT.x0,
        initial_cov=np.ones(3),
        process_cov=np.ones(3),
        substeps=substeps,
        decay=decay_rates(C),
    )


def around(shape: tuple[int, ...], width: float = 0.2, seed: int = 0) -> Array:
    return PLANT.x0 * np.random.default_rng(seed).uniform(1 - width, 1 + width, (*shape, 3))


@pytest.mark.parametrize("method", ["BDF", "Radau"])
def test_a_load_step_agrees_with_an_implicit_integrator(method: str) -> None:
    t = np.arange(1, 2001) * 0.01
    low = np.array([0.8])
    physics = engine_physics(C, "law", PLANT.x0, 1.0)

    def slope(s: float, x: Array) -> Array:
        return physics.f(s, x, equations.algebraic(x[None], equations.unknown_of(C)[None], C, True)[0], low, C)

    # rtol 1e-8 leaves the oracle a thousand times more exact than what is asked
    oracle = solve_ivp(slope, (0.0, 20.0), PLANT.x0, method, t_eval=t, rtol=1e-8, atol=1e-10 * PLANT.x0).y.T
    x, ours = PLANT.x0, []
    for _ in t:
        x = PLANT.step(0.0, x, low, 0.01)
        ours.append(x)
    states = np.array(ours)
    error = np.abs(states / oracle - 1).max(axis=0)
    assert np.all(error < 1e-3)
    assert error[0] < 1e-7  # linear with a constant input: exact but for the oracle's own error
    readings, expected = PLANT.output(0.0, states, low), PLANT.output(0.0, oracle, low)
    assert np.abs(readings / expected - 1).max() < 1e-3


def test_the_method_is_of_second_order() -> None:
    # pressures out of rest with smooth h; fuel at rest, so that nothing jumps
    start, counts, ends = PLANT.x0 * [1.0, 0.9, 1.1], np.array([1, 2, 4, 8]), []
    for count in (*counts, 64):
        x = start
        for _ in range(5):
            x = marine_engine(substeps=int(count)).step(0.0, x, FULL, 0.01)
        ends.append(x)
    errors = np.abs(np.array(ends[:-1]) / ends[-1] - 1).max(axis=-1)
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.1)  # the reference's own error is (1/8)^2 of the last: 1.6 % of it


@pytest.mark.parametrize("slip", ["law", "constant"])
def test_compiled_drivers_equal_the_equations_on_arrays(slip: str) -> None:
    plant, arrays = marine_engine(slip=slip), array_plant(slip)
    x, u = around((40,)), np.random.default_rng(1).uniform(0.3, 1.0, (40, 1))
    # the sweeps on arrays stop at a change of 1e-13, which the readings magnify by less than ten
    np.testing.assert_allclose(plant.output(0.0, x, u), arrays.output(0.0, x, u), rtol=1e-12)
    np.testing.assert_allclose(plant.step(0.0, x, u, 0.01), arrays.step(0.0, x, u, 0.01), rtol=1e-12)


def test_the_torque_and_its_derivative_have_settled() -> None:
    # also far from rest, where the start is far off: what is left is rounding, of a dozen operations on numbers of order 1,
    # library functions among them, off by up to four units in the last place
    near = rounding(1, 12 * 4)
    T = equations.charge_temperature(C)
    for load in (1.0, 0.5, 0.2):
        fuel, _, p = np.moveaxis(equilibrium(load, C) * around((500,), 0.25) / PLANT.x0, -1, 0)
        torque = equations.solved_torque(fuel, p, T, C)
        np.testing.assert_allclose(equations.swept_torque(fuel, torque, p, T, C), torque, rtol=near)
        step = 1 + 1e-30j
        ours = equations.solved_torque(fuel * step, p, T, C).imag
        by_fuel = equations.swept_torque(fuel * step, torque, p, T, C).imag
        by_torque = equations.swept_torque(fuel, torque * step, p, T, C).imag / torque / 1e-30
        np.testing.assert_allclose(ours, by_fuel / (1 - by_torque), rtol=near)  # the implicit function theorem


def test_a_batch_is_its_elements_to_the_bit() -> None:
    x, u = around((3, 5)), np.random.default_rng(1).uniform(0.3, 1.0, (3, 5, 1))
    moved, read = PLANT.step(0.0, x, u, 0.01), PLANT.output(0.0, x, u)
    for i in np.ndindex(3, 5):
        np.testing.assert_array_equal(PLANT.step(0.0, x[i], u[i], 0.01), moved[i])
        np.testing.assert_array_equal(PLANT.output(0.0, x[i], u[i]), read[i])
    np.testing.assert_array_equal(PLANT.step(0.0, x, FULL, 0.01), PLANT.step(0.0, x, np.ones((3, 5, 1)), 0.01))


@pytest.mark.parametrize("slip", ["law", "constant"])
def test_jacobians_are_those_of_differences_and_of_the_settled_loop(slip: str) -> None:
    plant, arrays = marine_engine(slip=slip), array_plant(slip)
    for x in around((4,), 0.1):
        step_jacobian, output_jacobian = plant.step_jacobian_at(0.0, x, FULL, 0.01), plant.output_jacobian_at(0.0, x, FULL)
        scaled = x / plant.step(0.0, x, FULL, 0.01)[:, None]
        differences = difference_jacobian(lambda p: plant.step(0.0, p, FULL, 0.01), x, x)
        # central differences of width eps^(1/3): truncation and rounding of about eps^(2/3) = 4e-11, with a margin of 1e3
        np.testing.assert_allclose(step_jacobian * scaled, differences * scaled, atol=4e-8)
        per_cent = x / plant.output(0.0, x, FULL)[:, None]
        differences = difference_jacobian(lambda p: plant.output(0.0, p, FULL), x, x)
        np.testing.assert_allclose(output_jacobian * per_cent, differences * per_cent, atol=4e-8)
        # and the generic solver, which sweeps until the imaginary parts have settled, to 1e-13
        np.testing.assert_allclose(step_jacobian * scaled, arrays.step_jacobian_at(0.0, x, FULL, 0.01) * scaled, atol=1e-11)
        np.testing.assert_allclose(output_jacobian * per_cent, arrays.output_jacobian_at(0.0, x, FULL) * per_cent, atol=1e-11)


@pytest.mark.parametrize("slip", ["law", "constant"])
def test_derivatives_with_respect_to_input_and_parameters_are_those_of_the_complex_step(slip: str) -> None:
    known = marine_engine(slip=slip).uncertainty
    assert known.step and known.output and known.step_jacobian and known.output_jacobian
    x, u = around((4,), 0.1), np.linspace(0.5, 1.0, 4)[:, None]
    theta = known.nominal * np.random.default_rng(2).uniform(0.97, 1.03, (4, 5))
    joint = np.concatenate([x, u, theta], axis=-1)
    of_step, of_output = (
        complex_step_jacobian(lambda v: known.step(0.0, v[..., :3], v[..., 3:4], 0.013, v[..., 4:]), joint),
        complex_step_jacobian(lambda v: known.output(0.0, v[..., :3], v[..., 3:4], v[..., 4:]), joint),
    )
    by_step, by_output = known.step_jacobian(0.0, x, u, 0.013, theta), known.output_jacobian(0.0, x, u, theta)
    # the chord method of the torque leaves 1e-13 of the derivatives
    scaled = joint[:, None] / known.step(0.0, x, u, 0.013, theta)[..., None]
    np.testing.assert_allclose(by_step * scaled, of_step * scaled, atol=1e-11)
    per_cent = joint[:, None] / known.output(0.0, x, u, theta)[..., None]
    np.testing.assert_allclose(by_output * per_cent, of_output * per_cent, atol=1e-11)
    one = known.step_jacobian(0.0, x, u, 0.013, theta[0]), known.output_jacobian(0.0, x, u, theta[0])
    np.testing.assert_array_equal(one[0][0], by_step[0])
    np.testing.assert_array_equal(one[1][0], by_output[0])


def test_subsystems_and_sensors_are_those_of_the_paper() -> None:
    assert [len(variables) for variables in SUBSYSTEMS.values()] == [1, 3, 3, 3]
    assert PLANT.sensor_names == tuple(f"S({i}){{{j}}}" for i, n in enumerate((1, 3, 3, 3), 1) for j in range(1, n + 1))
    assert [s.owner for s in PLANT.sensors] == [name for name, variables in SUBSYSTEMS.items() for _ in variables]
    assert list(SENSORS.values()) == [v for variables in SUBSYSTEMS.values() for v in variables]
    values = engine_variables(PLANT.x0, C)
    np.testing.assert_allclose([s.noise_bound for s in PLANT.sensors], [0.05 * values[v] for v in SENSORS.values()])


def test_readings_of_healthy_full_load_stay_within_the_noise_bound() -> None:
    recording = simulate(PLANT, 200, [0, 1])
    values = engine_variables(PLANT.x0, C)
    nominal = np.array([values[v] for v in SENSORS.values()])
    np.testing.assert_allclose(recording.signal, np.broadcast_to(nominal, recording.signal.shape), rtol=1e-10)
    error = np.abs(recording.y / nominal - 1)
    assert error.max() <= 0.05 * (1 + 1e-9) and error.max() > 0.0499  # 4000 uniform draws come within 0.2 % of the bound


def test_a_longer_step_is_divided() -> None:
    x, low = PLANT.x0, np.array([0.8])
    for _ in range(10):
        x = PLANT.step(0.0, x, low, 0.01)
    np.testing.assert_allclose(PLANT.step(0.0, PLANT.x0, low, 0.1), x, rtol=200 * EPS)  # a hundred roundings of each factor


def test_a_truth_model_with_finer_steps_is_the_same_engine() -> None:
    assert PLANT.truth.finer is not None
    finer, to_states = PLANT.truth.finer()
    x = around((2,))
    np.testing.assert_array_equal(to_states(x), x)
    assert finer.sensors == PLANT.sensors
    np.testing.assert_allclose(finer.step(0.0, x, FULL, 0.01), PLANT.step(0.0, x, FULL, 0.01), rtol=1e-2)
    assert np.any(finer.step(0.0, x, FULL, 0.01) != PLANT.step(0.0, x, FULL, 0.01))


def test_bad_settings_name_the_cure() -> None:
    for load in (0.1, 1.2, np.nan):
        with pytest.raises(ValueError, match=r"load is .*; the engine's model holds from 0\.2 to 1\.0 of full load"):
            marine_engine(load=load)
    with pytest.raises(ValueError, match="slip is 'none'; known: law, constant"):
        marine_engine(slip="none")
    with pytest.raises(ValueError, match=r"noise is 0\.0; expected a positive share"):
        marine_engine(noise=0.0)
    with pytest.raises(ValueError, match=r"dt is -1\.0 s"):
        marine_engine(dt=-1.0)
    with pytest.raises(ValueError, match="p_receiver is -1; fuel and pressures must be positive"):
        engine_variables(np.array([2e-3, -1.0, 3e5]), C)
    with pytest.raises(ValueError, match=r"states have shape \(2,\)"):
        engine_variables(np.ones(2), C)
    with pytest.raises(ValueError, match=r"give no positive p_cylinder, .*torque"):
        engine_variables(np.array([1e-5, 3e5, 3e5]), C)


def test_a_simulation_that_leaves_the_model_states_where() -> None:
    with pytest.raises(ArithmeticError, match=r"left the limits of 'marine-engine' at .* fuel = 0.003"):
        simulate(PLANT, 100, [0], inputs=lambda t: np.array([1.5]))
    with pytest.raises(ArithmeticError, match=r"left the limits of 'marine-engine' at 0.01 s: "):
        simulate(PLANT, 100, [0], start=np.array([2.8e-3, 4e5, -1e5]))
