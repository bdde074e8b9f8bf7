"""A user's filterpy filter as a plant: our filters on the plant equal filterpy's own over a whole run."""

from __future__ import annotations

from functools import partial
from typing import Any

import filterpy.kalman as fp
import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.filters import ekf, enkf, ukf
from fusion_sfdia.filters.filterpy_adapter import plant_from_filterpy, sigma_points
from fusion_sfdia.filters.gaussian import condition
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

DT = 0.1
STEPS = 60
SAME = 1e-10  # of order-one states: rounding of some 1e-16 a step, no growth in a stable filter
NO_INPUT = np.zeros(0)


def pendulum(x: Array, dt: float) -> Array:
    return np.array([x[0] + dt * x[1], x[1] - dt * 9.81 * np.sin(x[0])])


def pendulum_jacobian(x: Array) -> Array:
    return np.array([[1.0, DT], [-DT * 9.81 * np.cos(x[0]), 1.0]])


def reading(x: Array) -> Array:
    return np.array([np.sin(x[0]), x[1]])


def reading_jacobian(x: Array) -> Array:
    return np.array([[np.cos(x[0]), 0.0], [0.0, 1.0]])


def readings(seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    x, out = np.array([1.0, 0.0]), []
    for _ in range(STEPS):
        x = pendulum(x, DT)
        out.append(reading(x) + 0.2 * rng.standard_normal(2))
    return np.array(out)


def settle(source: Any, x: Array) -> None:
    source.x = x
    source.P = np.array([[0.5, 0.1], [0.1, 0.4]])
    source.Q = np.array([[2e-3, 1e-3], [1e-3, 4e-3]])
    source.R = np.diag([0.04, 0.09])


def move(plant: Plant, u: Array, x: Array) -> Array:
    return plant.step(0.0, x, u, plant.dt)


def read(plant: Plant, u: Array, x: Array) -> Array:
    return plant.output(0.0, x, u)


def run_ekf(plant: Plant, ys: Array, us: Array | None = None) -> tuple[Array, Array]:
    x: Array = plant.x0
    P: Array = plant.initial_cov
    for k, y in enumerate(ys):
        t, u = k * plant.dt, NO_INPUT if us is None else us[k]
        F = plant.step_jacobian_at(t, x, u, plant.dt)
        x, P = ekf.predict(x, P, partial(move, plant, u), F, plant.process_cov)
        H = plant.output_jacobian_at(t, x, u)
        x, P = condition(ekf.joint(x, P, partial(read, plant, u), H, plant.sensor_cov), y)[:2]
    return x, P


@pytest.mark.parametrize("column", [True, False])
def test_kalman_filter_with_inputs(column: bool) -> None:
    source = fp.KalmanFilter(2, 1, 1)
    source.F = np.array([[1.0, DT], [0.0, 0.95]])
    source.H = np.array([[1.0, 0.3]])
    source.B = np.array([[0.0], [DT]])
    settle(source, np.array([[1.0], [0.5]]) if column else np.array([1.0, 0.5]))
    source.R = np.array([[0.04]])
    plant = plant_from_filterpy(source, dt=DT, sensors=["level"])
    ys, us = readings()[:, :1], np.sin(np.arange(STEPS))[:, None]
    x, P = run_ekf(plant, ys, us)
    for y, u in zip(ys, us, strict=True):
        source.predict(u=u[:, None] if column else u)
        source.update(y[:, None] if column else y)
    assert plant.sensor_names == ("level",) and plant.sensor_sigma == pytest.approx([0.2])
    np.testing.assert_allclose(x, source.x.ravel(), atol=SAME)
    np.testing.assert_allclose(P, source.P, atol=SAME)


class Pendulum(fp.ExtendedKalmanFilter):  # type: ignore[misc]
    """The way filterpy has users give a nonlinear model: predict_x overridden, F set before it is used."""

    def predict_x(self, u: float = 0) -> None:
        state: Array = np.asarray(self.x)  # type: ignore[has-type]
        self.F = pendulum_jacobian(state.ravel())
        self.x = pendulum(state.ravel(), DT).reshape(state.shape)


def column_reading(x: Array) -> Array:
    return reading(x[:, 0])[:, None]


@pytest.mark.parametrize(("given", "tolerance"), [(True, SAME), (False, 1e-8)])
def test_extended_kalman_filter(given: bool, tolerance: float) -> None:
    """With Jacobians given, to rounding; else to the error of central differences, eps^(2/3) = 4e-11 times derivatives."""
    source = Pendulum(2, 2)
    settle(source, np.array([[0.8], [0.1]]))
    jacobians: dict[str, Any] = {}
    if given:
        jacobians = {"h_jacobian": lambda x: reading_jacobian(x[:, 0]), "f_jacobian": pendulum_jacobian}
    plant = plant_from_filterpy(source, dt=DT, h=column_reading, **jacobians)
    x, P = run_ekf(plant, readings())
    np.testing.assert_array_equal(source.x, [[0.8], [0.1]])  # the user's filter is unchanged
    for y in readings():
        source.predict()
        source.update(y[:, None], lambda x: reading_jacobian(x[:, 0]), column_reading)
    np.testing.assert_allclose(x, source.x.ravel(), atol=tolerance)
    np.testing.assert_allclose(P, source.P, atol=tolerance)


def test_extended_kalman_filter_with_its_own_linear_prediction() -> None:
    source = fp.ExtendedKalmanFilter(2, 2, 1)
    source.F = np.array([[1.0, DT], [-0.3, 0.9]])
    source.B = np.array([[0.0], [DT]])
    settle(source, np.array([[0.8], [0.1]]))
    plant = plant_from_filterpy(source, dt=DT, h=column_reading, h_jacobian=lambda x: reading_jacobian(x[:, 0]))
    us = np.cos(np.arange(STEPS))[:, None]
    x, P = run_ekf(plant, readings(), us)
    for y, u in zip(readings(), us, strict=True):
        source.predict(u=u[:, None])
        source.update(y[:, None], lambda x: reading_jacobian(x[:, 0]), column_reading)
    np.testing.assert_allclose(x, source.x.ravel(), atol=SAME)
    np.testing.assert_allclose(P, source.P, atol=SAME)


@pytest.mark.parametrize("points", [fp.MerweScaledSigmaPoints(2, 0.3, 2.0, 1.0), fp.JulierSigmaPoints(2, 1.0)])
def test_unscented_kalman_filter(points: Any) -> None:
    source = fp.UnscentedKalmanFilter(2, 2, DT, reading, pendulum, points)
    settle(source, np.array([0.8, 0.1]))
    plant, settings = plant_from_filterpy(source), sigma_points(source)
    assert plant.dt == DT
    x, P = plant.x0, plant.initial_cov
    for y in readings():
        x, P, _ = ukf.predict(settings, x, P, lambda s: plant.step(0.0, s, NO_INPUT, DT), plant.process_cov)
        x, P = condition(ukf.joint(settings, x, P, lambda s: plant.output(0.0, s, NO_INPUT), plant.sensor_cov), y)[:2]
        source.predict()
        source.update(y)
    np.testing.assert_allclose(x, source.x, atol=SAME)
    np.testing.assert_allclose(P, source.P, atol=SAME)


def test_ensemble_kalman_filter_has_the_moments_of_filterpys() -> None:
    """Random numbers differ, moments before the reading do not: the joint Gaussian of filterpy's own members is the same."""
    source = fp.EnsembleKalmanFilter(np.array([0.8, 0.1]), np.diag([0.5, 0.4]), 2, DT, 30, reading, pendulum)
    source.Q, source.R = np.diag([2e-3, 4e-3]), np.diag([0.04, 0.09])
    plant = plant_from_filterpy(source)
    np.testing.assert_array_equal(plant.x0, [0.8, 0.1])
    before = source.sigmas.copy()
    rng = np.random.default_rng(1)
    np.testing.assert_allclose(
        enkf.predict(before, lambda s: plant.step(0.0, s, NO_INPUT, DT), np.zeros(2), rng), [pendulum(s, DT) for s in before]
    )
    source.predict()
    joint = enkf.joint(source.sigmas.copy(), lambda s: plant.output(0.0, s, NO_INPUT), plant.sensor_cov)
    np.testing.assert_allclose(joint.P, source.P, atol=SAME)
    y = readings()[0]
    source.update(y)
    np.testing.assert_allclose(joint.S, source.S, atol=SAME)
    np.testing.assert_allclose(condition(joint, y).P, source.P, atol=SAME)


def test_a_batch_is_its_elements_with_jacobians_by_differences() -> None:
    source = fp.UnscentedKalmanFilter(2, 2, DT, reading, pendulum, fp.MerweScaledSigmaPoints(2, 0.3, 2.0, 1.0))
    plant = plant_from_filterpy(source, states=["angle", "rate"])
    x = np.random.default_rng(0).standard_normal((4, 3, 2))
    F = plant.step_jacobian_at(0.0, x, NO_INPUT, DT)
    H = plant.output_jacobian_at(0.0, x, NO_INPUT)
    assert [s.name for s in plant.states] == ["angle", "rate"] and F.shape == (4, 3, 2, 2)
    # central differences of width 6e-6: truncation 4e-11 times third derivatives of order one, rounding of 1e-16 / 6e-6
    np.testing.assert_allclose(F[2, 1], pendulum_jacobian(x[2, 1]), atol=1e-9)
    np.testing.assert_allclose(H[2, 1], reading_jacobian(x[2, 1]), atol=1e-9)
    assert plant.step(0.0, x[:0], NO_INPUT, DT).shape == (0, 3, 2)


def broken(kind: str) -> tuple[Any, dict[str, Any]]:
    points = fp.MerweScaledSigmaPoints(2, 0.3, 2.0, 1.0)
    if kind in {"fading", "cross", "correlated", "names"}:
        source = fp.KalmanFilter(2, 2)
        if kind == "fading":
            source.alpha = 1.02
        elif kind == "cross":
            source.M = np.ones((2, 2))
        elif kind == "correlated":
            source.R = np.array([[1.0, 0.5], [0.5, 1.0]])
        return source, {"sensors": ["one"]} if kind == "names" else {}
    if kind == "no h":
        return fp.ExtendedKalmanFilter(2, 2), {}
    if kind == "mean":
        return fp.UnscentedKalmanFilter(2, 2, DT, reading, pendulum, points, x_mean_fn=lambda s, w: w @ s), {}
    return fp.UnscentedKalmanFilter(2, 2, DT, reading, pendulum, points), {"dt": 1.0}


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("fading", "alpha is 1.02.*set alpha = 1"),
        ("cross", "M is not zero.*include it"),
        ("correlated", "R is not diagonal.*whiten"),
        ("names", "1 sensor and 2 state names; the filter has 2 readings"),
        ("no h", "pass it as h="),
        ("mean", "its own x_mean_fn"),
        ("dt", "dt is 1.0 s.*leave it out"),
    ],
)
def test_what_a_plant_cannot_carry_is_an_error_with_its_cure(kind: str, message: str) -> None:
    source, options = broken(kind)
    with pytest.raises(ValueError, match=message):
        plant_from_filterpy(source, **options)


def test_sigma_points_without_counterpart() -> None:
    source = fp.UnscentedKalmanFilter(2, 2, DT, reading, pendulum, fp.SimplexSigmaPoints(2))
    with pytest.raises(ValueError, match="SimplexSigmaPoints; use Merwe"):
        sigma_points(source)
