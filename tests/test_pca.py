"""Principal components: against scikit-learn and conditional means; what is named, and at which rate alarms are false."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import betabinom, chi2
from sklearn.decomposition import PCA
from toy_plants import Array, chain

from fusion_sfdia.core.detector import Decision, run
from fusion_sfdia.data_driven.fixed_limits import FixedLimits
from fusion_sfdia.data_driven.pca import PrincipalComponents
from fusion_sfdia.evaluation.simulate import simulate
from fusion_sfdia.models.two_tanks import two_tanks

PLANT = chain(6)
RNG = np.random.default_rng(0)
MIX = RNG.normal(size=(2, 6))


def data(*shape: int, seed: int = 0, noise: float = 0.3) -> Array:
    """Readings of two common causes with noise."""
    rng = np.random.default_rng(seed)
    return np.asarray(10.0 + rng.standard_normal((*shape, 2)) @ MIX + noise * rng.standard_normal((*shape, 6)))


DETECTOR = PrincipalComponents.fit(PLANT, data(2000, 2), 0.02, components=2)


def judged(detector: PrincipalComponents, y: Array) -> Decision:
    """Decisions on readings (K, ..., N)."""
    u = np.zeros((*y.shape[:-1], 0))
    return run(detector, detector.init(y.shape[1:-1]), np.arange(1.0, len(y) + 1), y, u)[1]


def test_the_model_is_scikit_learns() -> None:
    y = data(2000, 2)[::2].reshape(-1, 6)
    x = (y - y.mean(axis=0)) / y.std(axis=0)
    oracle = PCA(2).fit(x)
    np.testing.assert_allclose(DETECTOR.precision, oracle.get_precision(), rtol=1e-9, atol=1e-9)
    s = DETECTOR.statistics(y[:50])
    scores = oracle.transform(x[:50])
    np.testing.assert_allclose(s.t2, np.sum(scores**2 / oracle.explained_variance_, axis=-1), rtol=1e-9)
    np.testing.assert_allclose(s.spe, np.sum((x[:50] - oracle.inverse_transform(scores)) ** 2, axis=-1), rtol=1e-9)
    np.testing.assert_allclose(s.filled, y[:50], rtol=1e-12)


def test_missing_readings_are_conditional_means_and_contributions_what_the_index_loses() -> None:
    """By the covariance S = P' Lambda P + noise (I - P' P): x_m = S_mo S_oo^-1 x_o, and index = x_o' S_oo^-1 x_o."""
    cov = np.linalg.inv(DETECTOR.precision)
    y = data(1, seed=3)
    z = (y - DETECTOR.centre) / DETECTOR.scale

    def index(known: Array) -> float:
        return float(z[0, known] @ np.linalg.solve(cov[np.ix_(known, known)], z[0, known]))

    for gone in ([], [1], [0, 4], [0, 1, 2, 4, 5]):
        known = np.setdiff1d(np.arange(6), gone)
        holes = y.copy()
        holes[:, gone] = np.nan
        s = DETECTOR.statistics(holes)
        mean = cov[np.ix_(gone, known)] @ np.linalg.solve(cov[np.ix_(known, known)], z[0, known])
        filled = (s.filled[0] - DETECTOR.centre) / DETECTOR.scale
        np.testing.assert_allclose(filled[gone], mean, atol=1e-9)
        assert s.t2[0] + s.spe[0] / DETECTOR.noise == pytest.approx(index(known), rel=1e-9)
        for i in known:
            less = index(known[known != i]) if len(known) > 1 else 0.0
            assert s.contribution[0, i] ** 2 == pytest.approx(index(known) - less, rel=1e-7, abs=1e-9)
        assert not s.contribution[0, gone].any()


def test_the_score_is_the_root_of_the_larger_statistic_over_its_limit() -> None:
    y = data(40, 3, seed=4)
    y[20:, :, 2] += 3.0
    y[5, 1] = np.nan
    y[30:, 0, 0] = np.nan
    d = judged(DETECTOR, y)
    s = DETECTOR.statistics(y.reshape(-1, 6))
    wanted = np.sqrt(np.maximum(s.t2 / DETECTOR.limit_t2, s.spe / DETECTOR.limit_spe)).reshape(40, 3)
    np.testing.assert_allclose(d.score, wanted, rtol=1e-9)
    assert d.score[5, 1] == 0.0 and not d.alarm[5, 1]
    np.testing.assert_allclose(d.measured[5, 1], DETECTOR.centre)  # all is missing: the mean
    assert np.all(d.alarm == (wanted > 1))


@pytest.mark.parametrize("rate", [0.2, 0.02])
def test_the_rate_of_false_alarms_is_at_most_the_one_asked_for(rate: float) -> None:
    detector = PrincipalComponents.fit(PLANT, data(2000, 2), rate, components=2)
    fresh = data(2000, 2, seed=5)
    s = detector.statistics(fresh.reshape(-1, 6))
    # an order statistic of 2000 samples at rate / 2: Beta distributed, and the number above it of 4000 fresh ones binomial
    law = betabinom(4000, rate / 2 * 2000, (1 - rate / 2) * 2000)
    for value, limit in ((s.t2, detector.limit_t2), (s.spe, detector.limit_spe)):
        assert law.ppf(0.001) <= np.sum(value > limit) <= law.ppf(0.999)
    both = betabinom(4000, rate * 2000, (1 - rate) * 2000)
    assert judged(detector, fresh).alarm.sum() <= both.ppf(0.999)


def test_one_and_several_faults_are_named_with_their_sizes() -> None:
    y = data(200, seed=6)
    faults = ([1], [3, 5], [0, 2])
    for sensors in faults:
        wrong = y.copy()
        wrong[:, sensors] += [8.0, -9.0][: len(sensors)]
        d = judged(DETECTOR, wrong)
        exact = np.all(d.isolated == np.isin(np.arange(6), sensors), axis=-1)
        # noise of 0.3: of six readings two causes and two faults are to be told, which leaves two
        assert exact.mean() > 0.9
        error = d.fault_size[exact][:, sensors] - [8.0, -9.0][: len(sensors)]
        sensitivity = np.linalg.inv(DETECTOR.precision[np.ix_(sensors, sensors)])
        sigma = DETECTOR.scale[sensors] * np.sqrt(np.diagonal(sensitivity))  # of a reading given the others
        assert np.all(np.abs(error) < 5 * sigma)
        np.testing.assert_allclose(d.measured[exact][:, sensors] + d.fault_size[exact][:, sensors], wrong[exact][:, sensors])


def test_none_is_named_where_no_reconstruction_explains_the_readings() -> None:
    y = data(50, seed=7) + np.array([20.0, -20.0, 20.0, -20.0, 20.0, -20.0])
    d = judged(replace(DETECTOR, max_faults=1), y)
    assert d.alarm.all() and not d.isolated.any() and np.isnan(d.fault_size).all()
    np.testing.assert_array_equal(d.measured, y)


def test_what_moves_together_is_learnt_from_an_operation_that_moves() -> None:
    """A flow 8 sigma wrong while the inflow swings it by 15: its limits hide it, its level tells it."""
    plant = two_tanks(swing=0.2)
    healthy = simulate(plant, 480, range(30), truth="model")
    fresh = simulate(plant, 480, [100])
    y = fresh.y[:, 0].copy()
    y[:, 2] += 8 * plant.sensor_sigma[2]
    limits = FixedLimits.fit(plant, healthy.y, 1e-2)
    d = run(limits, limits.init(), fresh.t, y, fresh.u)[1]
    assert np.mean(d.isolated[:, 2]) < 1 / 3  # the limits are 18 sigma, which 8 + 15 sin exceeds in 0.27 of a period
    detector = PrincipalComponents.fit(plant, healthy.y, 1e-2)
    assert len(detector.variances) == 2  # upper and lower tank: the lower one lags
    d = run(detector, detector.init(), fresh.t, y, fresh.u)[1]
    # the flow is told by the level's noise and its own, sqrt(1.25) sigma, and two tanks leave SPE two readings: 8 sigma are
    # beyond its limit by several sigma. Whether level or flow is wrong, their disagreement does not say.
    assert np.mean(d.alarm) > 0.99 and np.mean(d.isolated[:, [0, 2]].any(axis=-1)) > 0.95
    assert np.mean(d.isolated[:, 2]) > np.mean(d.isolated[:, 0]) > 0.1 and np.mean(d.isolated[:, [1, 3]]) < 0.05


def test_components_as_a_number_or_as_the_share_that_they_explain() -> None:
    y = data(500, 2)
    x = (y[::2].reshape(-1, 6) - y[::2].mean(axis=(0, 1))) / y[::2].std(axis=(0, 1))
    share = np.cumsum(np.linalg.eigvalsh(x.T @ x / len(x))[::-1]) / 6
    for k in (1, 2, 4):
        assert len(PrincipalComponents.fit(PLANT, y, 0.02, float(share[k - 1]) - 1e-6).variances) == k
        assert len(PrincipalComponents.fit(PLANT, y, 0.02, k).variances) == k
    assert len(PrincipalComponents.fit(PLANT, y, 0.02, 0.99999).variances) == 5  # one is left for SPE


def test_what_is_refused() -> None:
    y = data(100, 2)
    for arguments, message in (
        ((y, 1e-3), "100 healthy samples cannot set a limit that one in 2000 exceeds"),
        ((y, 1.5), "false_alarm is 1.5; a probability"),
        ((y, 0.1, 6), "components is 6; wanted fewer than the 6 sensors"),
        ((y, 0.1, 1.2), "components is 1.2; a probability strictly between 0 and 1"),
        ((y, 0.1, 0), "components is 0; wanted a whole number of at least 1"),
        ((y[:6, 0], 0.5), "3 complete samples of 6 sensors to train on"),
        ((np.ones((100, 2, 6)), 0.1), "no sensor ever moved in the healthy readings"),
        ((np.where(np.arange(6) == 2, np.nan, y), 0.1), "healthy readings of s2 are missing"),
        ((y[..., :5], 0.1), "wanted healthy readings"),
    ):
        with pytest.raises(ValueError, match=message):
            PrincipalComponents.fit(PLANT, *arguments)
    with pytest.raises(ValueError, match="principal components take at least 2"):
        PrincipalComponents.fit(chain(1), y[..., :1], 0.1)
    for change, message in (
        ({"scale": np.zeros(6)}, "scale is .*; wanted positive"),
        ({"noise": 0.0}, "noise is 0.0; wanted positive"),
        ({"limit_spe": float("nan")}, "limit_spe is nan; wanted positive"),
        ({"limit_t2": "1"}, "limit_t2 is '1'; wanted a number"),
        ({"centre": np.zeros(5)}, "centre has shape"),
        ({"components": DETECTOR.components[:, :5]}, r"components has shape \(2, 5\) for \(2,\) variances and 6 sensors"),
        ({"components": 2 * DETECTOR.components}, "not orthonormal"),
        ({"max_faults": 7}, "max_faults is 7; plant 'chain' has 6 sensors"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(DETECTOR, **change)


def test_a_sensor_that_never_moves_is_standardised_by_the_noise_that_it_declares() -> None:
    y = np.where(np.arange(6) == 2, 0.1 + 0.2, data(500, 2))
    model = PrincipalComponents.fit(PLANT, y, 0.02)
    assert model.scale[2] == PLANT.sensor_sigma[2] and model.centre[2] == 0.1 + 0.2
    fresh = np.where(np.arange(6) == 2, 0.1 + 0.2, data(500, 1, seed=9)[:, 0])
    t, u = PLANT.dt * np.arange(1, len(fresh) + 1), np.zeros((len(fresh), 0))
    quiet = run(model, model.init(), t, fresh, u)[1]
    # both statistics share .02; of 500 fresh samples, with limits from 500: at most 3 standard errors of both above it
    assert quiet.alarm.mean() <= 0.02 + 3 * np.sqrt(2 * 0.02 / 500)
    fresh[:, 2] += 20 * PLANT.sensor_sigma[2]
    moved = run(model, model.init(), t, fresh, u)[1]
    assert moved.alarm.all() and moved.isolated[:, 2].mean() > 0.9


def test_two_sensors_of_which_one_never_moves() -> None:
    plant = chain(2)
    y = np.random.default_rng(0).standard_normal((200, 1, 2)) * [1.0, 0.0]
    model = PrincipalComponents.fit(plant, y, 0.05, max_faults=1)
    assert model.noise == 1.0 and model.limit_spe == pytest.approx(chi2.isf(0.025, 1))
