"""Principal components: against scikit-learn, conditional means and least squares; what is isolated, at which rate alarms are
false, and what lags add.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import betabinom, chi2, norm
from sklearn.decomposition import PCA
from toy_plants import Array, chain

from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.detectors.data_driven.component_model import ComponentModel, complete_windows, marchenko_pastur_edge
from fusion_sfdia.detectors.data_driven.fixed_limits import FixedLimits
from fusion_sfdia.detectors.data_driven.pca import PrincipalComponents
from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.two_tanks.plant import two_tanks

NOISE = 0.3
PLANT = chain(6, sigma=NOISE)
RNG = np.random.default_rng(0)
MIX = RNG.normal(size=(2, 6))


def data(*shape: int, seed: int = 0) -> Array:
    """Readings of two common causes with noise."""
    rng = np.random.default_rng(seed)
    return np.asarray(10.0 + rng.standard_normal((*shape, 2)) @ MIX + NOISE * rng.standard_normal((*shape, 6)))


def moving(runs: int, steps: int, seed: int, *, white: bool = False) -> Array:
    """Six readings (K, B, 6) of independent AR(1) processes of variance 1, factor 0.95, or of white noise, with noise."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((steps, runs, 6))
    for k in range(1, steps):
        if not white:
            x[k] = 0.95 * x[k - 1] + np.sqrt(1 - 0.95**2) * x[k]
    return x + 0.1 * rng.standard_normal(x.shape)


DETECTOR = PrincipalComponents.fit(PLANT, data(2000, 2), 0.02)
LAGGED = PrincipalComponents.fit(PLANT, data(2000, 2), 0.02, lags=2)
MODEL = DETECTOR.model


def judged(detector: PrincipalComponents, y: Array) -> Decision:
    """Decisions on readings (K, ..., N)."""
    u = np.zeros((*y.shape[:-1], 0))
    return run(detector, detector.init(y.shape[1:-1]), np.arange(1.0, len(y) + 1), y, u)[1]


def test_the_model_is_scikit_learns() -> None:
    y = data(2000, 2)[::2].reshape(-1, 6)
    x = (y - y.mean(axis=0)) / NOISE
    oracle = PCA(2).fit(x)
    np.testing.assert_allclose(MODEL.precision, oracle.get_precision(), rtol=1e-9, atol=1e-9)
    t2, spe, _ = DETECTOR.statistics(MODEL.reconstruct(y[:50, :, None]))
    scores = oracle.transform(x[:50])
    np.testing.assert_allclose(t2, np.sum(scores**2 / oracle.explained_variance_, axis=-1), rtol=1e-9)
    np.testing.assert_allclose(spe, np.sum((x[:50] - oracle.inverse_transform(scores)) ** 2, axis=-1), rtol=1e-9)
    np.testing.assert_allclose(MODEL.present(MODEL.reconstruct(y[:50, :, None]).x), y[:50], rtol=1e-12)


@pytest.mark.parametrize(
    "gone", [[], [1], [0, 4], [0, 1, 2, 4, 5], [6, 7, 8], [1, 3, 4, 5, 17], [2, 5, 8, 11, 14, 17]], ids=str
)
def test_missing_readings_are_conditional_means_and_contributions_what_the_index_loses(gone: list[int]) -> None:
    """By the covariance S = P' Lambda P + noise (I - P' P): x_m = S_mo S_oo^-1 x_o, and index = x_o' S_oo^-1 x_o.

    Of static components and of windows of three readings; `gone` counts readings, those of a sensor side by side.
    """
    for model in (MODEL, LAGGED.model):
        w = model.lags + 1
        missing = [i for i in gone if i < 6 * w]
        cov = np.linalg.inv(model.precision)
        window = data(w, 1, seed=3).transpose(1, 2, 0).copy()
        z = ((window - model.centre[:, None]) / model.scale[:, None]).reshape(-1)

        def index(known: Array, cov: Array = cov, z: Array = z) -> float:
            """The least x' M x of all windows with these readings known."""
            return float(z[known] @ np.linalg.solve(cov[np.ix_(known, known)], z[known])) if known.size else 0.0

        known = np.setdiff1d(np.arange(6 * w), missing)
        window.reshape(-1)[missing] = np.nan
        found = model.reconstruct(window)
        mean = cov[np.ix_(missing, known)] @ np.linalg.solve(cov[np.ix_(known, known)], z[known])
        np.testing.assert_allclose(found.x[0, missing], mean, atol=1e-9)
        assert found.x[0] @ model.precision @ found.x[0] == pytest.approx(index(known), rel=1e-9)
        for i in range(6):
            others = known[known // w != i]
            if i * w in missing:
                assert found.contribution[0, i] == found.error[0, i] == 0
                continue
            assert found.contribution[0, i] ** 2 == pytest.approx(index(known) - index(others), rel=1e-7, abs=1e-9)
            expected = cov[i * w, others] @ np.linalg.solve(cov[np.ix_(others, others)], z[others])
            assert found.error[0, i] == pytest.approx(z[i * w] - expected, rel=1e-7, abs=1e-9)


def test_a_reconstruction_is_the_least_squares_fit_of_a_fault_in_one_sensor() -> None:
    """min over f of |W (x - E f)|^2, W'W = M, E the readings of the sensor in the window."""
    root = np.linalg.cholesky(LAGGED.model.precision).T
    window = data(3, 1, seed=4).transpose(1, 2, 0) + np.array([0.0, 2.0, 0.0, 0.0, 0.0, 0.0])[:, None]
    found = LAGGED.model.reconstruct(window)
    for i in range(6):
        columns = root[:, 3 * i : 3 * i + 3]
        fault, *_ = np.linalg.lstsq(columns, root @ found.x[0], rcond=None)
        assert found.error[0, i] == pytest.approx(fault[0], rel=1e-9)
        loss = found.x[0] @ LAGGED.model.precision @ found.x[0] - np.sum((root @ found.x[0] - columns @ fault) ** 2)
        assert found.contribution[0, i] ** 2 == pytest.approx(loss, rel=1e-9)


def test_noise_alone_has_no_components_and_what_rises_above_its_edge_has() -> None:
    """The largest eigenvalue of pure noise fluctuates about the edge by K^(-2/3); the next is below it by more than that.

    A spike of variance 1 + s is seen above the edge where s exceeds sqrt(D / K), at (1 + s)(1 + D / (K s)) (Baik and
    Silverstein 2006): of 20 readings and 1000 samples 0.14. Those of 0.5 and 3 are found, with that variance within 5 standard
    errors, sqrt(2 / K) of it, and that of 0.02 is not.
    """
    plant, rng = chain(20), np.random.default_rng(5)
    directions = np.linalg.qr(rng.standard_normal((20, 3)))[0]
    for seed in range(10):
        noise = np.random.default_rng(seed).standard_normal((2000, 20))
        for lags in (0, 2):
            assert ComponentModel.fit(plant, noise, lags)[0].variances.size <= 1
        spikes = (
            noise + (np.random.default_rng(seed + 50).standard_normal((2000, 3)) * np.sqrt([3.0, 0.5, 0.02])) @ directions.T
        )
        found = ComponentModel.fit(plant, spikes)[0].variances
        assert found.size == 2
        seen = np.array([(1 + s) * (1 + 20 / (1000 * s)) for s in (3.0, 0.5)])
        np.testing.assert_allclose(found, seen, rtol=5 * np.sqrt(2 / 1000))
    assert marchenko_pastur_edge(25, 100) == pytest.approx(2.25)


def test_no_reading_trains_the_model_and_sets_limits() -> None:
    y = np.arange(200.0)[:, None, None] * np.ones((1, 2, 6))
    for lags in (0, 1, 2):
        train, judge = (complete_windows(y, lags, half) for half in (0, 1))
        assert not np.intersect1d(train, judge).size
        np.testing.assert_array_equal(train[:, 0] - train[:, 0, :1], -np.arange(lags + 1.0) * np.ones((len(train), 1)))
        assert train.shape[1:] == judge.shape[1:] == (6, lags + 1)
    assert len(complete_windows(y, 0, 0)) == 200
    y[7, 0, 3] = np.nan  # a hole takes the windows it is in: three of the block that it is in
    assert len(complete_windows(y, 2, 0)) == len(train) - 3


def test_the_score_is_the_largest_of_the_statistics_over_their_limits() -> None:
    y = data(40, 3, seed=4)
    y[20:, :, 2] += 3.0
    y[5, 1] = np.nan
    y[30:, 0, 0] = np.nan
    d = judged(DETECTOR, y)
    t2, spe, contribution = DETECTOR.statistics(MODEL.reconstruct(y.reshape(-1, 6, 1)))
    ratios = [t2 / DETECTOR.limit_t2, spe / DETECTOR.limit_spe, (contribution / DETECTOR.limit_contribution) ** 2]
    assert set(np.argmax(ratios, axis=0)) == {0, 1, 2}
    expected = np.sqrt(np.max(ratios, axis=0)).reshape(40, 3)
    np.testing.assert_allclose(d.score, expected, rtol=1e-9)
    assert d.score[5, 1] == 0.0 and not d.alarm[5, 1]
    np.testing.assert_allclose(d.reconstruction[5, 1], MODEL.centre)  # all is missing: the mean
    assert np.all(d.alarm == (expected > 1))


def test_of_a_window_of_lags_the_score_is_of_the_present_and_the_readings_before_it() -> None:
    y = data(10, seed=8)
    d = judged(LAGGED, y)
    window = np.stack([y[2:], y[1:-1], y[:-2]], axis=-1)
    np.testing.assert_allclose(d.score[2:], LAGGED.excess(LAGGED.model.reconstruct(window)), rtol=1e-9)
    begun = np.full((1, 6, 3), np.nan)
    begun[0, :, :2] = y[1::-1].T
    np.testing.assert_allclose(d.score[1], LAGGED.excess(LAGGED.model.reconstruct(begun))[0], rtol=1e-9)


@pytest.mark.parametrize("rate", [0.2, 0.02])
def test_the_rate_of_false_alarms_is_at_most_the_one_asked_for(rate: float) -> None:
    detector = PrincipalComponents.fit(PLANT, data(2000, 2), rate)
    fresh = data(2000, 2, seed=5)
    t2, spe, contribution = detector.statistics(detector.model.reconstruct(fresh.reshape(-1, 6, 1)))
    # an order statistic of 2000 samples at rate / 3: Beta distributed, and the number above it of 4000 fresh ones binomial
    law = betabinom(4000, rate / 3 * 2000, (1 - rate / 3) * 2000)
    limits = (detector.limit_t2, detector.limit_spe, detector.limit_contribution)
    for value, limit in zip((t2, spe, contribution), limits, strict=True):
        assert law.ppf(0.001) <= np.sum(value > limit) <= law.ppf(0.999)
    both = betabinom(4000, rate * 2000, (1 - rate) * 2000)
    assert judged(detector, fresh).alarm.sum() <= both.ppf(0.999)


def test_without_components_squared_error_and_contributions_share_the_rate() -> None:
    """Of N standardised readings without any relation SPE is chi-square distributed, a contribution half-normally."""
    y = 10.0 + NOISE * np.random.default_rng(1).standard_normal((4000, 2, 6))
    detector = PrincipalComponents.fit(PLANT, y, 0.02, components=0)
    assert detector.limit_t2 == np.inf and not detector.model.variances.size
    law = betabinom(4000, 0.01 * 4000, 0.99 * 4000)  # a limit is an order statistic of 4000 samples
    assert law.ppf(0.001) <= 4000 * chi2(6).sf(detector.limit_spe / detector.model.noise) <= law.ppf(0.999)
    one = 2 * norm.sf(detector.limit_contribution)
    assert law.ppf(0.001) <= 4000 * (1 - (1 - one) ** 6) <= law.ppf(0.999)
    y[5, 0, 2] += 8 * NOISE
    d = judged(detector, y[:10])
    np.testing.assert_array_equal(d.isolated[5, 0], np.arange(6) == 2)


def test_lags_find_a_reading_that_no_longer_follows_its_own_past() -> None:
    """Six independent AR(1) processes of variance 1, factor 0.95. One becomes white: of its usual variance.

    Its change from one reading to the next grows from a variance of 2 (1 - 0.95) + 2 0.1^2 = 0.12 to 2.02. Present readings do
    not show that: static components alarm as falsely as ever.
    """
    plant = chain(6, sigma=0.1)
    healthy, fresh = moving(20, 400, seed=1), moving(20, 100, seed=2)
    fresh[:, :, 2] = moving(20, 100, seed=3, white=True)[:, :, 2]
    static = judged(PrincipalComponents.fit(plant, healthy, 0.01), fresh)
    lagged = judged(PrincipalComponents.fit(plant, healthy, 0.01, lags=2), fresh)
    # neighbours correlate over 40 samples: 4000 healthy ones count as some 200, and so do the 2000 judged
    assert np.mean(static.alarm) < betabinom(200, 2, 198).ppf(0.999) / 200
    # two changes of 4.1 healthy sigma each in 18 readings, whose limit is at chi-square 18 of 0.01 / 2, or 37
    assert np.mean(lagged.alarm[2:]) > 0.4
    isolated = np.mean(lagged.isolated[2:], axis=(0, 1))
    assert isolated[2] > 0.35 and np.all(np.delete(isolated, 2) < 0.05)


def test_a_fault_is_isolated_until_it_has_left_the_window() -> None:
    y = data(40, seed=9)
    y[20:25, 3] += 12.0
    d = judged(LAGGED, y)
    during = np.flatnonzero(d.isolated[:, 3])
    assert set(range(20, 27)) <= set(during)  # two lags
    assert not np.delete(d.isolated[20:27], 3, axis=-1).any() and len(set(during) - set(range(20, 27))) <= 1


def test_one_and_several_faults_are_isolated_with_their_sizes() -> None:
    y = data(200, seed=6)
    faults = ([1], [3, 5], [0, 2])
    for sensors in faults:
        wrong = y.copy()
        wrong[:, sensors] += [8.0, -9.0][: len(sensors)]
        d = judged(DETECTOR, wrong)
        exact = np.all(d.isolated == np.isin(np.arange(6), sensors), axis=-1)
        # noise of 0.3: of six readings two causes and two faults are to be distinguished, which leaves two
        assert exact.mean() > 0.9
        error = d.fault_size[exact][:, sensors] - [8.0, -9.0][: len(sensors)]
        sensitivity = np.linalg.inv(MODEL.precision[np.ix_(sensors, sensors)])
        sigma = MODEL.scale[sensors] * np.sqrt(np.diagonal(sensitivity))  # of a reading given the others
        assert np.all(np.abs(error) < 5 * sigma)
        np.testing.assert_allclose(
            d.reconstruction[exact][:, sensors] + d.fault_size[exact][:, sensors], wrong[exact][:, sensors]
        )


def test_none_is_isolated_where_no_reconstruction_explains_the_readings() -> None:
    y = data(50, seed=7) + np.array([20.0, -20.0, 20.0, -20.0, 20.0, -20.0])
    d = judged(replace(DETECTOR, max_faults=1), y)
    assert d.alarm.all() and not d.isolated.any() and np.isnan(d.fault_size).all()
    np.testing.assert_array_equal(d.reconstruction, y)


def test_what_moves_together_is_learnt_from_an_operation_that_moves() -> None:
    """A flow 8 sigma wrong while the inflow swings it by 15: its limits hide it, its level shows it."""
    plant = two_tanks(swing=0.2)
    healthy = simulate(plant, 480, range(30), truth="model")
    fresh = simulate(plant, 480, [100])
    y = fresh.y[:, 0].copy()
    y[:, 2] += 8 * plant.sensor_sigma[2]
    limits = FixedLimits.fit(plant, healthy.y, 1e-2)
    d = run(limits, limits.init(), fresh.t, y, fresh.u)[1]
    assert np.mean(d.isolated[:, 2]) < 1 / 3  # the limits are 18 sigma, which 8 + 15 sin exceeds in 0.27 of a period
    detector = PrincipalComponents.fit(plant, healthy.y, 1e-2)
    # upper and lower tank, of which the lower one lags; what flows curve by is a small third
    assert np.all(detector.model.variances[:2] > 50) and np.all(detector.model.variances[2:] < 1.2)
    d = run(detector, detector.init(), fresh.t, y, fresh.u)[1]
    # the flow is known up to the level's noise and its own, sqrt(1.25) sigma, and two tanks leave SPE two readings: 8 sigma are
    # beyond its limit by several sigma. Whether level or flow is wrong, their disagreement does not show.
    assert np.mean(d.alarm) > 0.99 and np.mean(d.isolated[:, [0, 2]].any(axis=-1)) > 0.95
    assert np.mean(d.isolated[:, 2]) > np.mean(d.isolated[:, 0]) > 0.1 and np.mean(d.isolated[:, [1, 3]]) < 0.05


def test_a_small_fault_is_detected_however_far_the_operation_moves() -> None:
    """Readings in units of their noise: movement 1000 times as large hides nothing that the sensors' relations show."""
    far = data(2000, 2) + 1000 * np.random.default_rng(1).standard_normal((2000, 2, 2)) @ MIX
    detector = PrincipalComponents.fit(PLANT, far, 0.02)
    assert detector.model.variances.size == 2
    y = data(100, seed=2) + 1000 * np.random.default_rng(3).standard_normal((100, 2)) @ MIX
    y[:, 1] += 10 * NOISE
    assert np.mean(judged(detector, y).isolated[:, 1]) > 0.9


def test_as_many_components_as_are_asked_for() -> None:
    for k in (0, 1, 4, 5):
        assert len(PrincipalComponents.fit(PLANT, data(500, 2), 0.02, components=k).model.variances) == k


@pytest.mark.parametrize("components", [None, 0])
def test_readings_without_any_noise_are_refused_with_the_cure(components: int | None) -> None:
    with pytest.raises(ValueError, match=r"the healthy readings .* vary in 0 components only.*use limits"):
        PrincipalComponents.fit(PLANT, np.full((500, 2, 6), 3.0), 0.02, components=components)


def test_what_is_refused() -> None:
    y = data(100, 2)
    for arguments, settings, message in (
        ((y, 1e-3), {}, "100 healthy samples cannot set a limit that one in 3000 exceeds"),
        ((y, 1.5), {}, "false_alarm is 1.5; expected a probability"),
        ((y, 0.1), {"components": 6}, "components is 6; expected fewer than the 6 readings of a window"),
        ((y, 0.1), {"components": -1}, "components is -1; expected a whole number of at least 0"),
        ((y, 0.1), {"max_faults": 0}, "max_faults is 0; expected a whole number"),
        ((y, 0.1), {"lags": -1}, "lags is -1; expected a whole number"),
        ((y[:6, 0], 0.5), {}, "3 complete samples of 6 readings to train on"),
        ((y[:40, 0], 0.5), {"lags": 2}, "complete samples of 18 readings to train on"),
        ((y[..., :5], 0.1), {}, "expected healthy readings"),
    ):
        with pytest.raises(ValueError, match=message):
            PrincipalComponents.fit(PLANT, *arguments, **settings)  # type: ignore[arg-type]
    with pytest.raises(NotApplicableError, match="has 1 sensor; principal components take at least 2"):
        PrincipalComponents.fit(chain(1), y[..., :1], 0.1)
    for change, message in (
        ({"scale": np.zeros(6)}, "scale is .*; expected positive"),
        ({"noise": 0.0}, "noise is 0.0; expected positive"),
        ({"centre": np.zeros(5)}, "centre has shape"),
        ({"components": MODEL.components[:, :5]}, r"components has shape \(2, 5\) for \(2,\) variances; expected \(k, 6\)"),
        ({"components": 2 * MODEL.components}, "not orthonormal"),
        ({"lags": 1}, r"components has shape \(2, 6\) for \(2,\) variances; expected \(k, 12\)"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(MODEL, **change)
    for change, message in (
        ({"limit_spe": float("nan")}, "limit_spe is nan; expected a positive"),
        ({"limit_t2": "1"}, "limit_t2 is '1'; expected a number"),
        ({"max_faults": 7}, "max_faults is 7; plant 'chain' has 6 sensors"),
        ({"model": None}, "model is None; expected a ComponentModel of plant 'chain'"),
        ({"plant": chain(6)}, "expected a ComponentModel of plant 'chain'"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(DETECTOR, **change)
