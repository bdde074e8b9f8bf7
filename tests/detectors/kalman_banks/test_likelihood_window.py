"""Likelihood ratios over a window of onsets, against their definition: a separate filter run for each hypothesis and onset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from scipy.integrate import quad
from scipy.stats import norm
from toy_plants import chain, declared, readings

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks import window_step
from fusion_sfdia.detectors.kalman_banks.hypotheses import Hypotheses
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, posterior, statistics
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.likelihood_window import (
    LEAST_INFORMATION,
    Best,
    OnsetGrid,
    Weighed,
    Window,
    absorbed,
    best_onset,
    empty,
    residual_and_threshold,
    shifted,
    updated,
    weigh,
    with_readings,
)
from fusion_sfdia.detectors.kalman_banks.window_step import last_update, no_update
from fusion_sfdia.detectors.kalman_banks.window_step import window_step as step_in_common
from fusion_sfdia.filters.estimators import Extended, GaussianState
from fusion_sfdia.filters.gaussian import gain

Array = NDArray[Any]


@pytest.fixture(autouse=True)
def _double(monkeypatch: pytest.MonkeyPatch) -> None:
    """The window in double precision, so that its definition is checked to rounding."""
    monkeypatch.setattr(window_step, "NUMBERS", np.float64)


PLANT = chain(3, sensors=5)
N, STEPS, WINDOW, FALSE_ALARM = 5, 24, 6, 0.02
F = PLANT.step_jacobian_at(0.0, PLANT.x0, np.zeros(0), 1.0)
H = PLANT.output_jacobian_at(0.0, PLANT.x0, np.zeros(0))
P0 = np.diag(PLANT.initial_cov)
Q, R = np.diag(PLANT.process_cov), np.diag(PLANT.sensor_cov)


class Linear(NamedTuple):
    """A linear model: x+ = F x + w, y = H x + v, covariances of w, v and of the initial state."""

    F: Array
    H: Array
    Q: Array
    R: Array
    P0: Array


CHAIN = Linear(F, H, Q, R, P0)


@dataclass
class Step:
    """A filter before its readings at one time: x, P, the readings it has, d of these and their S."""

    x: Array
    P: Array
    used: Array
    d: Array
    S: Array


def filtered(y: Array, x: Array, P: Array, of: Linear = CHAIN) -> list[Step]:
    """The textbook filter from x, P on the readings y (K, N) of one run, rows of missing ones deleted."""
    steps = []
    for reading in y:
        x, P = of.F @ x, of.F @ P @ of.F.T + of.Q
        used = np.isfinite(reading)
        h = of.H[used]
        S, d = h @ P @ h.T + of.R[np.ix_(used, used)], reading[used] - h @ x
        steps.append(Step(x, P, used, d, S))
        K = P @ h.T @ np.linalg.inv(S)
        x, P = x + K @ d, (np.eye(len(x)) - K @ h) @ P
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


def test_what_is_shown_is_the_larger_ratio_to_its_limit_of_sample_and_window() -> None:
    """One sensor by the sample, one by the window, one that is not used."""
    found = LeaveOneOut(
        np.array([[2.0, 1.0, 0.0]]), np.array([[4.0, 4.0, 0.0]]), np.eye(3)[None], np.array([[True, True, False]]), None, None
    )
    statistic, size, information = np.array([[1.0, 9.0, 0.0]]), np.array([[5.0, 6.0, 0.0]]), np.array([[4.0, 0.25, 1.0]])
    residual, threshold = residual_and_threshold(found, statistic, size, information, (16.0, 25.0))
    np.testing.assert_array_equal(residual, [[2 / 4, 6.0, 0.0]])
    np.testing.assert_array_equal(threshold, [[np.sqrt(16 / 4), np.sqrt(25 / 0.25), np.inf]])
    two = [np.concatenate([a, a]) for a in (statistic, size, information)]
    arrays = found.whitened, found.weight, np.eye(3)[None], found.used
    runs = LeaveOneOut(*(np.concatenate([a, a]) for a in arrays), None, None)
    for one, together in zip((residual, threshold), residual_and_threshold(runs, *two, (16.0, 25.0)), strict=True):
        np.testing.assert_array_equal(together, np.concatenate([one, one]))


def test_the_best_onset_is_that_with_the_largest_ratio_of_those_with_information() -> None:
    """By onset and sensor a, b: a^2 / b is 4, 9 for sensor 1; too little information for sensor 2; sensor 3 is not in use."""
    a = np.array([[[2.0, 1.0, 5.0], [3.0, 1.0, 5.0]]])
    b = np.array([[[1.0, 0.0009, 1.0], [1.0, 0.0011, 1.0]]])
    onsets = Weighed(np.zeros((1, 2, 1, 3)), np.ones((1, 2)), a, b, np.ones((1, 2)), np.zeros((3, 1)))
    found, every = best_onset(onsets, np.array([[True, True, False]]), np.ones(3)), np.ones((1, 3), bool)
    np.testing.assert_allclose(found.statistic, [[9.0, 1 / 0.0011, 0.0]], rtol=1e-12)
    np.testing.assert_allclose(found.size, [[3.0, 1 / 0.0011, 0.0]], rtol=1e-12)
    np.testing.assert_array_equal(found.information, [[1.0, 0.0011, 1.0]])
    np.testing.assert_array_equal(found.slot[0, :2], [1, 1])
    less_noise = best_onset(onsets, every, np.array([1.0, 0.5, 1.0]))  # information is in units of 1 / size^2
    assert less_noise.statistic[0, 1] == 0.0 and less_noise.statistic[0, 2] == 25.0
    earlier = best_onset(onsets, every, np.ones(3), first=1)
    np.testing.assert_array_equal(earlier.slot, [[1, 1, 1]])
    eta = best_onset(onsets, every, np.array([[1.0, 1.0, 1.0], [1e-2, 1.0, 1.0]]))  # a size for each onset
    assert eta.statistic[0, 0] == 4.0 and eta.slot[0, 0] == 0


def test_the_evidence_is_twice_the_logarithm_of_the_likelihood_ratio_averaged_over_sizes() -> None:
    """int N(s; 0, size^2) exp(a s - b s^2 / 2) ds, by quadrature."""
    a, b, size = 3.0, 0.7, 2.5
    one = np.ones((1, 1))
    onsets = Weighed(np.zeros((1, 1, 1, 1)), one, np.full((1, 1, 1), a), np.full((1, 1, 1), b), one, np.zeros((1, 1)))
    found = best_onset(onsets, one > 0, np.array([size]))
    ratio, error = quad(lambda s: norm.pdf(s, 0.0, size) * np.exp(a * s - b * s * s / 2), -np.inf, np.inf)
    assert found.evidence[0, 0] == pytest.approx(2 * np.log(ratio), rel=0, abs=4 * error / ratio)
    assert best_onset(onsets, one < 0, np.ones(1)).evidence[0, 0] == -np.inf


def test_in_single_precision_the_bank_decides_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = 4
    t, y, u = data(runs, 0.1, 5.0)
    bank = LeaveOneOutBank(PLANT, window=WINDOW, false_alarm=FALSE_ALARM)
    _, double = run(bank, bank.init((runs,)), t, y, u)
    monkeypatch.setattr(window_step, "NUMBERS", np.float32)
    _, found = run(bank, bank.init((runs,)), t, y, u)
    assert bank.init((runs,)).memory.window.eta.dtype == np.float32 and found.isolated.any()
    np.testing.assert_array_equal(found.isolated, double.isolated)
    coarser = np.finfo(np.float32).eps / np.finfo(float).eps
    np.testing.assert_allclose(found.scores, double.scores, rtol=0, atol=near(y) * coarser)
    assert not np.array_equal(found.scores, double.scores)


# Hypotheses about the process and the far past, on a plant with declared uncertainty

DECLARED = Hypotheses(declared())
MODEL = DECLARED.model
AUGMENTED = Linear(
    MODEL.step_jacobian_at(0.0, MODEL.x0, np.zeros(1), 1.0), MODEL.output_jacobian_at(0.0, MODEL.x0, np.zeros(1)),
    np.diag(MODEL.process_cov), np.diag(MODEL.sensor_cov), np.diag(MODEL.initial_cov),
)  # fmt: skip
SENSORS, STATES, ADDED = len(MODEL.sensors), len(DECLARED.plant.states), DECLARED.added
RECENT = [*(("bias", i) for i in range(SENSORS)), *(("jump", j) for j in range(ADDED)), *(("rate", j) for j in range(STATES))]
SLOW = [*(("ramp", i) for i in range(SENSORS)), *(("drift", j) for j in range(ADDED))]
LONG = 44


def differing(hypothesis: tuple[str, int], onset: int, steps: int) -> tuple[Array, Array]:
    """The plant alone, from 0 and without noise, of which the hypothesis is true since step `onset` with unit size.

    States (steps, z) and readings (steps, N), of the steps 1, 2 ..
    """
    kind, j = hypothesis
    z, states, read = np.zeros(len(AUGMENTED.F)), [], []
    for step in range(1, steps + 1):
        since = step - onset + 1
        push, rate, fault = np.zeros(len(z)), np.zeros(len(z)), np.zeros(SENSORS)
        if kind in ("jump", "drift"):
            push[STATES + j] = float(since == 1 or (kind == "drift" and since > 1))
        elif kind == "rate":
            rate[:STATES] = DECLARED.rates[:, j] * (since >= 1)
        else:
            fault[j] = max(since, 0) if kind == "ramp" else since >= 1
        z = AUGMENTED.F @ (z + push) + rate
        states.append(z)
        read.append(AUGMENTED.H @ z + fault)
    return np.array(states), np.array(read)


def stepped(
    y: Array, grid: OnsetGrid, slow: bool, restart: Sequence[int] = (), leading: int | None = None
) -> list[tuple[Weighed, Window, Best]]:
    """The window along the filter of MODEL on readings y (K, B, N), by step; after the steps `restart` it starts again."""
    filtering, batch, draws = Extended(), y.shape[1:2], np.random.default_rng(0)
    core = filtering.start(MODEL, batch, draws)
    window = empty(batch, grid, len(MODEL.states), len(SLOW if slow else RECENT))
    last = no_update(batch, len(MODEL.states), SENSORS)
    found = []
    for step, reading in enumerate(y, start=1):
        u = np.zeros((*batch, 1))
        prior = filtering.predict(MODEL, core, step - 1.0, u, 1.0, draws)
        joint = filtering.joint(MODEL, prior, float(step), u)
        now = statistics(joint, reading, np.isfinite(reading))
        shift = shifted(window, grid, step)
        F = prior.tangent
        assert F is not None
        effect = DECLARED.slow(F, shift.age) if slow else DECLARED.recent(F, grid.slots)
        common = step_in_common(last, F, AUGMENTED.H, now, window.eta.dtype, leading)
        weighed = weigh(shift, common, effect)
        sizes = DECLARED.slow_sizes(shift.age) if slow else DECLARED.recent_sizes
        best = best_onset(weighed, np.ones((*batch, weighed.M.shape[-1]), bool), sizes)
        core = GaussianState(*posterior(joint, now))
        again = np.full(batch, step in restart)
        window, last = updated(weighed, again), last_update(common, gain(joint, now.inverse), again)
        found.append((weighed, window, best))
    return found


@pytest.mark.parametrize(
    ("grid", "slow"),
    [(OnsetGrid(5), False), (OnsetGrid.spanning(16), False), (OnsetGrid(5), True), (OnsetGrid.spanning(32, 2), True)],
    ids=["recent-dense", "recent-sparse", "slow-dense", "slow-sparse"],
)  # fmt: skip
@pytest.mark.parametrize("restart", [0, 15], ids=["once", "restart"])
def test_every_hypothesis_is_the_filter_on_a_plant_of_which_it_is_true(grid: OnsetGrid, slow: bool, restart: int) -> None:
    """eta and M are those of the unit hypothesis alone through the same filter with the same gaps; a and b follow."""
    rng = np.random.default_rng(20)
    y = rng.standard_normal((LONG, 1, SENSORS)) * 3.0
    y[rng.random(y.shape) < 0.2] = np.nan
    y[7] = np.nan
    found = stepped(y, grid, slow, [restart] if restart else [], STATES if slow else None)
    healthy = filtered(y[:, 0], np.zeros(len(MODEL.states)), AUGMENTED.P0, AUGMENTED)
    condition = float(np.linalg.cond(AUGMENTED.H @ AUGMENTED.P0 @ AUGMENTED.H.T + AUGMENTED.R))
    steps_seen = {max(o, r) for k in range(1, LONG + 1) for r in (1, restart + 1) for o in grid.onsets(k)}
    checked = 0
    for column, hypothesis in enumerate(SLOW if slow else RECENT):
        alone, terms = {}, {}
        for onset in sorted(o for o in steps_seen if o <= LONG):
            z, read = differing(hypothesis, onset, LONG)
            read[np.isnan(y[:, 0])] = np.nan
            alone[onset] = z, (steps := filtered(read, np.zeros(z.shape[-1]), AUGMENTED.P0, AUGMENTED))
            whitened = [np.linalg.solve(one.S, step.d) for one, step in zip(healthy, steps, strict=True)]
            terms[onset] = [
                (float(w @ one.d), float(w @ step.d)) for w, one, step in zip(whitened, healthy, steps, strict=True)
            ]  # of each step, of a and of b
        largest = max(np.abs(s.d).max(initial=0.0) for _, steps in alone.values() for s in steps)
        # each number is a sum over the steps and over readings and states, of terms as large as the largest effect
        near = rounding(condition * max(largest, 1.0), LONG * 4 * (SENSORS + len(MODEL.states)))
        for step in range(1, LONG + 1):
            weighed, _, best = found[step - 1]
            first = 1 if step <= restart or not restart else restart + 1
            for slot, onset in enumerate(grid.onsets(step)):
                onset = max(onset, first)
                z, steps = alone[onset]
                of, used = steps[step - 1], healthy[step - 1].used
                assert weighed.age[0, slot] == step - onset + 1
                np.testing.assert_allclose(weighed.eta[0, slot, :, column], of.x - z[step - 1], rtol=0, atol=near)
                np.testing.assert_allclose(weighed.M[0, slot, used, column], of.d, rtol=0, atol=near)
                a, b = map(sum, zip(*terms[onset][onset - 1 : step], strict=True))
                assert weighed.a[0, slot, column] == pytest.approx(a, rel=0, abs=near * max(1.0, largest) * 10), (step, slot)
                assert weighed.b[0, slot, column] == pytest.approx(b, rel=0, abs=near * max(1.0, largest)), (step, slot)
                checked += 1
            slot = best.slot[0, column]
            moved = absorbed(weighed, best, np.array([column]))
            np.testing.assert_array_equal(moved[0], weighed.eta[0, slot, :, column])
    assert checked == (len(SLOW) if slow else len(RECENT)) * LONG * grid.slots


def test_a_run_whose_window_starts_again_changes_no_other() -> None:
    y = np.random.default_rng(21).standard_normal((20, 2, SENSORS))
    weighed, found, _ = stepped(y, OnsetGrid(4), False)[-1]
    one = updated(weighed, np.array([True, False]))
    for after, before in zip(one, found, strict=True):
        assert not np.any(after[0]) and np.any(before[0])
        np.testing.assert_array_equal(after[1], before[1])


def test_the_change_of_the_innovation() -> None:
    """M = D - H eta; of some slots and hypotheses as of all."""
    eta = np.random.default_rng(22).standard_normal((2, 3, 5, 6))
    H = np.random.default_rng(23).standard_normal((2, 4, 5))
    readings = np.array([[1.0, 2.0, 3.0], [1.0, 1.0, 1.0]])
    whole = Weighed(eta, readings, *np.zeros((2, 2, 3, 6)), np.ones((2, 3)), H)
    direct = np.zeros((2, 3, 4, 6))
    direct[..., :4] = readings[..., None, None] * np.eye(4)
    allowed = rounding(float(np.max(np.abs(H[:, None]) @ np.abs(eta))) + 3.0, 6)
    np.testing.assert_allclose(whole.M, direct - H[:, None] @ eta, rtol=0, atol=allowed)
    part = whole.changes(slice(1, 2), 4)
    np.testing.assert_allclose(part, (direct - H[:, None] @ eta)[:, 1:2, :, 4:], rtol=0, atol=allowed)


GRIDS = [
    OnsetGrid(1),
    OnsetGrid(7),
    OnsetGrid(4, 3),
    OnsetGrid(6, 4, 3),
    OnsetGrid.spanning(32),
    OnsetGrid.spanning(256, 4),
    OnsetGrid.spanning(100, 3, 8),
]


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_an_onset_that_is_kept_is_new_or_was_kept_before(grid: OnsetGrid) -> None:
    """So each step needs the sums of the step before alone; the count is constant and the slots are those of `moves`."""
    for step in range(1, 600):
        now, before = grid.onsets(step), grid.onsets(step - 1)
        assert len(now) == grid.slots and now == sorted(now, reverse=True) and now[0] <= step
        assert set(now) <= {*before, step}
        moves = grid.moves(step)
        if step % grid.finest:
            assert moves is None and now == before
        else:
            assert moves is not None and now == [step if slot < 0 else before[slot] for slot in moves]


@pytest.mark.parametrize(
    ("samples", "finest", "latest"), [(4, 1, 4), (32, 1, 4), (33, 1, 4), (256, 4, 4), (100, 3, 8), (2, 1, 4)]
)
def test_a_grid_spans_the_samples_it_states_at_steps_that_grow_with_their_distance(
    samples: int, finest: int, latest: int
) -> None:
    grid = OnsetGrid.spanning(samples, finest, latest)
    coarsest = finest * 2 ** (grid.levels - 1)
    assert samples <= latest * coarsest and (grid.levels == 1 or latest * coarsest < 2 * samples)
    for step in range(1, 300):
        age = step - np.array(grid.onsets(step))
        assert (latest - 1) * coarsest <= age[-1] < latest * coarsest
        # between two onsets are at most `finest` samples, or the age of the older one over half of latest
        assert np.all(np.diff(age) <= np.maximum(finest, 2 * age[1:] / latest))


def test_readings_that_are_more_add_their_product_with_the_change_of_the_innovation() -> None:
    """a = sum M' u is linear in the whitened readings."""
    rng = np.random.default_rng(25)
    for slow in (False, True):
        weighed, *_ = stepped(rng.standard_normal((12, 2, SENSORS)), OnsetGrid(5), slow)[-1]
        more = rng.standard_normal((2, SENSORS))
        expected = weighed.a + np.einsum("blnq,bn->blq", weighed.M, more)
        near = rounding(1.0, 4 * (SENSORS + len(MODEL.states))) * np.abs(weighed.M).max() * np.abs(weighed.eta).max()
        np.testing.assert_allclose(with_readings(weighed, more).a, expected, rtol=0, atol=max(near, 1e-12))


def test_onsets_before_the_start_are_the_start() -> None:
    y = np.random.default_rng(24).standard_normal((3, 1, SENSORS))
    window, *_ = stepped(y, OnsetGrid(6), False)[-1]
    np.testing.assert_array_equal(window.age[0], [1, 2, 3, 3, 3, 3])
    for sums in (window.a[0], window.b[0], window.eta[0]):
        np.testing.assert_array_equal(sums[3:], sums[[2, 2, 2]])
