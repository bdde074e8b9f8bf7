"""Thresholds from healthy data: exact quantiles, shared by quantity."""

from dataclasses import replace

import numpy as np
import pytest
from toy_plants import chain, readings, tanks

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.filters.estimators import Extended, Unscented


def test_each_quantity_takes_its_share_of_the_data_above_its_threshold() -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 120, 10, seed=0)
    bank = FusingBank(plant, Extended()).fit_thresholds((t, y, u), false_alarm=0.05, warm_up=20)
    assert bank.thresholds is not None and all(isinstance(v, float) for v in bank.thresholds)
    assert bank.thresholds[0] == bank.thresholds[1] and bank.thresholds[2] == bank.thresholds[3]
    bank = replace(bank, accommodate=False)
    _, d = run(bank, bank.init((10,)), t, y, u)
    for members in plant.quantities.values():
        above = np.any(d.scores[20:][..., members] > 1, axis=-1)
        # a quantile of 1000 numbers leaves .025 x 999 of them above it, to the next whole number
        assert 24 <= above.sum() <= 26
    assert d.alarm[20:].mean() <= 0.05 + 2 / 1000


def test_the_thresholds_scale_with_the_noise_and_one_run_is_enough() -> None:
    t, _, y, u = readings(chain(4, sigma=1.0), 150, 4, seed=1)
    one = FusingBank.fit(chain(4, sigma=1.0), (t, y, u), 0.1, estimator=Extended())
    ten = FusingBank.fit(chain(4, sigma=10.0), (t, 10 * y, u), 0.1, estimator=Extended())
    np.testing.assert_allclose(ten.thresholds, 10 * np.array(one.thresholds), rtol=1e-9)
    single = FusingBank.fit(chain(4), (t, y[:, 0], u[:, 0]), 0.1, estimator=Extended())
    assert single.thresholds is not None and all(v > 0 for v in single.thresholds)


def test_present_thresholds_and_missing_readings_have_no_effect() -> None:
    plant = chain(4)
    t, _, y, u = readings(plant, 150, 4, seed=2)
    y = np.where(np.random.default_rng(0).random(y.shape) < 0.05, np.nan, y)
    bank = FusingBank(plant, Extended())
    fresh = bank.fit_thresholds((t, y, u), 0.1)
    again = replace(bank, thresholds=(1e-6,) * 4, threshold_scale=3.0).fit_thresholds((t, y, u), 0.1)
    assert fresh == again and np.all(np.isfinite(fresh.thresholds or ()))


@pytest.mark.parametrize("false_alarm", [0.0, 1.0, -0.5, float("nan")])
def test_a_rate_is_a_probability(false_alarm: float) -> None:
    t, _, y, u = readings(chain(4), 30, 1, seed=0)
    with pytest.raises(ValueError, match="expected a probability strictly between 0 and 1"):
        FusingBank.fit(chain(4), (t, y, u), false_alarm, estimator=Extended())


def test_the_error_for_too_few_samples_states_the_expected_number() -> None:
    t, _, y, u = readings(chain(4), 30, 2, seed=0)
    bank = FusingBank(chain(4), Extended())
    with pytest.raises(ValueError, match=r"20 healthy samples cannot set a false-alarm rate of 0\.1 over 4 .*at least 40"):
        bank.fit_thresholds((t, y, u), 0.1)
    with pytest.raises(ValueError, match="0 healthy samples"):
        bank.fit_thresholds((t, y, u), 0.1, warm_up=30)
    t, _, y, u = readings(chain(4), 40, 2, seed=0)
    with pytest.raises(ValueError, match="38 healthy samples"):
        bank.fit_thresholds((t[:39], y[:39], u[:39]), 0.1)
    # exactly the number that the message asks for is enough: the threshold is then the largest of them
    enough = replace(bank.fit_thresholds((t, y, u), 0.1), accommodate=False)
    _, d = run(enough, enough.init((2,)), t, y, u)
    np.testing.assert_array_equal(d.scores[20:].max(axis=(0, 1)), np.ones(4))


@pytest.mark.parametrize("missing", [0.0, 0.5])
def test_adaptive_thresholds_are_in_units_of_the_root_mean_square_residual(missing: float) -> None:
    """From the start on, with and without gaps: the filter's model is the truth, so its innovations have covariance S."""
    plant, runs = chain(4, sensors=6), 800
    t, _, y, u = readings(plant, 15, runs, seed=5)
    gone = np.random.default_rng(1).random(y.shape[::2]) < missing  # the same in all runs
    y = np.where(gone[:, None], np.nan, y)
    bank = FusingBank(plant, Extended(), thresholds=(1.0,) * 6, adaptive=True, accommodate=False)
    _, d = run(bank, bank.init((runs,)), t, y, u)
    expected = d.threshold[:, 0]
    np.testing.assert_array_equal(d.threshold, np.broadcast_to(expected[:, None], d.threshold.shape))
    ratio = np.mean(d.residual**2, axis=1)[~gone] / expected[~gone] ** 2
    # a weighted sum of at most 4 chi-squares: its standard deviation is at most sqrt(2) of its mean
    error = np.sqrt(2 / runs)
    assert np.all(np.abs(ratio - 1) < 4.5 * error) and np.abs(ratio.mean() - 1) < error


def test_adaptive_thresholds_keep_their_rate_with_missing_readings_and_constant_ones_do_not() -> None:
    plant, rate = chain(6), 0.01
    t, _, y, u = readings(plant, 400, 20, seed=6)
    constant = FusingBank.fit(plant, (t, y, u), rate, estimator=Extended())
    adaptive = FusingBank.fit(plant, (t, y, u), rate, estimator=Extended(), adaptive=True)
    t, _, y, u = readings(plant, 400, 20, seed=7)
    y = np.where(np.random.default_rng(2).random(y.shape) < 0.6, np.nan, y)
    found = [run(bank, bank.init((20,)), t, y, u)[1].alarm[20:].mean() for bank in (constant, adaptive)]
    # alarms that follow each other count as one in three: the states forget in some 3 samples
    error = np.sqrt(3 * rate / (380 * 20))
    assert found[1] < rate + 3 * error and found[0] > 2 * rate


def test_adaptive_thresholds_are_the_same_literally_and_of_printed_unscented_filters() -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 20, 1, seed=3)
    for estimator in (Extended(), Unscented(redraw=False)):
        fast = FusingBank(plant, estimator, thresholds=(2.0,) * 4, adaptive=True)
        slow = replace(fast, literal=True)
        (_, a), (_, b) = (run(bank, bank.init(), t, y[:, 0], u[:, 0]) for bank in (fast, slow))
        np.testing.assert_allclose(a.threshold, b.threshold, rtol=1e-6)  # of covariances that differ by rounding times 1e6
    with pytest.raises(ValueError, match="adaptive thresholds are for equal beta"):
        FusingBank(plant, Extended(), beta=(0.4, 0.2, 0.2, 0.2), adaptive=True)
