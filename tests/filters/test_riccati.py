"""The covariance that a filter tends to: against SciPy's solver, in any units, and where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from rounding import rounding
from scipy.linalg import solve_discrete_are

from fusion_sfdia.filters.riccati import steady_prediction


@pytest.mark.parametrize("seed", range(5))
def test_it_solves_the_riccati_equation(seed: int) -> None:
    """To the condition of I + G P times the rounding of its products; the solver of SciPy takes another way."""
    rng = np.random.default_rng(seed)
    n, N = 5, 3
    F = rng.standard_normal((n, n))
    F *= rng.uniform(0.5, 1.1) / np.abs(np.linalg.eigvals(F)).max()
    H, q, r = rng.standard_normal((N, n)), rng.uniform(0.1, 1.0, n), rng.uniform(0.1, 1.0, N)
    P = steady_prediction(F, H, q, r)
    assert P is not None
    expected = solve_discrete_are(F.T, H.T, np.diag(q), np.diag(r))
    condition = np.linalg.cond(np.eye(n) + (H.T / r) @ H @ expected)
    np.testing.assert_allclose(P, expected, rtol=0, atol=np.abs(expected).max() * rounding(condition**2, 100 * n))


def test_a_state_that_is_not_seen_and_does_not_decay_has_none() -> None:
    """Its variance grows without end: as a random walk, and faster."""
    H, q, r = np.array([[1.0, 0.0]]), np.ones(2), np.ones(1)
    with np.errstate(over="ignore", invalid="ignore"):
        assert steady_prediction(np.diag([0.5, 1.0]), H, q, r) is None
        assert steady_prediction(np.diag([0.5, 1.1]), H, q, r) is None
    decays = steady_prediction(np.diag([0.5, 0.9]), H, q, r)
    assert decays is not None and decays[1, 1] == pytest.approx(1 / (1 - 0.9**2), rel=1e-12)
