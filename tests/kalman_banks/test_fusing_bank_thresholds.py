"""Thresholds from healthy data: exact quantiles, shared by quantity."""

from dataclasses import replace

import numpy as np
import pytest
from toy_plants import chain, readings, tanks

from fusion_sfdia.core.detector import run
from fusion_sfdia.filters.estimators import Extended
from fusion_sfdia.kalman_banks.fusing_bank import FusingBank


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
