"""Moments from random draws against the closed form, on linear and nonlinear plants."""

from __future__ import annotations

import numpy as np
import pytest
from chebyshev_runs import WATCHING, decisions, healthy
from toy_plants import tanks

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import Chebyshev
from fusion_sfdia.detectors.stochastic_thresholds.monte_carlo import MonteCarlo
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.models.marine_engine.plant import marine_engine


def test_random_draws_come_near_the_closed_form_and_are_reproducible() -> None:
    t, y, u = (a[:, :3] if a.ndim > 1 else a for a in healthy("tanks"))
    draws = 4000
    detector = Chebyshev(tanks(), lam=0.0, moments=MonteCarlo(draws), **WATCHING)
    drawn, points = decisions(detector, (t, y, u)), decisions(Chebyshev(tanks(), lam=0.0, **WATCHING), (t, y, u))
    np.testing.assert_allclose(drawn.threshold, points.threshold, rtol=5 / np.sqrt(2 * draws))
    # each mean has the standard error of its deviation, at most threshold / 2, over sqrt(draws), twice
    assert np.all(np.abs(drawn.residual - points.residual) < 5 * points.threshold / np.sqrt(2 * draws))
    again = decisions(detector, (t, y, u))
    np.testing.assert_array_equal(again.residual, drawn.residual)
    _, other = run(detector, detector.init((3,), seed=1), t, y, u)
    assert np.any(other.residual != drawn.residual)


@pytest.mark.parametrize("make", [marine_engine, gas_pipeline], ids=["engine", "pipeline"])
def test_random_draws_run_on_nonlinear_plants(make: object) -> None:
    plant = make()
    r = simulate(plant, 5, [1])
    d = decisions(Chebyshev(plant, moments=MonteCarlo(100)), (r.t, r.y[:, 0], r.u), ())
    assert np.all(np.isfinite(d.estimate)) and not d.diverged.any() and np.all(np.isfinite(d.threshold))
