"""The unscented transform: its moments, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from rounding import rounding
from three_states import F, H, Q, R, bend, f, h, look

from fusion_sfdia.filters import ukf
from fusion_sfdia.filters.gaussian import Joint, condition, dense
from fusion_sfdia.filters.ukf import SigmaPoints


@pytest.mark.parametrize("settings", [(1.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.5, 2.0, 0.0), (0.1, 2.0, 1.0), (1.0, 2.0, 0.5)])
def test_moments_relative_to_the_centre_are_the_usual_weighted_sums(settings: tuple[float, float, float]) -> None:
    alpha, beta, kappa = settings
    n = 3
    points = SigmaPoints(*settings)
    rng = np.random.default_rng(0)
    x, P = rng.standard_normal(n), dense(np.array([0.3, 0.2, 0.5])) + 0.1
    X = ukf.sigma_points(points, x, P)
    spread = alpha**2 * (n + kappa)
    W = np.full(2 * n + 1, 0.5 / spread)
    Wc = W.copy()
    W[0] = 1 - n / spread
    Wc[0] = W[0] + 1 - alpha**2 + beta
    cancel = rounding(3 * np.abs(W).sum(), 3 * (2 * n + 1))  # weights of up to 1/alpha^2 = 100 cancel; numbers of up to 3
    np.testing.assert_allclose(W @ X, x, rtol=0, atol=cancel)
    np.testing.assert_allclose((X - x).T @ (W[:, None] * (X - x)), P, rtol=0, atol=cancel)
    mean, cov, propagated = ukf.predict(points, x, P, bend, Q)
    np.testing.assert_array_equal(propagated, bend(X))
    np.testing.assert_allclose(mean, W @ bend(X), rtol=0, atol=cancel)
    e = bend(X) - W @ bend(X)
    np.testing.assert_allclose(cov, e.T @ (Wc[:, None] * e) + np.diag(Q), rtol=0, atol=3 * cancel)
    joint = ukf.joint(points, mean, cov, look, R, propagated)
    z = look(propagated) - W @ look(propagated)
    np.testing.assert_allclose(joint.S, z.T @ (Wc[:, None] * z) + np.diag(R), rtol=0, atol=3 * cancel)
    np.testing.assert_allclose(joint.C, e.T @ (Wc[:, None] * z), rtol=0, atol=3 * cancel)


def test_without_redraw_the_readings_lack_the_process_noise() -> None:
    """As Shaheen 2024 prints it: S and C are those of F P F', while P is F P F' + Q; redrawn, all of F P F' + Q."""
    points, P = SigmaPoints(0.5), np.eye(3)
    x, predicted, propagated = ukf.predict(points, np.ones(3), P, f, Q)
    printed, redrawn = ukf.joint(points, x, predicted, h, R, propagated), ukf.joint(points, x, predicted, h, R)
    near = {"rtol": 0.0, "atol": rounding(10 / points.alpha**2, 30)}  # of numbers up to 10; four products of three terms
    np.testing.assert_allclose(printed.S, H @ F @ P @ F.T @ H.T + np.diag(R), **near)
    np.testing.assert_allclose(redrawn.S, H @ (F @ P @ F.T + np.diag(Q)) @ H.T + np.diag(R), **near)
    np.testing.assert_allclose(redrawn.C - printed.C, np.diag(Q) @ H.T, **near)


def test_the_unscented_covariance_is_positive_where_weighted_sums_cancel() -> None:
    """States of 1e7 with standard deviations of 1: with alpha = 1e-3, a Gram matrix keeps 6 digits, 1e7 eps / (1e-3 sqrt 3)."""
    x, P = np.full(3, 1e7), np.eye(3)
    mean, cov, _ = ukf.predict(SigmaPoints(), x, P, lambda s: s, np.zeros(3))
    np.testing.assert_allclose(cov, P, atol=1e-5)
    np.testing.assert_allclose(mean, x, rtol=1e-9)


def test_a_state_known_exactly_keeps_the_unscented_filter_going() -> None:
    """Zero variances have no Cholesky factor; the square root of a singular covariance serves."""
    P = np.diag([1.0, 0.0, 0.0])
    x, P, _ = ukf.predict(SigmaPoints(0.5), np.ones(3), P, lambda s: s, np.array([0.0, 0.0, 0.1]))
    near = {"rtol": 0.0, "atol": rounding(10 / 0.5**2, 30)}  # weights of 1/alpha^2, numbers of up to 10
    np.testing.assert_allclose(P, np.diag([1.0, 0.0, 0.1]), **near)
    found = condition(ukf.joint(SigmaPoints(0.5), x, P, h, R), np.array([2.0, 2.0]))
    exact = condition(Joint(x, P, h(x), H @ P @ H.T + np.diag(R), P @ H.T), np.array([2.0, 2.0]))
    np.testing.assert_allclose(found.x, exact.x, **near)


@pytest.mark.parametrize(
    ("settings", "message"), [((0.0, 2.0, 0.0), "alpha must be positive"), ((1.0, np.nan, 0.0), "all finite")]
)
def test_bad_settings(settings: tuple[float, float, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SigmaPoints(*settings)


def test_kappa_too_small_for_the_number_of_states() -> None:
    with pytest.raises(ValueError, match=r"kappa is -3\.0 for 3 states; it must exceed -3"):
        ukf.sigma_points(SigmaPoints(1.0, 0.0, -3.0), np.zeros(3), np.eye(3))
