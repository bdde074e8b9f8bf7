"""The filter that is decoupled from errors of the inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from toy_plants import Array, chain, tanks

from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.sequential_bank import SequentialBank
from fusion_sfdia.detectors.kalman_banks.unknown_input import UnknownInputFilter, complex_step_in_inputs, input_jacobians
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

STATES, READOUT = 4, 6
# DECOUPLED^-2 = 1e-8 of an input's error remains and rounding magnifies to eps DECOUPLED^2 = 2e-8, of readings of some hundred
# for sensors that mainly measure the input, with a tenth of their former weight, the error is ten times as large
TOLERANCE = 1e-4


def driven(mute: bool = False) -> tuple[Plant, Array, Array, Array]:
    """A plant with two inputs, and its A, B, H. mute: the second input has no effect within a step."""
    rng = np.random.default_rng(0)
    a = 0.9 * np.eye(STATES) + 0.1 * rng.standard_normal((STATES, STATES))
    b = rng.standard_normal((STATES, 2)) * ([1.0, 0.0] if mute else [1.0, 1.0])
    h = rng.standard_normal((READOUT, STATES))
    plant = linear_plant(
        "driven", a, h, [Sensor(f"s{i}", f"r{i}", sigma=0.5) for i in range(READOUT)], dt=1.0, x0=np.zeros(STATES),
        initial_cov=np.full(STATES, 1.0), process_cov=np.full(STATES, 0.01), input_matrix=b,
        inputs=[Signal("a"), Signal("b")],
    )  # fmt: skip
    return plant, a, b, h


def recorded(plant: Plant, steps: int, runs: int, seed: int, error: Array) -> tuple[Array, Array, Array]:
    """Times, readings (K, runs, N) of a plant whose inputs have the error `error` (K, m), and the known inputs: 0."""
    rng = np.random.default_rng(seed)
    x, y = np.zeros((runs, STATES)), np.empty((steps, runs, READOUT))
    for k in range(steps):
        x = plant.step(float(k), x, np.broadcast_to(error[k], (runs, 2)), 1.0) + 0.1 * rng.standard_normal((runs, STATES))
        y[k] = plant.output(k + 1.0, x, error[k]) + 0.5 * rng.standard_normal((runs, READOUT))
    return np.arange(1.0, steps + 1), y, np.zeros((steps, 2))


def test_an_arbitrary_error_of_the_inputs_moves_neither_error_nor_statistic() -> None:
    """On a linear plant, up to TOLERANCE."""
    plant, *_ = driven()
    rng = np.random.default_rng(1)
    error = 10 * rng.standard_normal((40, 2))
    t, y, u = recorded(plant, 40, 3, 2, np.zeros((40, 2)))
    _, disturbed, _ = recorded(plant, 40, 3, 2, error)
    bank = UnknownInputFilter(plant, accommodate=False)
    _, a = run(bank, bank.init((3,)), t, y, u)
    _, b = run(bank, bank.init((3,)), t, disturbed, u)
    truth = np.zeros(STATES)
    for k in range(40):
        truth = plant.step(float(k), truth, error[k], 1.0)
        moved = b.estimate[k] - a.estimate[k]
        np.testing.assert_allclose(moved, np.broadcast_to(truth, moved.shape), atol=TOLERANCE)
    np.testing.assert_allclose(b.residual, a.residual, atol=TOLERANCE)
    known = SequentialBank(plant, accommodate=False)
    _, c = run(known, known.init((3,)), t, disturbed, u)
    assert c.score.max() > 5 and b.score.max() < 2  # while a bank that assumes known inputs isolates sensors falsely


def test_it_is_the_filter_of_gillijns_and_de_moor() -> None:
    """Steps (1) to (3) of Gillijns and De Moor 2007, sec. 3 to 5: prediction, input estimate, update with S^-1 as in a KF."""
    plant, a, b, h = driven()
    t, y, u = recorded(plant, 30, 1, 3, np.ones((30, 2)))
    bank = UnknownInputFilter(plant, accommodate=False)
    _, d = run(bank, bank.init(), t, y[:, 0], u, covariance=True)
    assert d.covariance is not None
    x, p, q, r = np.zeros(STATES), np.eye(STATES), 0.01 * np.eye(STATES), 0.25 * np.eye(READOUT)
    for k in range(30):
        x, p = a @ x, a @ p @ a.T + q
        s, f = h @ p @ h.T + r, h @ b
        inverse = np.linalg.inv(s)
        cov = np.linalg.inv(f.T @ inverse @ f)  # of the input's estimate
        inputs = cov @ f.T @ inverse @ (y[k, 0] - h @ x)
        gain = p @ h.T @ inverse
        x = x + b @ inputs
        x = x + gain @ (y[k, 0] - h @ x)
        left = b - gain @ f
        p = p - gain @ s @ gain.T + left @ cov @ left.T
        np.testing.assert_allclose(d.estimate[k], x, atol=TOLERANCE)
        np.testing.assert_allclose(d.covariance[k], p, atol=TOLERANCE)


def test_a_faulty_sensor_is_isolated_while_the_inputs_have_errors() -> None:
    plant, *_ = driven()
    error = 20 * np.sin(np.arange(80.0))[:, None] * np.ones(2)
    t, y, u = recorded(plant, 80, 20, 4, error)
    y[40:, :, 1] += 30 * 0.5
    bank = UnknownInputFilter(plant)
    _, d = run(bank, bank.init((20,)), t, y, u)
    assert not d.isolated[5:40].any(axis=-1).mean() > 0.01
    assert d.isolated[42:, :, 1].mean() > 0.95 and np.delete(d.isolated[40:], 1, axis=-1).mean() < 0.02


def test_jacobians_are_differences() -> None:
    plant = tanks()
    x, u = plant.x0[None] * 1.1, plant.input_at(0.0)[None]
    g, f = input_jacobians(plant, 0.0, plant.dt, x, u, exact=True)
    width = 1e-6  # m3/s of 6e-4: a thousandth, whose square times the curvature, and eps over it, stay below 1e-5
    ahead, behind = (plant.step(0.0, x, u + s * width, plant.dt) for s in (1, -1))
    np.testing.assert_allclose(g[0, :, 0], (ahead - behind)[0] / (2 * width), rtol=1e-5, atol=1e-5 * np.abs(g).max())
    slope = (plant.output(5.0, ahead, u) - plant.output(5.0, behind, u))[0] / (2 * width)
    np.testing.assert_allclose(f[0, :, 0], slope, rtol=1e-5, atol=1e-5 * np.abs(f).max())


@pytest.mark.parametrize("bent", [np.abs, lambda u: np.interp(u, [0.0, 10.0], [0.0, 10.0])], ids=["abs", "interp"])
@pytest.mark.parametrize("within", ["step", "output"])
def test_inputs_that_the_complex_step_cannot_differentiate(bent: Callable[[Array], Array], within: str) -> None:
    """The plant with u in place of |u|, or of a table of it, at positive inputs: the same Jacobians and decisions."""

    def step(of: Callable[[Array], Array], t: float, x: Array, u: Array, dt: float) -> Array:
        return np.asarray(0.9 * x + of(u))

    def output(of: Callable[[Array], Array], t: float, x: Array, u: Array) -> Array:
        return np.concatenate([x, 2 * x, 3 * x + of(u)], axis=-1)

    plain = Plant(
        "bent", (Signal("x"),), tuple(Sensor(f"s{i}", f"r{i}", sigma=0.1) for i in range(3)), partial(step, np.asarray),
        partial(output, np.asarray), 1.0, (Signal("u", nominal=5.0),), np.full(1, 50.0), np.ones(1), np.full(1, 0.01),
    )  # fmt: skip
    changed = partial(step if within == "step" else output, bent)
    plant = replace(plain, **{within: changed})
    assert complex_step_in_inputs(plain) and not complex_step_in_inputs(plant)
    rng = np.random.default_rng(6)
    y = np.array([50.0, 100.0, 155.0]) + 0.1 * rng.standard_normal((30, 3))
    y[20:, 1] += 2.0
    first, second = (
        run(bank, bank.init(), np.arange(1.0, 31), y, np.full((30, 1), 5.0))[1]
        for bank in (UnknownInputFilter(plain), UnknownInputFilter(plant))
    )
    assert first.isolated[21:, 1].all()
    np.testing.assert_array_equal(second.isolated, first.isolated)
    # differences of width eps^(1/3) 5 err by eps^(2/3) of the slope; DECOUPLED times as much of the noise, and then TOLERANCE
    np.testing.assert_allclose(second.estimate, first.estimate, atol=TOLERANCE)


def test_an_input_that_cannot_be_decoupled_counts_as_known() -> None:
    plant, *_ = driven(mute=True)
    t, y, u = recorded(plant, 30, 2, 5, np.ones((30, 2)))
    bank = UnknownInputFilter(plant)
    _, d = run(bank, bank.init((2,)), t, y, u)
    assert np.all(np.isfinite(d.estimate)) and not d.diverged.any()
    with pytest.raises(NotApplicableError, match="nothing can be decoupled"):
        UnknownInputFilter(chain(4))


def test_without_readings_of_the_effect_of_an_input_it_counts_as_known() -> None:
    """Otherwise the remaining readings, which hardly depend on it, would give a large estimation error."""
    plant = tanks()
    t = np.arange(1, 41) * plant.dt
    y = np.tile(plant.output(0.0, plant.x0, plant.input_at(0.0)), (40, 1))
    y[20:30, [plant.sensor_index("l1"), plant.sensor_index("q12")]] = np.nan
    y[20:30, plant.sensor_index("l2")] += 2 * plant.sensor_sigma[1]
    bank = UnknownInputFilter(plant)
    _, d = run(bank, bank.init(), t, y, np.tile(plant.input_at(0.0), (40, 1)))
    assert np.all(np.abs(d.estimate - plant.x0) < 0.05)  # five standard deviations of a reading
