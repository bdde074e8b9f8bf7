"""Likelihood ratios over a window of onsets, against their definition: a separate filter run for each sensor and onset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from scipy.stats import norm
from toy_plants import chain, readings

from fusion_sfdia.core.detector import run
from fusion_sfdia.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.kalman_banks.likelihood_window import LEAST_INFORMATION, OnsetStatistics, best_onset

Array = NDArray[Any]

PLANT = chain(3, sensors=5)
N, STEPS, WINDOW, FALSE_ALARM = 5, 24, 6, 0.02
F = PLANT.step_jacobian_at(0.0, PLANT.x0, np.zeros(0), 1.0)
H = PLANT.output_jacobian_at(0.0, PLANT.x0, np.zeros(0))
P0 = np.diag(PLANT.initial_cov)
Q, R = np.diag(PLANT.process_cov), np.diag(PLANT.sensor_cov)


@dataclass
class Step:
    """A filter before its readings at one time: x, P, the readings it has, d of these and their S."""

    x: Array
    P: Array
    used: Array
    d: Array
    S: Array


def filtered(y: Array, x: Array, P: Array) -> list[Step]:
    """The textbook filter from x, P on the readings y (K, N) of one run, rows of missing ones deleted."""
    steps = []
    for reading in y:
        x, P = F @ x, F @ P @ F.T + Q
        used = np.isfinite(reading)
        h = H[used]
        S, d = h @ P @ h.T + R[np.ix_(used, used)], reading[used] - h @ x
        steps.append(Step(x, P, used, d, S))
        K = P @ h.T @ np.linalg.inv(S)
        x, P = x + K @ d, (np.eye(3) - K @ h) @ P
    return steps


@dataclass
class Literal:
    """By step k and onset j <= k (K, K, N): a, b; change of the predicted state by a unit bias (K, K, N, n)."""

    steps: list[Step]
    a: Array
    b: Array
    moved: Array


def literal(y: Array, x: Array = PLANT.x0, P: Array = P0) -> Literal:
    """A unit bias alone through the same filter, with the same gaps: its effect, since the filter is linear."""
    steps, count = filtered(y, x, P), len(y)
    a, b, moved = np.zeros((count, count, N)), np.zeros((count, count, N)), np.zeros((count, count, N, 3))
    for i in range(N):
        for onset in range(count):
            bias = np.where(np.isfinite(y), 0.0, np.nan)
            bias[onset:, i] += 1.0
            total_a = total_b = 0.0
            for k, (healthy, alone) in enumerate(zip(steps, filtered(bias, np.zeros(3), P), strict=True)):
                total_a += alone.d @ np.linalg.solve(healthy.S, healthy.d)
                total_b += alone.d @ np.linalg.solve(healthy.S, alone.d)
                a[k, onset, i], b[k, onset, i], moved[k, onset, i] = total_a, total_b, alone.x
    return Literal(steps, a, b, moved)


def limits(scale: float = 1.0) -> tuple[float, float]:
    """Two-sided normal quantiles: half the budget for the present sample, half for the onsets before it, in equal shares."""
    one = norm.isf(FALSE_ALARM / 2 / N / 2)
    return float((scale * one) ** 2), float((scale * norm.isf(FALSE_ALARM / 2 / N / (WINDOW - 1) / 2)) ** 2)


def best(of: Literal, k: int, i: int) -> tuple[float, float, float, int]:
    """Largest a^2 / b over the onsets that the window holds, with a / b, b and the onset; 0 without information."""
    found = (0.0, 0.0, 1.0, -1)
    for onset in range(max(0, k - WINDOW + 1), max(k, 1)):  # the first step has only itself
        a, b = of.a[k, onset, i], of.b[k, onset, i]
        if b * R[i, i] > LEAST_INFORMATION and a * a / b > found[0]:
            found = (a * a / b, a / b, b, onset)
    return found


def shown(of: Literal, k: int, i: int) -> tuple[float, float, bool]:
    """Residual and threshold of sensor i: those of the window or of the sample, by the larger statistic over its limit."""
    one_limit, window_limit = limits()
    statistic, size, b, _ = best(of, k, i)
    now, weight = of.a[k, k, i], of.b[k, k, i]  # onset at this sample
    if statistic / window_limit > now**2 / weight / one_limit:
        return size, float(np.sqrt(window_limit / b)), True
    return float(now / weight), float(np.sqrt(one_limit / weight)), False


def near(y: Array) -> float:
    """Rounding of numbers of order y that a stable filter of a well-conditioned S carries over all steps."""
    S = H @ P0 @ H.T + R
    return rounding(np.nanmax(np.abs(y)) * np.linalg.cond(S), STEPS * 2 * (N + 3))


def data(runs: int, missing: float, size: float) -> tuple[Array, Array, Array]:
    """t, y, u of healthy and faulty runs with gaps; one step has no readings."""
    t, _, y, u = readings(PLANT, STEPS, runs, seed=11)
    y = y.copy()
    for r in range(runs):
        y[8:, r, r % N] += size
    y[np.random.default_rng(12).random(y.shape) < missing] = np.nan
    if missing:
        y[5] = np.nan
    return t, y, u


@pytest.mark.parametrize("missing", [0.0, 0.25])
def test_residuals_and_thresholds_are_those_of_the_definition(missing: float) -> None:
    runs = 4
    t, y, u = data(runs, missing, 5.0)
    bank = LeaveOneOutBank(PLANT, window=WINDOW, false_alarm=FALSE_ALARM, accommodate=False)
    _, found = run(bank, bank.init((runs,)), t, y, u)
    by_window = by_sample = 0
    for r in range(runs):
        of = literal(y[:, r])
        for k in range(STEPS):
            for i in range(N):
                if np.isnan(y[k, r, i]):
                    assert np.isnan(found.residual[k, r, i])
                    continue
                residual, threshold, window = shown(of, k, i)
                # with little information both are large: the rounding is that of a, of the size of 1 / R
                allowed = near(y) * max(1.0, threshold**2)
                assert found.residual[k, r, i] == pytest.approx(residual, rel=0, abs=allowed), (k, r, i)
                assert found.threshold[k, r, i] == pytest.approx(threshold, rel=0, abs=allowed), (k, r, i)
                by_window, by_sample = by_window + window, by_sample + (not window)
    assert by_window > 50 and by_sample > 50
    assert found.alarm.any() and not found.alarm.all()


@pytest.mark.parametrize("missing", [0.0, 0.25])
def test_an_alarm_of_the_window_removes_the_effect_of_the_fault_from_the_estimate(missing: float) -> None:
    """x - eta f, P + eta eta' / b with the best f = a / b and its variance 1 / b, then the readings of all other sensors."""
    runs = 16
    t, y, u = data(runs, missing, 2.0)  # weak: it has an effect on the estimate before it is detected
    bank = LeaveOneOutBank(PLANT, window=WINDOW, false_alarm=FALSE_ALARM)
    _, found = run(bank, bank.init((runs,)), t, y, u, covariance=True)
    assert found.covariance is not None
    _, window_limit = limits()
    checked = 0
    for r in range(runs):
        if not found.isolated[:, r].any():
            continue
        k = int(np.argmax(found.isolated[:, r].any(axis=-1)))
        of = literal(y[: k + 1, r])
        statistics = [best(of, k, i) if np.isfinite(y[k, r, i]) else (0.0, 0.0, 1.0, -1) for i in range(N)]
        i = int(np.argmax([s[0] for s in statistics]))
        one_sample = of.a[k, k] ** 2 / np.where(of.b[k, k] > 0, of.b[k, k], 1.0)
        if statistics[i][0] <= window_limit or np.any(one_sample > limits()[0]) or found.isolated[k, r].sum() > 1:
            continue  # an alarm of the single sample, or a second alarm
        assert found.isolated[k, r, i]
        _, size, b, onset = statistics[i]
        moved, step = of.moved[k, onset, i], of.steps[k]
        x, P = step.x - moved * size, step.P + np.outer(moved, moved) / b
        others = step.used & (np.arange(N) != i)
        h, r_others = H[others], R[np.ix_(others, others)]
        K = P @ h.T @ np.linalg.inv(h @ P @ h.T + r_others)
        allowed = near(y) * max(1.0, 1 / b)
        np.testing.assert_allclose(found.estimate[k, r], x + K @ (y[k, r, others] - h @ x), rtol=0, atol=allowed)
        np.testing.assert_allclose(found.covariance[k, r], P - K @ h @ P, rtol=0, atol=allowed)
        checked += bool(np.abs(moved).max() > 0.05)
    assert checked >= 4


def test_after_an_alarm_the_window_starts_again() -> None:
    """The filter continues without the sensor and drops earlier onsets: later ones are as in a run that starts there."""
    runs = 16
    t, y, u = data(runs, 0.1, 6.0)
    bank = LeaveOneOutBank(PLANT, window=WINDOW, false_alarm=FALSE_ALARM)
    _, found = run(bank, bank.init((runs,)), t, y, u, covariance=True)
    assert found.covariance is not None
    by_window = 0
    for r in range(runs):
        alarms = np.flatnonzero(found.isolated[:, r].any(axis=-1))
        if not alarms.size:
            continue
        first = alarms[0]
        changes = np.flatnonzero((found.isolated[first:, r] != found.isolated[first, r]).any(axis=-1))
        end = first + changes[0] if changes.size else STEPS
        trusted = np.where(found.isolated[first, r], np.nan, y[first + 1 : end, r])
        if not len(trusted):
            continue
        of = literal(trusted, found.estimate[first, r], found.covariance[first, r])
        for k in range(len(trusted)):
            for i in np.flatnonzero(np.isfinite(trusted[k])):
                residual, threshold, window = shown(of, k, i)
                allowed = near(y) * max(1.0, threshold**2)
                assert found.residual[first + 1 + k, r, i] == pytest.approx(residual, rel=0, abs=allowed), (k, r, i)
                assert found.threshold[first + 1 + k, r, i] == pytest.approx(threshold, rel=0, abs=allowed), (k, r, i)
                by_window += window
    assert by_window > 50


def test_the_best_onset_is_that_with_the_largest_ratio_of_those_with_information() -> None:
    """By onset and sensor a, b: a^2 / b is 4, 9 for sensor 1; too little information for sensor 2; sensor 3 is not in use."""
    a = np.array([[2.0, 1.0, 5.0], [3.0, 1.0, 5.0]])
    b = np.array([[1.0, 0.0009, 1.0], [1.0, 0.0011, 1.0]])
    onsets = OnsetStatistics(np.zeros((2, 1, 3)), a, b, np.zeros((3, 1)))
    found = best_onset(onsets, np.array([True, True, False]), np.ones(3))
    np.testing.assert_allclose(found.statistic, [9.0, 1 / 0.0011, 0.0], rtol=1e-12)
    np.testing.assert_allclose(found.size, [3.0, 1 / 0.0011, 0.0], rtol=1e-12)
    np.testing.assert_array_equal(found.information, [1.0, 0.0011, 1.0])
    np.testing.assert_array_equal(found.onset[:2], [1, 1])
    less_noise = best_onset(onsets, np.ones(3, bool), np.array([1.0, 0.5, 1.0]))  # information is in units of 1 / R
    assert less_noise.statistic[1] == 0.0 and less_noise.statistic[2] == 25.0
