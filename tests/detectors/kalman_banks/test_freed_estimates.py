"""What an accepted explanation changes in the estimate, on windows made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.detectors.kalman_banks import freed_estimates
from fusion_sfdia.detectors.kalman_banks.competition import Accepted, Evidence
from fusion_sfdia.detectors.kalman_banks.freed_estimates import moved, with_alternatives, with_prior_unknowns
from fusion_sfdia.detectors.kalman_banks.likelihood_window import Best, Weighed
from fusion_sfdia.detectors.kalman_banks.standing import DOUBT
from fusion_sfdia.filters.estimators import GaussianState, Prior

Array = NDArray[Any]
RNG = np.random.default_rng(0)
RUNS, STATES, SENSORS, ADDED, EQUATIONS, SLOTS = 2, 3, 2, 1, 2, 4
PROCESS = ADDED + EQUATIONS
X, P = RNG.normal(size=(RUNS, STATES)), np.broadcast_to(np.diag([1.0, 2.0, 3.0]), (RUNS, STATES, STATES))
PRIOR = Prior(GaussianState(X, P), np.zeros(RUNS, bool), np.zeros(RUNS, bool))
CLOSE = rounding(1.0, 10) * 100  # sums of products of numbers of order one to ten


def weighed(hypotheses: int) -> Weighed:
    sums = RNG.normal(size=(2, RUNS, SLOTS, hypotheses))
    eta = RNG.normal(size=(RUNS, SLOTS, STATES, hypotheses))
    return Weighed(eta, np.zeros((RUNS, SLOTS)), *sums, np.ones((RUNS, SLOTS)), np.zeros((RUNS, SENSORS, STATES)))


def best(hypotheses: int) -> Best:
    size, information = RNG.normal(size=(RUNS, hypotheses)), RNG.uniform(1, 2, (RUNS, hypotheses))
    return Best(size, size, information, size, RNG.integers(0, SLOTS, (RUNS, hypotheses)))


TESTED = freed_estimates.Tested(
    weighed(SENSORS + PROCESS), weighed(SENSORS + ADDED), best(SENSORS + PROCESS), best(SENSORS + ADDED)
)


def evidence(slow_sensor: bool, slow_process: bool) -> Evidence:
    s, p = np.zeros((RUNS, SENSORS)), np.zeros((RUNS, PROCESS))
    far_s, far_p = np.full((RUNS, SENSORS), slow_sensor), np.full((RUNS, ADDED), slow_process)
    level = np.concatenate([s, p], axis=-1)
    return Evidence(level, far_s, s, s, s, s, s, far_p, p, p, p, p)


def explained(slow: bool, run: int, column: int) -> tuple[Array, float, float]:
    """eta at the best onset of a hypothesis, its size and information."""
    window, found = (TESTED.slow, TESTED.best_slow) if slow else (TESTED.recent, TESTED.best_recent)
    eta = window.eta[run, found.slot[run, column], :, column]
    return eta, float(found.size[run, column]), float(found.information[run, column])


@pytest.mark.parametrize("slow", [False, True])
def test_the_effect_of_a_fault_and_its_variance_are_removed(slow: bool) -> None:
    """x - eta a / b, P + eta eta' / b, of a bias or a ramp; the other run is not changed."""
    chosen = Accepted(np.array([1, 0]), np.array([True, False]), np.zeros(RUNS, int), np.zeros(RUNS, bool))
    x, p = moved(PRIOR, TESTED, evidence(slow, not slow), chosen, np.array([True, False])).core
    eta, size, b = explained(slow, 0, 1)
    np.testing.assert_allclose(x[0], X[0] - eta * size, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(p[0], P[0] + np.outer(eta, eta) / b, rtol=0, atol=CLOSE)
    np.testing.assert_array_equal(x[1], X[1])
    np.testing.assert_array_equal(p[1], P[1])


@pytest.mark.parametrize(("hypothesis", "slow"), [(0, False), (0, True), (2, False), (2, True)])
def test_the_estimate_moves_to_a_difference_of_the_process(hypothesis: int, slow: bool) -> None:
    """Of an augmented state by either window, of an equation by the recent one; a part of its square is added."""
    chosen = Accepted(np.zeros(RUNS, int), np.zeros(RUNS, bool), np.array([0, hypothesis]), np.array([False, True]))
    x, p = moved(PRIOR, TESTED, evidence(not slow, slow), chosen, np.zeros(RUNS, bool)).core
    eta, size, b = explained(slow and hypothesis < ADDED, 1, SENSORS + hypothesis)
    np.testing.assert_allclose(x[1], X[1] - eta * size, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(p[1], P[1] + np.outer(eta, eta) * (1 / b + DOUBT * size**2), rtol=0, atol=CLOSE)
    np.testing.assert_array_equal(x[0], X[0])


def test_alternatives_widen_the_covariance_by_their_effects() -> None:
    """weight size^2 eta eta', and move nothing."""
    weight = np.array([[0.0, 0.5, 0.2], [0.0, 0.0, 0.0]])
    x, p = with_alternatives(PRIOR, TESTED, weight).core
    effects = [(explained(False, 0, SENSORS + j), weight[0, j]) for j in (1, 2)]
    expected = P[0] + sum(w * size**2 * np.outer(eta, eta) for (eta, size, _), w in effects)
    np.testing.assert_allclose(p[0], expected, rtol=0, atol=CLOSE)
    np.testing.assert_array_equal(p[1], P[1])
    np.testing.assert_array_equal(x, X)
    assert with_alternatives(PRIOR, TESTED, np.zeros((RUNS, PROCESS))) is PRIOR


def test_unknowns_get_their_prior_spread_again_but_for_frozen_ones() -> None:
    correlated = np.array([[1.0, 0.2, 0.3], [0.2, 2.0, 0.1], [0.3, 0.1, 3.0]])
    frozen = np.diag([1.0, 2.0, 0.0])
    prior = PRIOR._replace(core=GaussianState(X, np.stack([correlated, frozen])))
    x, p = with_prior_unknowns(prior, np.array([0.5])).core
    np.testing.assert_array_equal(p[0], [[1.0, 0.2, 0.0], [0.2, 2.0, 0.0], [0.0, 0.0, 0.25]])
    np.testing.assert_array_equal(p[1], frozen)
    np.testing.assert_array_equal(x, X)
    assert correlated[0, 2] == 0.3  # the prior itself is not changed
