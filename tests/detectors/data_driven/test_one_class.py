"""One-class support vector machine: against scikit-learn's decisions, its rate of false alarms, what is isolated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import betabinom
from sklearn.svm import OneClassSVM
from toy_plants import Array, chain

from fusion_sfdia.detectors.data_driven import one_class
from fusion_sfdia.detectors.data_driven.component_model import complete_windows
from fusion_sfdia.detectors.data_driven.one_class import OneClass, whitening
from fusion_sfdia.detectors.detector import Decision, run

PLANT = chain(6, sigma=0.3)
MIX = np.random.default_rng(0).normal(size=(2, 6))


def data(*shape: int, seed: int = 0) -> Array:
    """Readings of two common causes with noise."""
    rng = np.random.default_rng(seed)
    return np.asarray(10.0 + rng.standard_normal((*shape, 2)) @ MIX + 0.3 * rng.standard_normal((*shape, 6)))


DETECTOR = OneClass.fit(PLANT, data(1000, 2), 0.02)
MODEL = DETECTOR.model


def judged(detector: OneClass, y: Array) -> Decision:
    """Decisions on readings (K, ..., N)."""
    u = np.zeros((*y.shape[:-1], 0))
    return run(detector, detector.init(y.shape[1:-1]), np.arange(1.0, len(y) + 1), y, u)[1]


def test_the_statistic_is_scikit_learns_decision_on_whitened_readings() -> None:
    """decision = sum_j a_j K - rho and p = sum_j a_j K / sum_j a_j; the machine's weights differ by its tolerance."""
    y = data(1000, 2)
    root = whitening(MODEL)
    np.testing.assert_allclose(root @ root, MODEL.precision, rtol=1e-9, atol=1e-12)
    w = ((complete_windows(y[:, :, :], 0, 0)[..., 0] - MODEL.centre) / MODEL.scale) @ root
    np.testing.assert_allclose(np.cov(w.T), np.eye(6), atol=0.2)  # noise left out is 1 on average
    oracle = OneClassSVM(gamma=1 / 6, nu=0.1, tol=1e-6).fit(w)
    fresh = np.concatenate([data(200, seed=1), data(200, seed=2) + 2.0])
    x = (fresh - MODEL.centre) / MODEL.scale
    p = np.exp(-DETECTOR.statistic(x)) * DETECTOR.weights.sum()
    np.testing.assert_allclose(p, oracle.decision_function(x @ root) + oracle.offset_[0], rtol=1e-4, atol=1e-6)
    assert np.mean(oracle.predict(w) < 0) == pytest.approx(0.1, abs=0.02)


def test_the_score_grows_without_end() -> None:
    """Where the kernel is below the smallest number: 1e6 sigma off."""
    y = 10.0 + np.array([0.0, 10.0, 100.0, 1e4, 1e6])[:, None] * np.array([1.0, -1.0, 1.0, 0.0, 0.0, 0.0])
    score = judged(DETECTOR, y).score
    assert np.all(np.isfinite(score)) and np.all(np.diff(score) > 0)


@pytest.mark.parametrize("rate", [0.1, 0.02])
def test_the_rate_of_false_alarms_is_the_one_asked_for(rate: float) -> None:
    detector = OneClass.fit(PLANT, data(1000, 2), rate)
    # an order statistic of 1000 samples at that rate: Beta distributed, and the number above it of 4000 fresh ones binomial
    law = betabinom(4000, rate * 1000, (1 - rate) * 1000)
    assert law.ppf(0.001) <= judged(detector, data(2000, 2, seed=5)).alarm.sum() <= law.ppf(0.999)


def test_one_and_two_faults_are_isolated_and_replaced() -> None:
    y = data(200, seed=6)
    for sensors in ([1], [3, 5]):
        wrong = y.copy()
        wrong[:, sensors] += [8.0, -9.0][: len(sensors)]
        d = judged(DETECTOR, wrong)
        exact = np.all(d.isolated == np.isin(np.arange(6), sensors), axis=-1)
        assert exact.mean() > 0.9
        # what replaces a reading errs by the noise of four or five others: by 1 where two causes move readings by 1 each
        assert np.sqrt(np.mean((d.reconstruction - y)[exact][:, sensors] ** 2)) < 1.0
        np.testing.assert_allclose(
            d.reconstruction[exact][:, sensors] + d.fault_size[exact][:, sensors], wrong[exact][:, sensors]
        )


def test_more_samples_than_a_machine_is_trained_on_are_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(one_class, "TRAINED_ON", 200)
    detector = OneClass.fit(PLANT, data(1000, 2), 0.02, outliers=0.99)  # nearly all support vectors
    assert 150 <= len(detector.weights) <= 200


def test_what_is_refused() -> None:
    y = data(100, 2)
    for arguments, settings, message in (
        ((y, 1e-3), {}, "100 healthy samples cannot set a limit that one in 1000 exceeds"),
        ((y, 0.0), {}, "false_alarm is 0.0; expected a probability"),
        ((y, 0.1), {"outliers": 1.0}, "outliers is 1.0; expected a probability strictly between 0 and 1"),
    ):
        with pytest.raises(ValueError, match=message):
            OneClass.fit(PLANT, *arguments, **settings)
    for change, message in (
        ({"support": np.ones((3, 5))}, r"support has shape \(3, 5\) for .* weights; expected \(S, 6\) and \(S,\)"),
        ({"weights": -DETECTOR.weights}, "weights is .*; expected positive numbers; use OneClass.fit"),
        ({"limit": 0.0}, "limit is 0.0; expected positive"),
        ({"limit": None}, "limit is None; expected a number"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(DETECTOR, **change)
