"""A second filter that looks again at verdicts: its sums against a filter with the causes as states, its doubt, readmission."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks import fresh_look
from fusion_sfdia.detectors.kalman_banks.excluding_bank import least_change
from fusion_sfdia.detectors.kalman_banks.fresh_look import (
    Look,
    Question,
    Sums,
    answered,
    begun,
    failed_instead,
    no_look,
    remembered,
    with_sample,
)
from fusion_sfdia.detectors.kalman_banks.leave_one_out import statistics
from fusion_sfdia.filters.estimators import GaussianState
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.study.audit import outcomes
from fusion_sfdia.study.error_protocol import CASES, trial

N, P = 3, 1  # sensors, unknowns; the state is (x, unknown)
F = np.array([[0.9, 0.3], [0.0, 1.0]])
H = np.array([[1.0, 0.0], [0.5, 0.0], [0.8, 0.2]])
Q, R = np.diag([0.01, 0.0]), np.diag([0.04, 0.04, 0.09])
SIZE = np.array([4.0, 4.0, 6.0, 10.0])


def predicted(look: Look) -> Joint:
    """Of state and readings before the update, with H as for a batch of one."""
    x = look.estimate.x @ F.T
    p = F @ look.estimate.P @ F.T + Q
    return Joint(x, p, x @ H.T, H @ p @ H.T + R, p @ H.T, H=H[None])


def looked(readings: np.ndarray) -> Look:
    """A look at readings (K, N) from its beginning on; later ones are as at first."""
    start = GaussianState(np.zeros((1, 2)), np.diag([1.0, 0.25])[None])
    look = begun(no_look(start, (1,), N, P), start, np.array([True]), first=False)
    for y in readings:
        joint = predicted(look)
        look = with_sample(look, F[None], joint, statistics(joint, y[None], np.isfinite(y)[None]))
    return look


def simulated(bias: np.ndarray, jump: float, samples: int, seed: int = 3) -> np.ndarray:
    """Readings (K, N) of the model with a constant bias (N,), and an unknown of that size."""
    rng = stream(seed, "fresh look")
    z, y = np.array([0.0, jump]), np.empty((samples, N))
    for k in range(samples):
        z = F @ z + np.array([0.1, 0.0]) * rng.standard_normal()
        y[k] = H @ z + bias + np.sqrt(np.diag(R)) * rng.standard_normal(N)
    return y


def test_causes_are_estimated_as_by_a_filter_that_has_them_as_states() -> None:
    y = simulated(np.array([1.5, 0.0, 0.0]), 0.3, 25)
    y[7, 1] = np.nan
    look = looked(y)
    causes, covariance = Sums(look.a, look.A, SIZE).estimated(np.array([[True, False, True, True]]))
    # augmented: x, unknown, bias of 1, bias of 3, jump of the unknown before the first step
    f, h = np.eye(5), np.hstack([H, np.eye(N)[:, [0, 2]], np.zeros((N, 1))])
    f[:2, :2] = F
    f[:2, 4] = F[:, 1]
    x, p = np.zeros(5), np.diag([1.0, 0.25, *SIZE[[0, 2, 3]] ** 2])
    for k, row in enumerate(y):
        step = f.copy()
        if k:  # the jump is a part of the unknown from the first step on
            step[:2, 4] = 0.0
        x, p = step @ x, step @ p @ step.T
        p[0, 0] += Q[0, 0]
        seen = np.isfinite(row)
        gain = np.linalg.solve(h[seen] @ p @ h[seen].T + R[np.ix_(seen, seen)], h[seen] @ p).T
        x, p = x + gain @ (row[seen] - h[seen] @ x), p - gain @ h[seen] @ p
    np.testing.assert_allclose(causes[0, [0, 2]], x[2:4], rtol=1e-8)
    np.testing.assert_allclose(covariance[0][np.ix_([0, 2], [0, 2])], p[2:4, 2:4], rtol=1e-8)
    np.testing.assert_allclose(causes[0, 3], x[4], rtol=1e-8)
    assert causes[0, 1] == 0
    assert not covariance[0, 1].any()


def test_evidence_is_that_of_the_marginal_likelihood() -> None:
    look = looked(simulated(np.array([0.0, 2.0, 0.0]), 0.0, 20))
    sums = Sums(look.a, look.A, SIZE)
    one = np.array([[False, True, False, False]])
    a, b, s = look.a[0, 1], look.A[0, 1, 1], SIZE[1]
    np.testing.assert_allclose(sums.evidence(one)[0], a**2 * s**2 / (1 + b * s**2) - np.log1p(b * s**2), rtol=1e-10)
    assert sums.evidence(np.zeros((1, 4), bool))[0] == 0


def test_evidence_of_two_causes_is_that_of_both_together() -> None:
    look = looked(simulated(np.array([0.0, 2.0, 1.0]), 0.0, 20))
    sums = Sums(look.a, look.A, SIZE)
    every = np.eye(4, dtype=bool)
    expected = sums._replace(a=look.a[:, None, None], A=look.A[:, None, None]).evidence(every[:, None] | every)
    np.testing.assert_allclose(sums.of_two(), np.where(every, -np.inf, expected), rtol=1e-9)


def shown_to_have_failed(bias: np.ndarray, jump: float) -> tuple[np.ndarray, np.ndarray, GaussianState]:
    """What a first look at as many readings as it needs finds to have failed where the process has been named."""
    look = looked(simulated(bias, jump, fresh_look.ENOUGH))._replace(first=np.array([True]))
    return failed_instead(look, SIZE, np.ones(1), np.array([True]))


@pytest.mark.parametrize("bias", [[3.0, -3.0, 0.0], [0.0, 2.0, 2.0]])
def test_sensors_that_fail_together_are_no_change_of_the_process(bias: list[float]) -> None:
    """The estimate is that of a filter with the biases as states."""
    failed, found, estimate = shown_to_have_failed(np.array(bias), 0.0)
    assert failed.tolist() == [[b != 0 for b in bias]]
    which = np.flatnonzero(bias)
    n, k = 2, which.size
    wide, seen = np.eye(n + k), np.hstack([H, np.eye(N)[:, which]])
    wide[:n, :n] = F
    z, P_ = np.zeros(n + k), np.diag([1.0, 0.25, *SIZE[which] ** 2])
    for y in simulated(np.array(bias), 0.0, fresh_look.ENOUGH):
        z, P_ = wide @ z, wide @ P_ @ wide.T
        P_[:n, :n] += Q
        S = seen @ P_ @ seen.T + R
        K = np.linalg.solve(S, seen @ P_).T
        z, P_ = z + K @ (y - seen @ z), P_ - K @ S @ K.T
    np.testing.assert_allclose(found[0, which], z[n:], rtol=1e-8)
    np.testing.assert_allclose(estimate.x[0], z[:n], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(estimate.P[0], P_[:n, :n], rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize(
    ("bias", "jump"), [([0.0, 0.0, 0.0], 4.0), ([0.0, 3.0, 0.0], 4.0), ([0.0, 3.0, 0.0], 0.0), ([0.0, 0.0, 0.0], 0.0)]
)
def test_no_two_sensors_are_blamed_where_one_cause_may_be_a_jump(bias: list[float], jump: float) -> None:
    assert not shown_to_have_failed(np.array(bias), jump)[0].any()


def question(out: list[bool], fault: list[float]) -> Question:
    return Question(np.array([out]), np.array([fault]), SIZE, np.ones(1), 3.0)


def test_a_sensor_that_is_right_is_shown_to_be_right() -> None:
    look, right = answered(looked(simulated(np.zeros(N), 0.0, 30)), question([True, False, False], [2.0, 0.0, 0.0]))
    assert right[0]
    assert not look.doubt.any()


@pytest.mark.parametrize("samples", [3, 30])
def test_a_sensor_that_fails_is_not_shown_to_be_right(samples: int) -> None:
    _, right = answered(looked(simulated(np.array([2.0, 0, 0]), 0.0, samples)), question([True, False, False], [2.0, 0, 0]))
    assert not right[0]


def test_too_few_samples_show_nothing() -> None:
    readings = simulated(np.zeros(N), 0.0, fresh_look.LEAST)
    asked = question([True, False, False], [5.0, 0.0, 0.0])
    assert not answered(looked(readings[:-1]), asked)[1][0]
    assert answered(looked(readings), asked)[1][0]


def test_a_fault_that_would_not_show_is_in_doubt_only_beside_a_process_verdict() -> None:
    look = looked(simulated(np.zeros(N), 0.0, 30))
    sd = np.sqrt(1 / look.A[0, 0, 0])
    asked = question([True, False, False], [2.5 * float(sd), 0.0, 0.0])
    alone, right = answered(look, asked)
    beside, _ = answered(look._replace(stood=np.array([[True, False]])), asked)
    assert not right[0]
    assert not alone.doubt.any()
    assert beside.doubt.tolist() == [[True, False, False]]


def test_a_first_look_doubts_what_a_jump_of_an_unknown_explains_as_well() -> None:
    yes = np.array([True])
    jumped = looked(simulated(np.zeros(N), 4.0, 30))._replace(first=yes)
    failed = looked(simulated(np.array([0.0, 0.0, 4.0]), 0.0, 30))._replace(first=yes)
    asked = question([False, False, True], [0.0, 0.0, 4.0])
    assert answered(jumped, asked)[0].doubt.tolist() == [[False, False, True]]
    assert not answered(failed, asked)[0].doubt.any()


def test_correlated_noise_makes_the_same_sums_count_less() -> None:
    look = looked(simulated(np.zeros(N), 0.0, 30))
    fault = [float(np.sqrt(1.2 * fresh_look.AGAINST / look.A[0, 0, 0])), 0.0, 0.0]
    asked = question([True, False, False], fault)
    quiet = look._replace(a=np.zeros_like(look.a))
    assert answered(quiet, asked)[1][0]
    assert not answered(quiet, asked._replace(inflation=np.array([2.0])))[1][0]


def test_what_has_stood_is_forgotten_after_a_while_without_a_verdict() -> None:
    look = looked(simulated(np.zeros(N), 0.0, 3))
    stood = np.array([[False, True]])
    look = remembered(look, np.array([True]), stood)
    assert look.samples[0] == 4
    for _ in range(fresh_look.FORGOTTEN):
        look = remembered(look, np.array([False]), np.zeros((1, 2), bool))
    assert look.samples[0] == 0
    assert look.stood.tolist() == [[False, True]]
    assert not remembered(look, np.array([False]), np.zeros((1, 2), bool)).stood.any()


def test_begun_keeps_other_runs_and_what_is_in_doubt() -> None:
    start = GaussianState(np.zeros((2, 2)), np.broadcast_to(np.eye(2), (2, 2, 2)))
    now = no_look(start, (2,), N, P)._replace(samples=np.array([5.0, 5.0]), doubt=np.array([[True, False, False]] * 2))
    look = begun(now, GaussianState(start.x + 1, start.P), np.array([True, False]), first=False)
    assert look.samples.tolist() == [1, 5]
    assert look.first.tolist() == [False, True]
    assert look.doubt[:, 0].all()
    np.testing.assert_array_equal(look.estimate.x, [[1.0, 1.0], [0.0, 0.0]])


def test_the_least_change_shows_as_one_and_is_the_smallest() -> None:
    scale = np.array([1.0, 3.0])
    g = least_change(H, scale)
    np.testing.assert_allclose(np.sum(H * g, axis=-1), 1.0, rtol=1e-14)
    # by the least norm in scaled units
    expected = np.linalg.pinv((H * scale)[2:3])[:, 0] * scale
    np.testing.assert_allclose(g[2], expected, rtol=1e-12)
    assert not least_change(np.zeros((1, 2)), scale).any()


@pytest.mark.long
def test_sensors_are_used_again_after_a_fault_beside_a_change_of_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs in the last row of which a healthy sensor is isolated, and rows in which one is, with the look and without."""
    detector = registry.detector("robust-glr", registry.plant("two-tanks"))
    cases = [next(c for c in CASES if c.name == f"process-then-bias-{lead}") for lead in (0, 5, 30)]

    def latched() -> tuple[int, int]:
        found = [o for case in cases for o in outcomes(detector, case, range(12_000, 12_024))[0]]
        return sum(o.at_end for o in found), sum(o.counts[0] for o in found)

    at_end, rows = latched()
    monkeypatch.setattr(fresh_look, "LEAST", np.inf)
    monkeypatch.setattr(fresh_look, "ENOUGH", np.inf)
    without, rows_without = latched()
    assert at_end <= without / 2
    assert rows <= 0.7 * rows_without


@pytest.mark.parametrize("seed", [773_012, 773_018])
def test_two_sensors_that_fail_in_the_same_row_are_named_after_the_process_was(seed: int) -> None:
    plant = registry.plant("two-tanks")
    made = trial(plant, next(c for c in CASES if c.name == "two-biases"), seed)
    detector = registry.detector("robust-glr", plant)
    _, found = run(detector, detector.init(), made.log.t, made.log.y, made.log.u)
    rows = np.flatnonzero(made.faulty.any(axis=-1))
    assert found.process[rows].any()  # at first
    late = rows[rows > np.flatnonzero(found.process.any(axis=-1))[0] + fresh_look.ENOUGH]
    assert np.mean((found.isolated == made.faulty)[late].all(axis=-1)) > 0.95
    assert not found.process[late].any()
    assert not found.isolated[-1].any()
