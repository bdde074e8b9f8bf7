"""Thresholds from healthy scores: counted, extrapolated, and how often they are exceeded."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from fusion_sfdia.common.order_statistics import order_statistic
from fusion_sfdia.learning.tuning.tail import COUNTED, REACH, counted, shortest, threshold

SENSORS = 8


def scores(samples: int, seed: int) -> np.ndarray:
    """The largest of eight normal residuals (samples, 1)."""
    return np.abs(np.random.default_rng(seed).standard_normal((samples, 1, SENSORS))).max(axis=-1)


def exact(rate: float) -> float:
    return float(norm.isf((1 - (1 - rate) ** (1 / SENSORS)) / 2))


def test_a_rate_that_the_log_holds_is_counted() -> None:
    found = threshold([scores(4000, 0), scores(4000, 1)], 0.01)
    assert found.counted and found.expected == 80
    assert found.scale == order_statistic(np.concatenate([scores(4000, 0), scores(4000, 1)]).ravel(), 0.01)
    assert found.low < exact(0.01) < found.high


@pytest.mark.parametrize(("samples", "rate"), [(2000, 1e-3), (1000, 1e-4), (400, 1e-3)])
def test_the_interval_of_an_extrapolated_threshold_holds_the_exact_one(samples: int, rate: float) -> None:
    found = [threshold([scores(samples, seed)], rate) for seed in range(40)]
    assert not any(f.counted for f in found)
    held = sum(f.low < exact(rate) < f.high for f in found)
    assert held >= 33  # binomial with 40 trials of .95: less with a probability of 1e-3
    rates = [2 * SENSORS * norm.sf(f.scale) for f in found]
    assert rate / 2 < np.median(rates) < 2 * rate


def test_a_heavy_tail_is_seen_where_the_log_is_long_enough() -> None:
    light, heavy = scores(20000, 0), np.abs(np.random.default_rng(0).standard_t(4, (20000, 1)))
    assert abs(threshold([light], 1e-4).shape) < 0.1
    found = threshold([heavy], 1e-4)
    assert found.shape > 0.3  # squares of Student's t with 4 degrees of freedom: 2 / 4


def test_clusters_widen_the_interval() -> None:
    one = scores(6000, 3)
    lasting = np.repeat(one[:600], 10, axis=0)
    alone, together = threshold([one], 1e-3), threshold([lasting], 1e-3)
    assert np.log(together.high / together.low) > 1.5 * np.log(alone.high / alone.low)


def test_exceedances_are_counted_with_their_interval() -> None:
    score = np.zeros((1000, 2))
    score[[10, 11, 12, 40], 0] = 2.0  # two alarms: the second begins more than 15 samples later
    score[[500, 510], 1] = 2.0  # one
    found = counted([score[:400], score[400:]], 1.0)
    assert (found.above, found.alarms, found.samples) == (6, 3, 2000)
    assert found.rate == 6 / 2000
    # Poisson limits of 3 alarms, .6187 and 8.7673 (tables of Garwood 1936), of two samples each
    np.testing.assert_allclose((found.low, found.high), (0.6187 * 2 / 2000, 8.7673 * 2 / 2000), rtol=1e-4)
    assert counted([score], [5.0]).low == 0


def test_the_shortest_log() -> None:
    assert shortest(1e-5) == round(1e5 / REACH + 0.5)
    assert shortest(0.1) == 200
    assert COUNTED > 1
