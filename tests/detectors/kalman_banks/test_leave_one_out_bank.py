"""The leave-one-out bank: false alarms, detection, simultaneous and weak faults, readmission, missing readings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom
from toy_plants import chain, changed, readings, tanks

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.filters.estimators import Ensemble, Extended, Unscented
from fusion_sfdia.plant.plant import Plant


@pytest.mark.parametrize("window", [1, 15])
@pytest.mark.parametrize("plant", [chain(12), chain(4, sensors=9), tanks()], ids=["chain", "general-h", "tanks"])
def test_false_alarms_stay_within_the_budget(plant: Plant, window: int) -> None:
    t, x, y, u = readings(plant, 300, 60, seed=1)
    bank = LeaveOneOutBank(plant, window=window, false_alarm=0.01, accommodate=False)
    _, decisions = run(bank, bank.init((60,)), t, y, u, covariance=True)
    # without accommodation a window's alarm lasts while the same samples are in it: count the steps at which one begins
    alarm = decisions.alarm
    begins = alarm[1:] & ~alarm[:-1]
    assert begins.sum() <= binom.ppf(0.9999, begins.size, 0.01)
    assert decisions.covariance is not None
    error = decisions.estimate - x
    nees = np.einsum("kbi,kbij,kbj->b", error, np.linalg.inv(decisions.covariance), error) / (len(t) * x.shape[-1])
    assert abs(nees.mean() - 1) < 4 * nees.std() / np.sqrt(nees.size) + 0.01  # runs are independent; 1 % for the nonlinearity
    assert abs(decisions.nis.mean() - 1) < 0.02


@pytest.mark.parametrize("plant", [chain(12), tanks()], ids=["chain", "tanks"])
def test_a_window_detects_the_weak_bias_that_one_sample_misses(plant: Plant) -> None:
    t, _, y, u = readings(plant, 150, 80, seed=2)
    y = y.copy()
    y[60:110, :, 1] += 3.0 * plant.sensor_sigma[1]
    recall = {}
    for window in (1, 15):
        bank = LeaveOneOutBank(plant, window=window)
        _, decisions = run(bank, bank.init((80,)), t, y, u)
        recall[window] = decisions.isolated[60:110, :, 1].mean()
        others = np.delete(decisions.isolated, 1, axis=-1).mean()
        assert others < 0.01
    assert recall[15] > 0.85 and recall[15] > recall[1] + 0.1


def test_the_size_of_a_fault_is_estimated_without_bias() -> None:
    plant = chain(12)
    t, _, y, u = readings(plant, 120, 80, seed=3)
    y = y.copy()
    y[60:, :, 4] -= 8.0
    bank = LeaveOneOutBank(plant)
    _, decisions = run(bank, bank.init((80,)), t, y, u)
    size = decisions.fault_size[75:, :, 4]
    assert decisions.isolated[75:, :, 4].all()
    # mean over five readings of unit noise and over the slower error of the estimate: 80 independent runs
    assert abs(np.mean(size) + 8.0) < 4 * np.std(np.mean(size, axis=0)) / np.sqrt(80)


def test_three_simultaneous_faults_are_isolated_in_their_first_sample() -> None:
    plant = chain(12)
    t, _, y, u = readings(plant, 60, 100, seed=4)
    y = y.copy()
    y[50:, :, 2] += 8.0
    y[50:, :, 3] -= 8.0
    y[50:, :, 9] += 8.0
    bank = LeaveOneOutBank(plant)
    _, decisions = run(bank, bank.init((100,)), t, y, u)
    truth = np.isin(np.arange(12), [2, 3, 9])
    exact = np.all(decisions.isolated[50] == truth, axis=-1)
    assert exact.mean() > 0.97  # 8 sigma against a threshold of 3.6: missed once in 1e4; false flags at most 1e-3 a step


def test_a_recovered_sensor_is_readmitted_and_a_missing_one_is_not_isolated() -> None:
    plant = chain(12)
    t, _, y, u = readings(plant, 200, 50, seed=5)
    y = y.copy()
    y[50:80, :, 6] += 12.0
    y[60:70, :, 6] = np.nan  # missing in the middle of its fault: it stays isolated
    y[120:140, :, 7] = np.nan  # missing while healthy: not isolated, and used again at once
    bank = LeaveOneOutBank(plant)
    _, decisions = run(bank, bank.init((50,)), t, y, u)
    assert decisions.isolated[51:80, :, 6].mean() > 0.99
    assert decisions.isolated[90:, :, 6].mean() < 0.02
    assert decisions.isolated[120:145, :, 7].mean() < 0.01
    assert np.all(np.isnan(decisions.residual[120:140, :, 7]))
    # a missing or excluded reading is replaced by the estimate; each sensor reads one state
    kept = np.isfinite(y) & ~decisions.isolated
    np.testing.assert_array_equal(decisions.reconstruction, np.where(kept, y, decisions.estimate))


def test_accommodation_keeps_the_error_of_a_healthy_run() -> None:
    plant = tanks()
    t, x, y, u = readings(plant, 150, 60, seed=6)
    faulty = y.copy()
    faulty[50:100, :, 0] += 30 * plant.sensor_sigma[0]
    bank = LeaveOneOutBank(plant)
    rmse = {}
    for name, data, used in (
        ("healthy", y, bank),
        ("with", faulty, bank),
        ("without", faulty, replace(bank, accommodate=False)),
    ):
        _, decisions = run(used, used.init((60,)), t, data, u)
        rmse[name] = np.sqrt(np.mean((decisions.estimate - x)[50:100] ** 2))
    assert rmse["with"] < 1.3 * rmse["healthy"]  # with three of four sensors
    assert rmse["without"] > 4 * rmse["healthy"]


def test_decisions_do_not_change_with_the_unit_of_a_sensor() -> None:
    plant = tanks()
    litres = plant.in_units({"q12": ("l/h", 3.6e6), "l1": ("mm", 1e3)})
    t, _, y, u = readings(plant, 150, 20, seed=7)
    y = y.copy()
    y[50:90, :, 2] += 4 * plant.sensor_sigma[2]
    y[100:120, :, 0] += 5 * plant.sensor_sigma[0]
    for estimator in (Extended(), Unscented()):
        bank, other = LeaveOneOutBank(plant, estimator), LeaveOneOutBank(litres, estimator)
        _, a = run(bank, bank.init((20,)), t, y, u)
        _, b = run(other, other.init((20,)), t, y * np.array([1e3, 1, 3.6e6, 1]), u)
        np.testing.assert_array_equal(a.isolated, b.isolated)
        np.testing.assert_array_equal(a.alarm, b.alarm)
        # sigma points at alpha = 1e-3 magnify the rounding of values of 100 sigma by 1e6
        np.testing.assert_allclose(a.scores, b.scores, rtol=0, atol=1e-5)


def test_a_change_of_step_and_several_sampling_rates() -> None:
    plant = tanks()
    t, x, y, u = readings(plant, 120, 30, seed=8)
    slow = y.copy()
    slow[np.arange(120) % 4 != 3, :, 1] = np.nan  # one sensor at a quarter of the rate
    bank = LeaveOneOutBank(plant)
    _, decisions = run(bank, bank.init((30,)), t, slow, u)
    assert decisions.isolated.mean() < 0.01
    every_other = slice(1, None, 2)  # twice the step from here on
    _, decisions = run(bank, bank.init((30,)), t[every_other], y[every_other], u[every_other])
    error = (decisions.estimate - x[every_other])[20:]
    assert np.sqrt(np.mean(error**2)) < 0.01  # below the noise of a single level reading
    with pytest.raises(ValueError, match="times must be finite and increase"):
        run(bank, bank.init((30,), t=10.0), t, y, u)


def test_divergence_is_flagged_and_the_other_runs_of_the_batch_continue() -> None:
    def steep(t: float, x: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        return np.where(np.abs(x) > 20, 1e200, 0.9)[..., None] * np.eye(4)  # beyond 20 the covariance overflows

    plant = changed(chain(4), step_jacobian=steep)
    bank = LeaveOneOutBank(plant, max_faults=1)
    t, _, y, u = readings(chain(4), 30, 3, seed=9)
    y = y.copy()
    y[10:13, 1] = 300.0  # not so far that the readings are not taken
    _, decisions = run(bank, bank.init((3,)), t, y, u)
    assert decisions.diverged[12:, 1].all() and not decisions.diverged[:, [0, 2]].any()
    assert np.isnan(decisions.estimate[12:, 1]).all() and not decisions.isolated[12:, 1].any()
    alone = run(bank, bank.init((1,)), t, y[:, :1], u[:, :1])[1]
    np.testing.assert_allclose(decisions.estimate[:, 0], alone.estimate[:, 0], rtol=1e-12)


def test_bad_settings_and_readings_are_rejected() -> None:
    plant = chain(4)
    with pytest.raises(ValueError, match="strictly between 0 and 1"):
        LeaveOneOutBank(plant, false_alarm=0.0)
    with pytest.raises(ValueError, match="no consistent mean"):
        LeaveOneOutBank(plant, Ensemble())
    with pytest.raises(ValueError, match="no consistent mean"):
        LeaveOneOutBank(plant, Unscented(redraw=False))
    with pytest.raises(ValueError, match="whole number of at least 1"):
        LeaveOneOutBank(plant, window=0)
    bank = LeaveOneOutBank(plant)
    with pytest.raises(ValueError, match="pass NaN for a missing one"):
        bank.step(bank.init(), 1.0, np.zeros(3), np.zeros(0))
    with pytest.raises(ValueError, match="infinite"):
        bank.step(bank.init(), 1.0, np.array([0, 0, np.inf, 0]), np.zeros(0))
