"""From a log to events."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from toy_plants import chain, changed, readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import Chebyshev
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.diagnose import DiagnosisWarning, diagnose_run
from fusion_sfdia.diagnosis.fault_effects import apply_faults
from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.filters.estimators import Extended
from fusion_sfdia.learning.builders import fit
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.plant.log import Log


@pytest.mark.parametrize("window", [1, 15], ids=["chi2", "glr"])
def test_two_faults_and_missing_data_on_the_pipeline(window: int) -> None:
    plant = gas_pipeline()
    recording = simulate(plant, 110, [7])
    y = recording.y[:, 0].copy()
    p, m = plant.sensor_index("p_7"), plant.sensor_index("m_12")
    y[40:70, p] += 10_000.0  # Pa, 20 sigma
    y[90:, m] -= 50.0  # kg/s, 20 sigma, to the end
    y[30:34] = np.nan  # nothing at all
    y[50:53, p] = np.nan  # the faulty sensor is silent
    y[np.random.default_rng(0).random(y.shape) < 0.02] = np.nan  # here and there
    y[[40, 69, 70, 71], p] = recording.y[[40, 69, 70, 71], 0, p] + [
        1e4,
        1e4,
        0.0,
        0.0,
    ]  # but not where the fault begins and ends
    y[90, m] = recording.y[90, 0, m] - 50.0
    found = diagnose(LeaveOneOutBank(plant, window=window), recording.t, y, recording.u)
    assert [e.hypothesis for e in found.events] == ["p_7", "m_12"]
    first, second = found.events
    dt = plant.dt
    assert first.start == recording.t[40] and second.start == recording.t[90]
    # readmission asks for two samples within the threshold, and no more with evidence of 20 sigma
    assert recording.t[69] <= first.end <= recording.t[69] + 3 * dt
    assert second.end == recording.t[-1] and second.open and not first.open
    # each size is the reading less its estimate from the others: one sigma, less by the median over the event
    assert first.size == pytest.approx(10_000.0, abs=2 * 500.0) and first.unit == "Pa"
    assert second.size == pytest.approx(-50.0, abs=2 * 2.5) and second.unit == "kg/s"
    assert found.decisions.estimate.shape == (110, 63) and found.t is not None
    np.testing.assert_array_equal(found.t, recording.t)


def test_a_healthy_log_has_no_events() -> None:
    plant = tanks()
    recording = simulate(plant, 100, [3])
    found = diagnose(LeaveOneOutBank(plant, false_alarm=1e-6), recording.t, recording.y[:, 0], recording.u)
    assert found.events == () and not found.decisions.alarm.any()


def test_the_decisions_are_those_of_a_run() -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 20, 1, seed=0)
    detector = CentralFilter(plant)
    found = diagnose(detector, t, y[:, 0], u[:, 0])
    _, expected = run(detector, detector.init(), t, y[:, 0], u[:, 0])
    np.testing.assert_array_equal(found.decisions.estimate, expected.estimate)


def test_a_log_may_start_at_any_time_and_step_unevenly_or_be_one_sample() -> None:
    plant = tanks()
    recording = simulate(plant, np.array([1002.0, 1004.0, 1012.0, 1013.0]), [0], t0=1000.0)
    found = diagnose(CentralFilter(plant), recording.t, recording.y[:, 0], recording.u)
    assert np.all(np.isfinite(found.decisions.estimate))
    shifted = diagnose(CentralFilter(plant), recording.t - 1000.0, recording.y[:, 0], recording.u)
    np.testing.assert_allclose(found.decisions.estimate, shifted.decisions.estimate, rtol=1e-9)
    one = diagnose(CentralFilter(plant), recording.t[:1], recording.y[:1, 0], recording.u[:1])
    assert one.decisions.estimate.shape == (1, 2)


def test_events_of_one_sensor_close_together_are_one() -> None:
    plant = chain(3)
    detector = CentralFilter(replace(plant, process_cov=np.full(3, 1e-12), initial_cov=np.full(3, 1e-12)))
    y = 1e-9 * np.random.default_rng(0).standard_normal((20, 3))  # equal readings would be frozen
    y[[5, 7, 14], 1] = [10.0, 20.0, -30.0]  # hardly moves an estimate that is known to 1e-6
    t, u = np.arange(1.0, 21.0), np.zeros((20, 0))
    apart = diagnose(detector, t, y, u, gap=1).events
    assert [(e.start, e.end) for e in apart] == [(6.0, 6.0), (8.0, 8.0), (15.0, 15.0)]
    np.testing.assert_allclose([e.size for e in apart], [10.0, 20.0, -30.0], atol=1e-6)
    joined = diagnose(detector, t, y, u).events
    assert [(e.start, e.end) for e in joined] == [(6.0, 8.0), (15.0, 15.0)]
    assert joined[0].size == pytest.approx(15.0, abs=1e-6)  # the median of what is known


def test_shapes_and_times_that_do_not_fit_are_refused() -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 6, 2, seed=0)
    detector, y, u, batch = CentralFilter(plant), y[:, 0], u[:, 0], y
    for args in (
        (t[:5], y, u),
        (t, y[:5], u),
        (t, y, u[:5]),
        (t[:, None], y, u),
        (t, y[:, 0], u),
        (t, y, u[:, 0]),
    ):
        with pytest.raises(ValueError, match=r"do not fit; expected \(K,\), \(K, ..., sensors\), \(K, ..., inputs\)"):
            diagnose(detector, *args)
    with pytest.raises(ValueError, match=r"2 runs side by side, where one is expected; pass one of them, Log\(t, y\[:, i\]"):
        diagnose(detector, t, batch, u)
    with pytest.raises(ValueError, match="t is empty"):
        diagnose(detector, t[:0], y[:0], u[:0])
    with pytest.raises(ValueError, match="4 sensors; pass NaN"):
        diagnose(detector, t, y[:, :3], u)
    with pytest.raises(ValueError, match="1 inputs"):
        diagnose(detector, t, y, np.repeat(u, 2, axis=1))
    with pytest.raises(ValueError, match=r"reading 3, 16 s, is 6 s after the one before: .* holds for 5.0 s only"):
        diagnose(replace(detector, plant=changed(plant, fixed_dt=True)), np.array([5.0, 10, 16, 20, 25, 30]), y, u)
    for times in (t[::-1], np.array([5.0, 10, 10, 15, 20, 25]), np.array([5.0, 10, np.nan, 20, 25, 30])):
        with pytest.raises(ValueError, match="times must be finite and increase"):
            diagnose(detector, times, y, u)


@pytest.mark.parametrize("limits", [{"max_dt": 6.0}, {"fixed_dt": True}], ids=str)
def test_a_long_gap_is_stepped_through_without_readings(limits: dict) -> None:
    """A log without the rows of an outage is the log with empty rows there."""
    plant = changed(tanks(), **limits)
    t, _, y, u = readings(plant, 12, 1, seed=0)
    y, u = y[:, 0].copy(), u[:, 0].copy()
    y[4:9] = np.nan
    u[3:10, 0] = np.linspace(6e-4, 7e-4, 7)  # m3/s: what is taken between 3 and 9, where nothing is known
    detector, kept = CentralFilter(plant), [0, 1, 2, 3, 9, 10, 11]
    whole, cut = diagnose(detector, t, y, u), diagnose(detector, t[kept], y[kept], u[kept])
    # times and inputs in the gap are equal to rounding
    np.testing.assert_allclose(cut.decisions.estimate, whole.decisions.estimate[kept], rtol=1e-12)
    np.testing.assert_array_equal(cut.t, t[kept])
    milliseconds = 1000 * np.arange(1.0, 21.0) * plant.dt
    with pytest.raises(ValueError, match=r"20 readings take 19001 steps of 5 s, .* up to 5000 s apart; give times in seconds"):
        diagnose(detector, milliseconds, np.ones((20, 4)), np.ones((20, 1)))


@pytest.mark.parametrize("name", ["pca", "one-class"])
def test_a_detector_whose_model_is_no_plant_diagnoses_a_log(name: str) -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 60, 1, seed=0)
    biased = y[:, 0] + np.array([0.0, 20.0, 0.0, 0.0]) * plant.sensor_sigma * (t > 150)[:, None]
    times, _, healthy, inputs = readings(plant, 200, 2, seed=1)
    found = diagnose(fit(name, plant, (times, healthy, inputs), 0.02), t, biased, u[:, 0])
    assert "l2" in {e.hypothesis for e in found.events} and found.health is not None


def test_a_plant_of_which_fewer_than_half_of_the_sensors_can_be_isolated_says_so() -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 30, 1, seed=0)
    for detector, limit in (
        (LeaveOneOutBank(plant), []),
        (LeaveOneOutBank(plant, max_faults=1), ["at most 1 of 4 sensors can be isolated at once: as max_faults states"]),
        (CentralFilter(plant), ["at most 1 of 4 sensors can be isolated at once: the method of CentralFilter names no more"]),
    ):
        assert diagnose(detector, t, y[:, 0], u[:, 0]).remarks == limit


def test_limits_of_a_diagnosis_are_warned_of() -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 30, 1, seed=0)
    y, u = y[:, 0], u[:, 0]
    with pytest.warns(DiagnosisWarning, match="FusingBank cannot raise an alarm .* or set thresholds"):
        diagnose(FusingBank(plant, Extended(), thresholds=(np.inf,) * 4), t, y, u)
    detector, silent, nothing = CentralFilter(plant), y.copy(), np.full_like(y, np.nan)
    silent[:, 1] = np.nan
    with pytest.warns(DiagnosisWarning, match="no readings of l2; fill"):
        diagnose(detector, t, silent, u)
    with pytest.warns(DiagnosisWarning, match="no readings of l1, l2, q12, q2: .* only the model's prediction"):
        diagnose(detector, t, nothing, u)
    flooded = y.copy()
    flooded[10:12, 0] = 100.0  # m: pulls the estimate above the 3 m of the tank
    with pytest.warns(
        DiagnosisWarning, match=r"left the limits of the model and was moved back in \d+ of 30 samples, first at \d+ s"
    ):
        diagnose(detector, t, flooded, u)
    drained = u.copy()
    drained[10:20] = -0.05  # m3/s: the tanks would be empty within a step, which has no number then
    drained.flags.writeable = False  # what is replaced is so in a copy
    with pytest.warns(DiagnosisWarning) as warned:
        found = diagnose(detector, t, y, drained)
    assert [str(w.message) for w in warned] == [
        "inflow: 10 of 30 values are impossible, the first -0.05 m3/s at 55 s; replaced by the plant's usual input: leave such "
        "cells empty, or check units"
    ]
    assert not found.decisions.diverged.any() and not found.events
    impossible = y.copy()
    impossible[[4, 7], 2] = [1e303, -1e30]
    impossible.flags.writeable = False
    with pytest.warns(DiagnosisWarning) as warned:
        found = diagnose(detector, t, impossible, u)
    assert [str(w.message) for w in warned] == [
        "q12: 2 of 30 values are impossible, the first 1e+303 m3/s at 25 s; taken as missing: leave such cells empty, or check "
        "units"
    ]
    assert np.argwhere(found.decisions.absurd).tolist() == [[4, 2], [7, 2]] and not found.events
    biased = y + np.array([20.0, -20.0, 20.0, 0.0]) * plant.sensor_sigma * (t > 50)[:, None]
    with pytest.warns(
        DiagnosisWarning,
        match=r"more sensors would be isolated in 20 of 30 samples, first at 55 s, but 2 of 4 are excluded already, all "
        r"that the detector allows \(half of the 4 sensors\): check the model, or pass max_faults",
    ):
        found = diagnose(LeaveOneOutBank(plant, window=1), t, biased, u)
    assert found.decisions.isolated[10:].sum(axis=-1).max() == 2
    start = Clock(datetime(2026, 3, 1, 23, 59, tzinfo=UTC))
    with pytest.warns(DiagnosisWarning, match=r"in 20 of 30 samples, first at 2026-03-01 23:59:55\+00:00, but"):
        diagnose_run(LeaveOneOutBank(plant, window=1), Log(t, biased, u), clock=start)
    broken = replace(plant, output=lambda t, x, u: plant.output(t, x, u) * (np.nan if t > 50 else 1))
    with pytest.warns(DiagnosisWarning, match="diverged and is not valid in 20 of 30 samples, first at 55 s"):
        found = diagnose(CentralFilter(broken), t, y, u)
    assert found.decisions.diverged.sum() == 20 and not found.decisions.isolated[10:].any()


def test_a_frozen_reading_is_isolated_once_the_signal_has_moved() -> None:
    """Within the hour pressures move by more than a hundred sigma and temperatures by half of one (see FAULT_KINDS)."""
    plant = gas_pipeline()
    recording = simulate(plant, 120, [0])
    moved = np.ptp(recording.signal[:, 0], axis=0) / plant.sensor_sigma
    frozen = [Fault(name, "freeze", onset=400.0) for name in ("p_7", "T_7")]
    readings = apply_faults(plant, recording.t, recording.y, frozen)
    found = diagnose(LeaveOneOutBank(plant), recording.t, readings.y[:, 0], recording.u)
    assert moved[plant.sensor_index("p_7")] > 50 and moved[plant.sensor_index("T_7")] < 1
    isolated = np.flatnonzero(found.decisions.isolated.any(axis=0))
    assert [plant.sensor_names[i] for i in isolated] == ["p_7"]
    # from their equal readings both are events, since the one before the onset
    assert [(e.hypothesis, e.fault, e.start) for e in found.events] == [("T_7", "freeze", 390.0), ("p_7", "freeze", 390.0)]
    assert all(np.isnan(e.confidence) and e.alternatives == () for e in found.events)  # no test of size found them


def test_the_tanks_step_through_a_gap_of_minutes() -> None:
    """Without the 60 rows of an outage as with empty ones: no sample is lost, and what is not known grows and is bounded.

    In one step of 300 s the variance would grow by the noise of 60 steps, of which the tank forgets most.
    """
    plant = tanks()
    recording = simulate(plant, 220, [1], truth="model", process_noise=True)
    kept = np.r_[0:59, 119:220]  # 300 s apart
    y, u = recording.y[:, 0].copy(), recording.u_of_runs[:, 0]
    for detector in (CentralFilter(plant), LeaveOneOutBank(plant), Chebyshev(plant, lam=0.0, alpha=5.0)):
        cut = diagnose(detector, recording.t[kept], y[kept], u[kept])
        y[59:119] = np.nan
        whole = diagnose(detector, recording.t, y, u)
        assert not cut.decisions.diverged.any() and not cut.decisions.guarded.any()
        np.testing.assert_allclose(cut.decisions.estimate, whole.decisions.estimate[kept], rtol=1e-12)
    state = CentralFilter(plant).init((), 0.0)
    blind = changed(plant, max_dt=np.inf)
    steps = np.arange(1, 61) * plant.dt
    _, known = run(CentralFilter(plant), state, steps, np.full((60, 4), np.nan), u[:60], covariance=True)
    _, leap = run(CentralFilter(blind), state, steps[-1:], np.full((1, 4), np.nan), u[:1], covariance=True)
    assert known.covariance is not None and leap.covariance is not None
    variance = np.diagonal(known.covariance, axis1=-2, axis2=-1)
    # of level 1, x' = -r x + w: Q (1 - exp(-2 r t)) / (1 - exp(-2 r dt)) + P0 exp(-2 r t)
    r, q, p = 6e-4 / 0.1, float(plant.process_cov[0]), float(plant.initial_cov[0])
    expected = q * (1 - np.exp(-2 * r * steps)) / (1 - np.exp(-2 * r * plant.dt)) + p * np.exp(-2 * r * steps)
    np.testing.assert_allclose(variance[:, 0], expected, rtol=1e-4)  # nonlinear by what the level moves
    assert leap.covariance[-1, 0, 0] > 2 * variance[-1, 0]
