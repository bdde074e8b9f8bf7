"""Decisions and the loop over readings."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits
from toy_plants import chain, readings, tanks

from fusion_sfdia import diagnose
from fusion_sfdia.common.errors import MissingPackageError, NotApplicableError
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Decision, check_reading, run, stack
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant


def decision(residual: list[float], threshold: list[float], isolated: list[bool]) -> Decision:
    count = len(residual)
    return Decision(
        estimate=np.zeros(2),
        reconstruction=np.zeros(count),
        residual=np.array(residual),
        threshold=np.array(threshold),
        isolated=np.array(isolated),
        fault_size=np.where(isolated, 1.0, np.nan),
        diverged=np.array(False),
        guarded=np.array(False),
        nis=np.array(1.0),
    )


def test_scores_are_ratios_and_zero_where_nothing_was_judged() -> None:
    d = decision([-3.0, 1.0, np.nan, 5.0], [2.0, 2.0, 2.0, np.inf], [False] * 4)
    np.testing.assert_array_equal(d.scores, [1.5, 0.5, 0.0, 0.0])
    assert d.score == 1.5 and d.alarm


def test_an_alarm_is_a_residual_above_its_threshold_or_a_hypothesis_held() -> None:
    assert not decision([2.0, -2.0], [2.0, 2.0], [False, False]).alarm  # at the threshold, not above
    assert decision([2.0, -2.1], [2.0, 2.0], [False, False]).alarm
    assert decision([np.nan, np.nan], [2.0, 2.0], [True, False]).alarm
    assert not decision([np.nan, np.nan], [2.0, 2.0], [False, False]).alarm


def test_stacking_puts_time_first_and_keeps_covariances_on_request_only() -> None:
    one = decision([1.0, 2.0], [2.0, 2.0], [False, True])
    with_cov = replace(one, covariance=np.eye(2))
    many = stack([with_cov] * 3)
    assert many.residual.shape == (3, 2) and many.diverged.shape == (3,) and many.covariance is None
    kept = stack([with_cov] * 3, covariance=True)
    assert kept.covariance is not None and kept.covariance.shape == (3, 2, 2)
    assert stack([one] * 3, covariance=True).covariance is None
    np.testing.assert_array_equal(many.alarm, [True] * 3)


def test_a_run_may_be_cut_anywhere() -> None:
    plant = tanks()
    detector = CentralFilter(plant)
    t, _, y, u = readings(plant, 12, 2, seed=0)
    _, whole = run(detector, detector.init((2,)), t, y, u)
    middle, first = run(detector, detector.init((2,)), t[:5], y[:5], u[:5])
    _, second = run(detector, middle, t[5:], y[5:], u[5:])
    for f in fields(Decision):
        if getattr(whole, f.name) is not None:
            joined = np.concatenate([getattr(first, f.name), getattr(second, f.name)])
            np.testing.assert_array_equal(joined, getattr(whole, f.name))


def test_a_run_and_a_diagnosis_use_one_thread_of_linear_algebra(monkeypatch: pytest.MonkeyPatch) -> None:
    plant, seen = chain(3), set[int]()
    detector, (t, _, y, u) = LeaveOneOutBank(plant), readings(plant, 6, 1, seed=0)
    step = LeaveOneOutBank.step

    def watched(*arguments: Any) -> Any:
        seen.update(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")
        return step(*arguments)

    monkeypatch.setattr(LeaveOneOutBank, "step", watched)
    with threadpool_limits(2):
        run(detector, detector.init(()), t, y[:, 0], u[:, 0])
        diagnose(detector, t, y[:, 0], u[:, 0])
    assert seen == {1}


def test_a_run_of_nothing_or_of_unlike_lengths_is_refused() -> None:
    plant = chain(3)
    detector = CentralFilter(plant)
    t, _, y, u = readings(plant, 4, 1, seed=0)
    with pytest.raises(ValueError, match="t is empty"):
        run(detector, detector.init(), t[:0], y[:0, 0], u[:0, 0])
    with pytest.raises(ValueError):
        run(detector, detector.init(), t, y[:3, 0], u[:, 0])


def test_irregular_times_are_steps_of_their_own_length() -> None:
    plant = replace(tanks(), initial_cov=np.full(2, 1e-12))  # so that P is the process noise since the start
    detector = CentralFilter(plant)
    y, u = plant.output(0.0, plant.x0, plant.input_at(0.0)), plant.input_at(0.0)
    short, _ = detector.step(detector.init(), 5.0, y, u)
    long, _ = detector.step(detector.init(), 10.0, y, u)
    later, _ = detector.step(detector.init((), 5.0), 10.0, y, u)
    np.testing.assert_array_equal(short.memory.P, later.memory.P)  # the tanks do not know the hour
    assert np.all(np.diagonal(long.memory.P) > np.diagonal(short.memory.P))  # more process noise


@pytest.mark.parametrize(
    ("y", "u", "batch", "message"),
    [
        (np.zeros(3), np.zeros(1), (), r"y has shape \(3,\); expected \(4,\): plant 'two-tanks' has 4 sensors; pass NaN"),
        (np.zeros((2, 4)), np.zeros(1), (), r"y has shape \(2, 4\); expected \(4,\)"),
        (np.zeros(4), np.zeros(1), (2,), r"y has shape \(4,\); expected \(2, 4\)"),
        (np.zeros(4), np.zeros(2), (), r"u has shape \(2,\); plant 'two-tanks' has 1 inputs \(inflow\)"),
        (np.zeros(4), np.zeros(()), (), r"u has shape \(\); plant 'two-tanks' has 1 inputs"),
        (np.zeros((2, 4)), np.zeros((3, 1)), (2,), r"u has shape \(3, 1\); it does not broadcast to \(2, 1\)"),
        (np.zeros(4), np.zeros((2, 1)), (), r"u has shape \(2, 1\); it does not broadcast to \(1,\)"),
        (np.zeros((2, 4)), np.zeros((1, 2, 1)), (2,), "does not broadcast"),
        (np.array([0, 0, np.inf, 0]), np.zeros(1), (), "y has infinite readings; pass NaN"),
        (np.zeros(4), np.array([np.nan]), (), "u has values that are not finite; an input must be known"),
        (np.zeros(4), np.array([np.inf]), (), "u has values that are not finite"),
    ],
)
def test_readings_that_do_not_fit_are_refused(y: np.ndarray, u: np.ndarray, batch: tuple[int, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_reading(tanks(), y, u, batch)


@pytest.mark.parametrize("u_shape", [(1,), (1, 1), (2, 1), (3, 2, 1), (3, 1, 1)])
def test_inputs_that_broadcast_fit(u_shape: tuple[int, ...]) -> None:
    check_reading(tanks(), np.full((3, 2, 4), np.nan), np.zeros(u_shape), (3, 2))


@pytest.mark.parametrize(
    ("name", "plant", "message"),
    [
        ("adaptive-threshold:paper", chain(3), "scalar equations"),
        ("virtual-sensors", chain(3), "scalar equations"),
        ("structural-residuals", chain(3), "scalar equations"),
        ("fusing-ekf", chain(1), "at least 2"),
        ("pca", chain(1), "at least 2"),
    ],
)
def test_a_plant_that_lacks_what_a_method_needs_raises_its_own_error(name: str, plant: Plant, message: str) -> None:
    with pytest.raises(NotApplicableError, match=message):
        registry.detector(name, plant)
    assert issubclass(NotApplicableError, ValueError)
    assert issubclass(MissingPackageError, NotApplicableError)
    assert issubclass(MissingPackageError, ModuleNotFoundError)


def test_a_wrong_setting_is_no_matter_of_the_plant() -> None:
    with pytest.raises(ValueError, match="threshold_scale") as raised:
        LeaveOneOutBank(chain(3), threshold_scale=-1.0)
    assert not isinstance(raised.value, NotApplicableError)


def test_a_fitted_detector_states_the_rate_of_its_thresholds() -> None:
    plant = chain(3)
    log = readings(plant, 300, 2, seed=0)
    detector = LeaveOneOutBank(plant)
    fitted = detector.fit_thresholds(Log(log[0], log[2], log[3]), false_alarm=0.02)
    assert (detector.fitted_rate, fitted.fitted_rate, fitted.false_alarm) == (None, 0.02, 1e-3)
    with pytest.raises(ValueError, match="fitted_rate is 2"):
        replace(detector, fitted_rate=2.0)
