"""A plant with what it does not know as states: the same plant at nominal values, its derivatives, and a filter on it."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from toy_plants import chain

from fusion_sfdia.common.covariance import diagonal
from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.derivatives.equation import difference_jacobian
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.two_tanks.plant import INFLOW, two_tanks
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import HOUR, Disturbance, Parameter, Uncertainty

Array = NDArray[Any]
EPS = np.finfo(float).eps
F, G, H = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[1.0, 0.0], [0.5, 2.0]]), np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
D = np.array([[0.0, 0.3], [0.0, 0.0], [0.0, 0.0]])  # of the inputs on the readings
BY_THETA, READ_THETA = np.array([0.2, -0.4]), np.array([0.0, 0.5, 0.0])
DRIFT = Disturbance("drift", np.array([0.1, 0.0]), np.array([0.0, 0.0, 1.0]), sd=2.0, time_constant=20.0)
GAIN = Parameter("gain", "1", 3.0, 0.5, rate=0.6)


def by_theta(t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
    return np.asarray(x @ F.T + u @ G.T + (theta - 3.0) * BY_THETA)


def read_theta(t: float, x: Array, u: Array, theta: Array) -> Array:
    return np.asarray(x @ H.T + u @ D.T + (theta - 3.0) * READ_THETA)


def linear(**changes: Any) -> Plant:
    """A linear plant with a parameter, an error of its second input and a disturbance."""
    stated: dict[str, Any] = {"inputs": {"b": 0.7}, "disturbances": (DRIFT,)} | changes
    plant = linear_plant(
        "linear", F, H, [Sensor(f"s{i}", "x0", sigma=0.3) for i in range(3)], dt=10.0, x0=np.ones(2),
        initial_cov=np.full(2, 0.4), process_cov=np.full(2, 0.01), input_matrix=G, feedthrough=D,
        inputs=(Signal("a", nominal=0.1), Signal("b", nominal=-0.2)),
    )  # fmt: skip
    return replace(plant, uncertainty=Uncertainty((GAIN,), by_theta, read_theta, **stated))


def matrices() -> tuple[Array, Array]:
    """F (5, 5) and H (3, 5) of z = (x, theta, delta, xi)."""
    f = np.zeros((5, 5))
    f[:2] = np.column_stack([F, BY_THETA, G[:, 1], DRIFT.state])
    f[2, 2] = f[3, 3] = 1.0
    f[4, 4] = np.exp(-10.0 / 20.0)
    return f, np.column_stack([H, READ_THETA, D[:, 1], DRIFT.reading])


def test_the_added_states_come_after_those_of_the_plant() -> None:
    plant = augment(linear())
    assert [s.name for s in plant.states] == ["x0", "x1", "gain", "error of b", "drift"]
    np.testing.assert_array_equal(plant.x0, [1, 1, 3, 0, 0])
    np.testing.assert_allclose(plant.initial_cov, [0.4, 0.4, 0.25, 0.49, 4.0], rtol=2 * EPS)
    # a walk of .6 in an hour; a disturbance keeps its variance: 4 (1 - exp(-2 * 10 / 20))
    np.testing.assert_allclose(
        plant.process_cov, [0.01, 0.01, 0.36 * 10 / HOUR, 0.0, 4 * (1 - np.exp(-1.0))], rtol=rounding(1.0, 4)
    )
    assert plant.uncertainty == Uncertainty() and augment(plant) is plant
    assert augment(chain(3)) is not None and augment(linear_without()).uncertainty == Uncertainty()


def linear_without() -> Plant:
    return replace(linear(), uncertainty=Uncertainty())


def test_limits_are_twenty_standard_deviations_or_those_of_the_parameter() -> None:
    low = replace(GAIN, low=2.5)
    (state,) = (s for s in augment(replace(linear(), uncertainty=Uncertainty((low,), by_theta))).states if s.name == "gain")
    assert (state.low, state.high, state.initial_sigma) == (2.5, 13.0, 0.5)
    others = augment(linear()).states[3:]  # an error of an input and a disturbance have none
    assert [(s.low, s.high) for s in others] == [(-np.inf, np.inf)] * 2


def test_step_output_and_jacobians_are_those_of_the_matrices() -> None:
    plant, (f, h) = augment(linear()), matrices()
    z, u = np.random.default_rng(0).standard_normal((2, 4, 5)), np.random.default_rng(1).standard_normal((4, 2))
    off = np.array([0, 0, 3.0, 0, 0])
    # sums of five products of numbers of order one
    close: dict[str, float] = {"rtol": 0, "atol": rounding(1.0, 40)}
    step = (z - off) @ f.T + off + np.pad(u @ G.T, ((0, 0), (0, 3)))
    np.testing.assert_allclose(plant.step(0.0, z, u, 10.0), step, **close)
    np.testing.assert_allclose(plant.output(0.0, z, u), (z - off) @ h.T + u @ D.T, **close)
    np.testing.assert_allclose(plant.step_jacobian_at(0.0, z, u, 10.0), np.broadcast_to(f, (2, 4, 5, 5)), **close)
    np.testing.assert_allclose(plant.output_jacobian_at(0.0, z, u), np.broadcast_to(h, (2, 4, 3, 5)), **close)


def test_the_extended_filter_on_it_is_the_kalman_filter_of_the_matrices() -> None:
    plant, (f, h) = augment(linear()), matrices()
    rng = np.random.default_rng(2)
    y, u = rng.standard_normal((30, 3)), rng.standard_normal((30, 2))
    found = CentralFilter(plant)
    _, decisions = run(found, found.init(), np.arange(1, 31) * 10.0, y, u, covariance=True)
    x, P, off = plant.x0.copy(), np.diag(plant.initial_cov), np.array([0, 0, 3.0, 0, 0])
    for k in range(30):
        x = f @ (x - off) + off + np.concatenate([G @ u[k], np.zeros(3)])
        P = f @ P @ f.T + np.diag(plant.process_cov)
        S = h @ P @ h.T + 0.09 * np.eye(3)
        K = np.linalg.solve(S, h @ P).T
        x, P = x + K @ (y[k] - h @ (x - off) - D @ u[k]), P - K @ S @ K.T
        # S is solved with in each of k steps; P loses as much to cancellation as the prior exceeds it
        near = rounding(float(np.linalg.cond(S)), 8 * (k + 1) * 10) * 10
        np.testing.assert_allclose(decisions.estimate[k], x, rtol=0, atol=near)
        assert decisions.covariance is not None
        np.testing.assert_allclose(decisions.covariance[k], P, rtol=0, atol=near)


def test_jacobians_of_a_nonlinear_plant_are_derivatives_at_the_parameters_of_the_state() -> None:
    plant = two_tanks()
    known = replace(plant.uncertainty, disturbances=(Disturbance("d", np.array([1e-3, 0.0]), np.array([0, 1e-2, 0, 0])),))
    larger = augment(replace(plant, uncertainty=known))
    z = larger.x0 + 2 * larger.state_scale * np.random.default_rng(3).uniform(-1, 1, (4, larger.x0.size))
    u = np.broadcast_to(plant.input_at(0.0), (4, 1))
    for jacobian, function, rows in (
        (larger.step_jacobian_at(0.0, z, u, 5.0), lambda p: larger.step(0.0, p, u[:, None] if p.ndim > 2 else u, 5.0), 7),
        (larger.output_jacobian_at(0.0, z, u), lambda p: larger.output(0.0, p, u[:, None] if p.ndim > 2 else u), 4),
    ):
        assert jacobian.shape == (4, rows, 7)
        expected = difference_jacobian(function, z, larger.state_scale) * larger.state_scale
        scale = np.abs(expected).max(axis=-1, keepdims=True)
        # central differences of width eps^(1/3): their error is about eps^(2/3) of the change over the scale
        np.testing.assert_allclose(jacobian * larger.state_scale / scale, expected / scale, rtol=0, atol=1e3 * EPS ** (2 / 3))


def test_frozen_states_have_no_variance_but_their_scale() -> None:
    larger = augment(two_tanks())
    leak = [s.name for s in larger.states].index("leak")
    assert not diagonal(larger.initial_cov)[leak] and not larger.process_cov[leak]
    assert larger.state_scale[leak] == pytest.approx(0.05 * INFLOW)


def test_a_plant_at_rest_starts_where_its_parameters_put_it() -> None:
    """By hand, level_1 = ((inflow + delta) / outlet_1)^2 = 1 m: it falls by 2 sd / outlet, and rises by 2 sd / inflow."""
    plant = two_tanks()
    assert plant.uncertainty.at_rest
    at_rest, free = augment(plant), augment(replace(plant, uncertainty=replace(plant.uncertainty, at_rest=False)))
    name = [s.name for s in at_rest.states].index
    by_outlet, by_inflow = -2 / 6e-4, 2 / INFLOW
    outlet, inflow = (3e-5) ** 2, (0.01 * INFLOW) ** 2
    cov, own = at_rest.initial_cov, diagonal(free.initial_cov)
    # I - F is conditioned as the time constant over the step, 33, and F is exact to rounding of some hundred operations
    close = rounding(40.0, 400)
    assert cov[0, name("outlet_1")] == pytest.approx(by_outlet * outlet, rel=close)
    assert cov[0, name("error of inflow")] == pytest.approx(by_inflow * inflow, rel=close)
    assert cov[0, 0] - own[0] == pytest.approx(by_outlet**2 * outlet + by_inflow**2 * inflow, rel=close)
    np.testing.assert_allclose(np.diagonal(cov)[2:], own[2:], rtol=4 * EPS)


def test_considered_states_are_those_of_this_treatment_and_those_named() -> None:
    considered = replace(GAIN, treatment="considered")
    plant = linear()
    larger = augment(
        replace(plant, uncertainty=replace(plant.uncertainty, parameters=(considered,), considered=("error of b", "x0")))
    )
    assert larger.considered is not None and list(larger.considered) == [0, 2, 3]
    slow = replace(DRIFT, treatment="frozen")
    assert augment(linear(disturbances=(slow,))).initial_cov[-1] == 0.0


def test_at_rest_the_initial_state_follows_the_unknown() -> None:
    """x = F x + G (u + delta) + (theta - 3) B: x0 moves by (I - F)^-1 (B, G e_1), so its covariance with them is that."""
    plant = linear(at_rest=True)
    larger, apart = augment(plant), augment(linear())
    follows = np.linalg.solve(np.eye(2) - F, np.column_stack([BY_THETA, G[:, 1]]))  # (n, 2)
    unknown = np.diag([GAIN.sd**2, 0.7**2])
    near = rounding(float(np.linalg.cond(np.eye(2) - F)), 40) * np.abs(follows).max() ** 2
    P = larger.initial_cov
    np.testing.assert_allclose(P[:2, :2], np.diag([0.4, 0.4]) + follows @ unknown @ follows.T, rtol=0, atol=near)
    np.testing.assert_allclose(P[:2, 2:4], follows @ unknown, rtol=0, atol=near)
    np.testing.assert_allclose(P[2:4, 2:4], unknown, rtol=1e-15)
    np.testing.assert_array_equal(P, P.T)
    # the disturbance, whose value at the start is drawn then, has not moved the state yet
    assert P[4, 4] == 4.0 and not np.any(P[:4, 4])
    np.testing.assert_array_equal(larger.x0, apart.x0)
    np.testing.assert_array_equal(larger.process_cov, apart.process_cov)
    assert apart.initial_cov.ndim == 1


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"inputs": {"c": 1.0}}, "plant 'linear' has no input c; its inputs: a, b"),
        ({"disturbances": (Disturbance("d", np.zeros(3), np.zeros(3)),)}, r"shapes \(3,\) and \(3,\); expected \(2,\)"),
    ],
)
def test_what_does_not_fit_the_plant_is_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        augment(linear(**wrong))


def test_other_units_of_readings_change_nothing_else() -> None:
    plant = replace(linear(), truth=two_tanks().truth.__class__())
    units = {"s1": ("mm", 1000.0), "s2": ("mm", -1000.0)}
    factor = np.array([1.0, 1000.0, -1000.0])
    first, last = augment(plant.in_units(units)), augment(plant).in_units(units)
    z, u = np.random.default_rng(4).standard_normal((3, 5)), np.zeros((3, 2))
    for other in (first, last):
        np.testing.assert_allclose(other.output(0.0, z, u), augment(plant).output(0.0, z, u) * factor, rtol=4 * EPS)
        np.testing.assert_allclose(
            other.output_jacobian_at(0.0, z, u), augment(plant).output_jacobian_at(0.0, z, u) * factor[:, None], rtol=4 * EPS
        )
    at = two_tanks().in_units({"q2": ("l/s", 1000.0)}).uncertainty
    assert at.output is not None
    theta = np.array([6e-4, 3e-4, 0.0])
    assert at.output(0.0, np.ones(2), np.full(1, INFLOW), theta)[3] == pytest.approx(0.3, rel=4 * EPS)


def test_it_is_simulated_and_pickled() -> None:
    plant = augment(two_tanks())
    finer, own = simulate(plant, 5, [1]), simulate(two_tanks(), 5, [1])
    np.testing.assert_array_equal(finer.y, own.y)  # the high-fidelity model has neither errors nor other parameters
    np.testing.assert_array_equal(finer.x[0, 0, 2:], plant.x0[2:])
    drawn = simulate(plant, 5, [1, 2], truth="model")
    assert np.all(np.isfinite(drawn.y))
    copy = pickle.loads(pickle.dumps(plant))
    z, u = plant.x0 + 0.1 * plant.state_scale, plant.input_at(0.0)
    np.testing.assert_array_equal(copy.step_jacobian_at(0.0, z, u, 5.0), plant.step_jacobian_at(0.0, z, u, 5.0))


@pytest.mark.parametrize("name", sorted(registry.detectors()))
def test_every_named_detector_runs_on_it(name: str) -> None:
    plant = augment(two_tanks())
    try:
        detector = registry.detector(name, plant)
    except NotApplicableError as error:
        assert "equation" in str(error) or "modules" in str(error)  # the scalar equations are those of the nominal plant
        return
    recording = simulate(plant, 20, [1, 2])
    _, decisions = run(detector, detector.init((2,)), recording.t, recording.y, recording.u_of_runs)
    assert decisions.estimate.shape[-1] == 6 or not np.isfinite(decisions.estimate).all()
    assert not decisions.diverged.any() and np.isfinite(decisions.reconstruction).all()
