"""The bank of models: probabilities, limits, and the literal bank of Kalman filters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from toy_plants import chain, readings

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.multiple_model import MultipleModel
from fusion_sfdia.filters.estimators import Ensemble, Unscented


def test_it_is_the_literal_bank_of_filters_merged_at_every_step() -> None:
    """GPB1 as printed: a Kalman filter for each mode from the merged estimate, then weights and moments of the mixture."""
    n, begins, duration, inflation = 3, 0.05, 20.0, 6.0
    plant = chain(n, sensors=4)
    t, _, y, u = readings(plant, 25, 1, seed=0)
    y = y[:, 0].copy()
    y[10:18, 1] += 9.0
    bank = MultipleModel(plant, inflation=inflation, fault_probability=begins, duration=duration)
    state = bank.init()
    f = plant.step_jacobian_at(0.0, plant.x0, u[0, 0], 1.0)
    h = plant.output_jacobian_at(0.0, plant.x0, u[0, 0])
    x, p, q = np.zeros(n), np.eye(n), 0.01 * np.eye(n)
    mu = np.append(1 - begins, np.full(4, begins / 4))
    chain_of = np.diag(np.append(1 - begins, np.full(4, 1 - 1 / duration)))
    chain_of[0, 1:], chain_of[1:, 0] = begins / 4, 1 / duration
    for k in range(25):
        state, d = bank.step(state, float(t[k]), y[k], u[k, 0])
        x, p = f @ x, f @ p @ f.T + q
        mu = mu @ chain_of
        xs, ps = [], []
        for i in range(5):
            r = np.ones(4)
            if i:
                r[i - 1] = inflation**2
            s = h @ p @ h.T + np.diag(r)
            gain = p @ h.T @ np.linalg.inv(s)
            xs.append(x + gain @ (y[k] - h @ x))
            ps.append(p - gain @ s @ gain.T)
            mu[i] *= multivariate_normal.pdf(y[k], h @ x, s)
        mu /= mu.sum()
        x = sum(m * a for m, a in zip(mu, xs, strict=True))
        p = sum(m * (c + np.outer(a - x, a - x)) for m, a, c in zip(mu, xs, ps, strict=True))
        # a few inverses of matrices of condition 40 at most
        np.testing.assert_allclose(np.exp(state.memory.log_probability), mu, rtol=1e-9, atol=1e-14)
        np.testing.assert_allclose(d.estimate, x, rtol=1e-9, atol=1e-11)
        assert d.covariance is not None
        np.testing.assert_allclose(d.covariance, p, rtol=1e-9, atol=1e-11)
        likelier = int(np.argmax(mu[1:]))
        assert d.isolated.tolist() == [i == likelier and mu[i + 1] > mu[0] for i in range(4)]


def test_probabilities_sum_to_one_with_missing_readings_and_huge_faults() -> None:
    plant = chain(6)
    t, _, y, u = readings(plant, 60, 5, seed=1)
    y = y.copy()
    y[20:30, :, 2] += 1e6
    y[np.random.default_rng(2).random(y.shape) < 0.3] = np.nan
    bank = MultipleModel(plant)
    state = bank.init((5,))
    for k in range(60):
        state, d = bank.step(state, float(t[k]), y[k], u[k])
        assert not d.diverged.any()
        np.testing.assert_allclose(np.exp(state.memory.log_probability).sum(axis=-1), 1.0, rtol=1e-12)


def test_results_do_not_depend_on_units() -> None:
    one, other = chain(6), chain(6, sigma=0.01)
    t, _, y, u = readings(one, 30, 2, seed=6)
    y = y + 6.0 * (np.arange(6) == 2)
    (_, a), (_, b) = (run(m, m.init((2,)), t, z, u) for m, z in ((MultipleModel(one), y), (MultipleModel(other), y / 100)))
    assert a.isolated.any()
    np.testing.assert_array_equal(a.isolated, b.isolated)
    np.testing.assert_allclose(b.estimate * 100, a.estimate, rtol=0, atol=1e-9)  # matrices of condition below 100


def test_with_one_model_it_is_the_kalman_filter() -> None:
    plant = chain(5, sensors=4)
    t, _, y, u = readings(plant, 40, 3, seed=3)
    bank, single = MultipleModel(plant, fault_probability=1e-300), CentralFilter(plant)
    _, a = run(bank, bank.init((3,)), t, y, u, covariance=True)
    _, b = run(single, single.init((3,)), t, y, u, covariance=True)
    np.testing.assert_allclose(a.estimate, b.estimate, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-12, atol=1e-12)


def test_the_threshold_of_the_residual_is_where_the_odds_are_even() -> None:
    plant = chain(8)
    t, _, y, u = readings(plant, 80, 20, seed=4)
    y = y.copy()
    y[40:60, :, 3] += 5.0
    bank = MultipleModel(plant, fault_probability=0.01)
    state = bank.init((20,))
    for k in range(80):
        state, d = bank.step(state, float(t[k]), y[k], u[k])
        mode = state.memory.log_probability
        np.testing.assert_array_equal(np.abs(d.residual) > d.threshold, mode[:, 1:] > mode[:, :1])
        if 45 <= k < 60:
            assert d.isolated[:, 3].mean() > 0.8


def test_false_alarms_are_rarer_than_assumed_faults_and_the_covariance_is_consistent() -> None:
    plant = chain(8)
    t, x, y, u = readings(plant, 200, 60, seed=5)
    bank = MultipleModel(plant, fault_probability=0.01)
    _, d = run(bank, bank.init((60,)), t, y, u, covariance=True)
    rate = d.alarm.mean(axis=0)  # samples of a run correlate, runs do not
    assert rate.mean() < 0.01 + 4 * rate.std() / np.sqrt(60)
    assert d.covariance is not None
    error = d.estimate - x
    nees = np.einsum("kbi,kbij,kbj->b", error, np.linalg.inv(d.covariance), error) / (200 * 8)
    # healthy readings: the fault modes widen the covariance a little, by their probability
    assert nees.mean() < 1 + 4 * nees.std() / np.sqrt(60) and nees.mean() > 0.9


def test_invalid_settings_are_rejected() -> None:
    plant = chain(4)
    for estimator in (Ensemble(), Unscented(redraw=False)):
        with pytest.raises(ValueError, match="no consistent mean"):
            MultipleModel(plant, estimator=estimator)
    for name in ("inflation", "duration"):
        with pytest.raises(ValueError, match=f"{name} is 1"):
            MultipleModel(plant, **{name: 1.0})
