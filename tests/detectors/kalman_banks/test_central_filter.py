"""The central filter: one filter with a test of each innovation."""

import numpy as np
import pytest
from rounding import rounding
from scipy.stats import norm
from toy_plants import chain, changed, readings, tanks

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.filters.enkf import EnKFSettings
from fusion_sfdia.filters.estimators import Ensemble, Extended, Unscented


def test_on_a_linear_plant_it_is_the_textbook_kalman_filter() -> None:
    plant = chain(5, sensors=4)
    t, _, y, u = readings(plant, 30, 1, seed=0)
    y = y[:, 0]
    _, got = run(CentralFilter(plant), CentralFilter(plant).init(), t, y, u[:, 0], covariance=True)
    f = plant.step_jacobian_at(0.0, plant.x0, u[0, 0], 1.0)
    h = plant.output_jacobian_at(0.0, plant.x0, u[0, 0])
    q, r = np.diag(plant.process_cov), np.diag(plant.sensor_cov)
    x, p = plant.x0, np.diag(plant.initial_cov)
    for k in range(30):
        x, p = f @ x, f @ p @ f.T + q
        s = h @ p @ h.T + r
        innovation = y[k] - h @ x
        gain = p @ h.T @ np.linalg.inv(s)
        x, p = x + gain @ innovation, (np.eye(5) - gain @ h) @ p
        # k + 1 stable steps of sums over five states and four readings, numbers of order 1 to 10
        tolerance = rounding(10 * np.linalg.cond(s), (k + 1) * (5 + 4))
        np.testing.assert_allclose(got.estimate[k], x, rtol=0, atol=tolerance)
        np.testing.assert_allclose(got.covariance[k], p, rtol=0, atol=tolerance)  # type: ignore[arg-type, index]
        np.testing.assert_allclose(got.residual[k], innovation, rtol=0, atol=tolerance)
        np.testing.assert_allclose(got.threshold[k], norm.isf(1e-3 / 4 / 2) * np.sqrt(np.diag(s)), rtol=tolerance)
        squared = innovation @ np.linalg.solve(s, innovation)  # its terms differ by at most 2 |d| |S^-1 d|
        near = tolerance * 2 * np.abs(np.linalg.solve(s, innovation)).sum()
        assert got.nis[k] == pytest.approx(squared / 4, rel=0, abs=near)


@pytest.mark.parametrize("false_alarm", [0.02, 0.2])
def test_the_budget_holds_and_is_nearly_used(false_alarm: float) -> None:
    plant = chain(6)
    t, _, y, u = readings(plant, 300, 40, seed=1)
    detector = CentralFilter(plant, false_alarm=false_alarm)
    _, d = run(detector, detector.init((40,)), t, y, u)
    error = 3 * np.sqrt(false_alarm * (1 - false_alarm) / d.alarm.size)  # innovations are white: samples are independent
    # Bonferroni is a bound; for independent sensors it is conservative by half the square of the budget, otherwise little more
    assert 0.8 * false_alarm - error < d.alarm.mean() <= false_alarm + error
    assert d.nis.mean() == pytest.approx(1.0, abs=3 * np.sqrt(2 / 6 / d.nis.size))


@pytest.mark.parametrize("estimator", [Extended(), Unscented(), Ensemble(EnKFSettings(size=200))], ids=["ekf", "ukf", "enkf"])
def test_a_jump_is_isolated_with_its_size_and_nothing_is_replaced(estimator: object) -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 40, 5, seed=2)
    y = y.copy()
    y[30:, :, 2] -= 15 * plant.sensor_sigma[2]
    detector = CentralFilter(plant, estimator)  # type: ignore[arg-type]
    _, d = run(detector, detector.init((5,)), t, y, u)
    assert d.isolated[30, :, 2].all() and not d.isolated[30, :, [0, 1, 3]].any()
    np.testing.assert_array_equal(d.fault_size[30, :, 2], d.residual[30, :, 2])
    # the innovation's own deviation is less than sqrt(2) of the reading's; four of them
    np.testing.assert_allclose(d.fault_size[30, :, 2] / plant.sensor_sigma[2], -15.0, atol=4 * np.sqrt(2))
    np.testing.assert_array_equal(d.reconstruction, y)


def test_only_the_sensor_with_the_largest_ratio_is_isolated() -> None:
    plant = chain(4)
    detector = CentralFilter(plant)
    y = np.array([20.0, 0.0, -30.0, np.nan])
    _, d = detector.step(detector.init(), 1.0, y, np.zeros(0))
    assert d.isolated.tolist() == [False, False, True, False]
    assert np.sum(d.scores > 1) == 2 and np.isnan(d.residual[3]) and np.isfinite(d.reconstruction[3])


def test_without_readings_it_predicts() -> None:
    plant = tanks()
    detector = CentralFilter(plant)
    _, d = detector.step(detector.init(), 5.0, np.full(4, np.nan), plant.input_at(0.0))
    np.testing.assert_array_equal(d.estimate, plant.step(0.0, plant.x0, plant.input_at(0.0), 5.0))
    np.testing.assert_array_equal(d.reconstruction, plant.output(5.0, d.estimate, plant.input_at(0.0)))
    assert not d.alarm and not d.diverged


def test_divergence_is_flagged_and_the_other_runs_of_the_batch_continue() -> None:
    plant = chain(3)
    lost = changed(plant, output=lambda t, x, u: np.where(np.abs(x) > 50, np.nan, x), output_jacobian=lambda t, x, u: np.eye(3))
    detector = CentralFilter(lost)
    t, _, y, u = readings(plant, 12, 3, seed=3)
    y = y.copy()
    y[4, 1, 0] = 1e3
    _, d = run(detector, detector.init((3,)), t, y, u)
    _, undisturbed = run(detector, detector.init((3,)), t[:4], y[:4], u[:4])
    np.testing.assert_array_equal(d.estimate[:4], undisturbed.estimate)
    assert d.diverged[5:, 1].all() and not d.diverged[:, [0, 2]].any()
    assert np.isnan(d.estimate[5:, 1]).all() and np.isnan(d.fault_size[5:, 1]).all() and not d.isolated[5:, 1].any()
    assert np.isfinite(d.estimate[:, [0, 2]]).all()


@pytest.mark.parametrize("false_alarm", [0.0, 1.0, -0.1, float("nan")])
def test_a_budget_is_a_probability(false_alarm: float) -> None:
    with pytest.raises(ValueError, match=f"false_alarm is {false_alarm}; expected a probability strictly between 0 and 1"):
        CentralFilter(chain(2), false_alarm=false_alarm)
