"""Limits with a moving average: checked by hand, their false-alarm rate, and delays of small biases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom
from toy_plants import Array, chain, tanks

from fusion_sfdia.detectors.data_driven.ewma_limits import EwmaLimits, averaged, growth
from fusion_sfdia.detectors.data_driven.fixed_limits import FixedLimits
from fusion_sfdia.detectors.detector import Decision, run

PLANT = tanks()
SIGMA = PLANT.sensor_sigma
CENTRE = np.array([1.0, 1.0, 6e-4, 6e-4])
DETECTOR = EwmaLimits(PLANT, CENTRE, 4 * SIGMA, 6 * SIGMA, 1.2 * SIGMA)


def judged(detector: EwmaLimits | FixedLimits, y: Array) -> Decision:
    """Decisions on readings (K, ..., N)."""
    t, u = detector.plant.dt * np.arange(1, len(y) + 1), detector.plant.input_at(0.0)
    return run(detector, detector.init(y.shape[1:-1]), t, y, np.broadcast_to(u, (*y.shape[:-1], u.size)))[1]


def test_by_hand() -> None:
    """In sigma of l1: limits of 4 about the centre, 6 between readings, and 1.2 of the average, weight 0.2."""
    readings = np.array([1.0, 2.0, np.nan, 2.0, 9.0, 0.0, 0.0])
    y = np.tile(CENTRE, (7, 1))
    y[:, 0] += SIGMA[0] * readings
    d = judged(DETECTOR, y)
    average = []
    z = 0.0
    for n, e in enumerate([1.0, 2.0, 2.0, 4.0, 0.0, 0.0], start=1):  # the missing one left out, 9 as its limit
        z = 0.8 * z + 0.2 * e
        average.append(z / (1.2 * np.sqrt(1 - 0.8 ** (2 * n))))
    # levels over 4 and changes over 6, none after the missing reading
    expected = [max(1 / 4, average[0]), max(2 / 4, average[1]), 0, max(2 / 4, average[2]), 9 / 4, 9 / 6, average[5]]
    np.testing.assert_allclose(d.scores[:, 0], expected, rtol=1e-12)
    np.testing.assert_array_equal(d.isolated[:, 0], np.array(expected) > 1)
    assert average[5] < 1 < average[4] and d.residual[5, 0] == pytest.approx(-9 * SIGMA[0])
    np.testing.assert_allclose(d.reconstruction[4, 0], CENTRE[0] + 2 * SIGMA[0])  # the last that was within the limits
    assert d.fault_size[4, 0] == pytest.approx(7 * SIGMA[0])
    assert not d.isolated[:, 1:].any() and np.all(d.scores[:, 1:] < 1e-9)


def test_the_average_has_the_variance_of_lucas_and_saccucci() -> None:
    """Var z_n = sigma^2 weight / (2 - weight) (1 - (1 - weight)^(2n)), within 4 standard errors, sqrt(2 / runs) of it."""
    e = np.random.default_rng(0).standard_normal((30, 20_000))
    z, n = np.zeros(20_000), np.zeros(20_000)
    for now in e:
        z, n = averaged(z, n, now, 0.2)
        expected = 0.2 / 1.8 * (1 - 0.8 ** (2 * n[0]))
        assert np.mean(z**2) == pytest.approx(expected, rel=4 * np.sqrt(2 / 20_000))
        assert growth(n, 0.2)[0] ** 2 * 0.2 / 1.8 == pytest.approx(expected, rel=1e-12)


def test_limits_and_rate_of_gaussian_readings() -> None:
    """Level and change of all six sensors share two thirds of the rate, the averages have the last third."""
    plant = chain(6)
    rng = np.random.default_rng(1)
    detector = EwmaLimits.fit(plant, rng.standard_normal((400, 100, 6)), 0.05)
    fresh = rng.standard_normal((220, 100, 6))
    # limits are set by 20 000 samples and tried on as many; those of an average count as 1/9, (2 - weight) / weight
    for off, share, samples in (("average", 0.1 / 3, 20_000), ("level change", 0.05 / 3, 20_000 / 9)):
        alone = replace(detector, **dict.fromkeys(off.split(), np.full(6, 1e9)))
        rate = np.mean(judged(alone, fresh).alarm[20:])
        assert abs(rate / share - 1) < 4 * np.sqrt(2 / (share * samples)), rate / share
    # Bonferroni: at most the rate
    assert np.mean(judged(detector, fresh).alarm[20:]) <= binom(2000, 0.05).ppf(0.999) / 2000


def test_a_small_lasting_bias_is_detected_where_fixed_limits_are_not_crossed() -> None:
    """1.5 sigma: 4.5 deviations of the average, of 1/3 sigma each; single readings stay within limits of some 4 sigma."""
    plant = chain(6)
    rng = np.random.default_rng(2)
    healthy, y = rng.standard_normal((400, 100, 6)), rng.standard_normal((60, 200, 6))
    y[20:, :, 2] += 1.5
    averages, limits = judged(EwmaLimits.fit(plant, healthy, 0.01), y), judged(FixedLimits.fit(plant, healthy, 0.01), y)
    assert np.mean(averages.isolated[40:, :, 2]) > 0.7 > 0.1 > np.mean(limits.isolated[40:, :, 2])
    assert np.mean(averages.isolated[40:][..., [0, 1, 3, 4, 5]]) < 0.01


def test_a_large_fault_that_is_over_is_soon_forgotten() -> None:
    """100 sigma enter as the 4 of the limit: the average is at most 4 and within 1.2 after ln(4 / 1.2) / ln(1 / 0.8) < 6."""
    y = np.tile(CENTRE, (40, 1))
    y[5:25, 1] += 100 * SIGMA[1]
    isolated = judged(DETECTOR, y).isolated[:, 1]
    assert isolated[5:25].all() and isolated[25] and not isolated[31:].any()


def test_missing_readings_in_the_healthy_data_are_left_out() -> None:
    plant, rng = chain(6), np.random.default_rng(3)
    y = rng.standard_normal((400, 20, 6))
    holes = np.where(rng.random(y.shape) < 0.1, np.nan, y)
    whole, part = EwmaLimits.fit(plant, y, 0.05), EwmaLimits.fit(plant, holes, 0.05)
    for what in ("level", "change", "average"):
        # order statistics with 11 above them, of readings most of which are the same
        np.testing.assert_allclose(getattr(part, what), getattr(whole, what), rtol=0.25)


def test_what_is_refused() -> None:
    y = np.random.default_rng(4).standard_normal((100, 2, 4))
    for arguments, settings, message in (
        ((y[..., :3], 0.1), {}, r"y has shape \(100, 2, 3\)"),
        ((y, 1e-3), {}, "100 healthy samples cannot set a limit that one in 1500 exceeds"),
        ((y, 0), {}, "false_alarm is 0; expected a probability"),
        ((y, 0.1), {"weight": 1.0}, "weight is 1.0; expected the share of the present reading, above 0 and below 1"),
        ((y, 0.1), {"weight": "0.2"}, "weight is '0.2'; expected a number"),
    ):
        with pytest.raises(ValueError, match=message):
            EwmaLimits.fit(PLANT, *arguments, **settings)  # type: ignore[arg-type]
    for change, message in (
        ({"centre": np.ones(3)}, r"centre has shape \(3,\)"),
        ({"average": np.zeros(4)}, "average has limits of 0 and more; expected positive ones; use EwmaLimits.fit"),
        ({"weight": 0.0}, "weight is 0.0; expected the share"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(DETECTOR, **change)
