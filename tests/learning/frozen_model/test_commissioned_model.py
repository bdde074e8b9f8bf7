"""Commissioning of the frozen model: unknowns, corrections, limits, and rows that are unlike all others."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from toy_plants import tanks

from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.frozen_model.commissioned_model import beyond, commissioned, commissioned_without_faults
from fusion_sfdia.models.two_tanks.plant import two_tanks
from fusion_sfdia.plant.log import Log

PLANT = tanks()
STEPS = 1500


@cache
def healthy(seed: int = 1, steps: int = STEPS) -> Log:
    found = simulate(PLANT, steps, [seed], process_noise=True)
    return Log(found.t, found.y, found.u_of_runs)


def test_a_right_model_is_not_corrected_and_its_unknowns_stay() -> None:
    found = commissioned(PLANT, healthy())
    assert not found.frozen.coef[:, 1:].any()
    sd = np.concatenate([PLANT.uncertainty.sd, list(PLANT.uncertainty.inputs.values())])
    known = np.concatenate([PLANT.uncertainty.nominal, np.zeros(len(PLANT.uncertainty.inputs))])
    assert np.all(np.abs(found.frozen.values - known) < 0.5 * sd)  # the log says more than the prior
    assert found.unlike == ()


def test_limits_hold_on_other_logs_of_a_right_model() -> None:
    """T of one row is chi-square of 4: among 1400 rows the largest is near 20; limits are above, by less than twice."""
    found = commissioned(PLANT, healthy()).frozen
    assert 18 < found.limit[0] < 40 and np.all(np.isfinite(found.limit))
    spread = np.sqrt(np.diagonal(found.cov, axis1=1, axis2=2)) / PLANT.sensor_sigma
    assert np.all(np.diff(spread, axis=0) < 0)  # means of more rows have less noise


@pytest.mark.long
@pytest.mark.slow
def test_rows_with_a_fault_are_left_out_and_named() -> None:
    log = healthy()
    y = log.y.copy()
    y[700:760, 0, 2] += 40 * PLANT.sensor_sigma[2]
    learnt, out, _ = commissioned_without_faults(PLANT, log._replace(y=y))
    assert out and all(part.run == 0 for part in out)
    assert all(part.last >= 700 and part.first < 760 + 240 for part in out)
    clean = commissioned(PLANT, log).frozen
    # of four blocks, whose logarithms have an sd of .2 at least; the longest window is in each but twice
    np.testing.assert_allclose(learnt.frozen.limit[:4], clean.limit[:4], rtol=0.6)
    np.testing.assert_allclose(np.diag(learnt.frozen.cov[0]), np.diag(clean.cov[0]), rtol=0.3)


def test_gaps_and_a_sensor_without_readings_are_learnt_with() -> None:
    log = healthy()
    y = log.y.copy()
    y[np.random.default_rng(2).random(y.shape) < 0.3] = np.nan
    y[..., 3] = np.nan
    found = commissioned(PLANT, log._replace(y=y)).frozen
    assert np.all(np.isfinite(found.limit)) and found.limit[0] < 40
    assert found.share[3] < 1e-6 and np.all(np.abs(found.share[:3] - 0.7) < 0.05)


def test_a_log_that_is_too_short_is_refused_with_what_it_takes() -> None:
    with pytest.raises(ValueError, match=r"has 40 samples; the filter on plant .* at least 30 are needed"):
        commissioned(two_tanks(), healthy(steps=40))


def test_beyond_its_range_a_correction_is_believed_less() -> None:
    low, high = np.array([-np.inf, -1.0]), np.array([np.inf, 1.0])
    phi = np.array([[1.0, 0.9], [1.0, -1.0], [1.0, 1.5], [1.0, -2.0]])
    np.testing.assert_allclose(beyond(phi, low, high), [1.0, 1.0, (1 + 12 * 0.25) ** 2, (1 + 12 * 0.5) ** 2])
