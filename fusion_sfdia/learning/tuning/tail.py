"""The threshold that healthy scores exceed at a stated rate: counted where the log has enough of them, else from their tail.

Scores s over a threshold s_0, taken as squares, q = s^2, follow a generalised Pareto distribution (Pickands 1975),

    P(q - u > y | q > u) = (1 + xi y / beta)^(-1 / xi),    q(p) = u + beta / xi ((p M / n)^-xi - 1)

for n of M scores above u = s_0^2. Squares of Gaussian residuals have xi = 0, which is the mean of the prior; the log moves it
by the probability-weighted moments of its n excesses (Hosking and Wallis 1987), in as far as they determine it.
Scores above a threshold come in clusters, which count once in every interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from fusion_sfdia.common.order_statistics import order_statistic
from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.common.rate import Rate

Array = NDArray[Any]

COUNTED = 20.0  # expected scores above a threshold that is counted: its rate is known to a fifth
REACH = 30.0  # a tail is followed to a rate of one in so many times the samples
SHARE, LEAST = 0.05, 50  # of the scores are the tail, at least so many
APART = 15  # samples without one that end a cluster: the memory of the windowed detectors
SHAPE_SD = 0.2  # standard deviation of the prior of xi, our choice
DRAWS = 4000  # for intervals


class Threshold(NamedTuple):
    """The scale of the thresholds for a rate, with its 95 % interval low to high.

    counted: whether it is a counted order statistic, or extrapolated by the tail, whose xi is shape (0 where counted).
    expected: number of scores above it in the log.
    """

    scale: float
    low: float
    high: float
    counted: bool
    shape: float
    expected: float


class AlarmCount(NamedTuple):
    """Samples in alarm of so many, the alarms that they form, and the rate per sample with its 95 % interval."""

    above: int
    alarms: int
    samples: int
    rate: float
    low: float
    high: float


def threshold(scores: Sequence[Array], rate: float) -> Threshold:
    """The threshold that a healthy score exceeds at a rate, from scores (K, R) of stretches of R runs each.

    The caller makes sure that they are enough, see `shortest`.
    """
    every = np.concatenate([s.ravel() for s in scores])
    expected = rate * every.size
    if expected >= COUNTED:
        scale = float(order_statistic(every, rate))
        spread = 1.96 * np.sqrt(_cluster(scores, scale) / expected)
        ends = [order_statistic(every, min(rate * (1 + s * spread), 0.5)) for s in (1, -1)]
        return Threshold(scale, float(ends[0]), float(ends[1]), True, 0.0, expected)
    n = min(max(LEAST, int(SHARE * every.size)), every.size // 2)
    u = float(np.partition(every, every.size - n - 1)[every.size - n - 1]) ** 2
    excess = np.sort(every[every**2 > u] ** 2 - u)
    n = excess.size
    independent = n / _cluster(scores, np.sqrt(u))
    mean = float(np.mean(excess))
    weighted = float(np.mean(excess * (1 - (np.arange(1, n + 1) - 0.35) / n)))
    raw = 2 - mean / (mean - 2 * weighted)
    known = SHAPE_SD**2 / (SHAPE_SD**2 + 4 / 3 / independent)  # 4 / (3 n): variance of that estimate where xi = 0
    shape = known * raw
    rng = stream(0, "tail of scores")
    shapes = shape + SHAPE_SD * np.sqrt(1 - known) * rng.standard_normal(DRAWS)
    means = mean * (1 + rng.standard_normal(DRAWS) / np.sqrt(independent))
    low, high = np.quantile(_quantile(u, shapes, means, expected / n), [0.025, 0.975])
    scale = float(np.sqrt(_quantile(u, np.array(shape), np.array(mean), expected / n)))
    return Threshold(scale, float(np.sqrt(max(low, u))), float(np.sqrt(high)), False, shape, expected)


def shortest(rate: float) -> int:
    """The fewest healthy samples from which a threshold of that rate may be set."""
    return int(np.ceil(max(4 * LEAST, 1 / (REACH * rate)) * (1 - 1e-9)))


def counted(scores: Sequence[Array], scale: float | Sequence[float]) -> AlarmCount:
    """Count the scores (K, R) of stretches above a threshold, or above one of each."""
    scales = [scale] * len(scores) if isinstance(scale, float) else list(scale)
    above = sum(int(np.sum(s > c)) for s, c in zip(scores, scales, strict=True))
    alarms = sum(_alarms(s > c) for s, c in zip(scores, scales, strict=True))
    samples = sum(s.size for s in scores)
    each = above / max(alarms, 1) if alarms else 1.0
    low = chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0
    high = chi2.ppf(0.975, 2 * alarms + 2) / 2
    return AlarmCount(above, alarms, samples, above / samples, float(low * each / samples), float(high * each / samples))


def threshold_figures(limit: Threshold, count: AlarmCount, rate: Rate, dt: float) -> dict[str, Any]:
    """A threshold and what was counted above it as plain numbers, rates as the stated one."""
    return {
        "threshold": "counted" if limit.counted else "extrapolated by a generalised Pareto tail",
        "threshold_interval": [limit.low, limit.high],
        "expected_above": limit.expected,
        "tail_shape": limit.shape,
        "achieved": {
            "rate": str(rate.same(count.rate, dt)) if count.rate else "0",
            "low": str(rate.same(count.low, dt)) if count.low else "0",
            "high": str(rate.same(count.high, dt)),
            "samples_above": count.above,
            "alarms": count.alarms,
        },
    }


def _quantile(u: float, shape: Array, mean: Array, share: float) -> Array:
    """The q that a share of the excesses of that mean = beta / (1 - xi) exceeds."""
    safe = np.where(np.abs(shape) < 1e-9, 1e-9, shape)
    return np.asarray(u + mean * (1 - safe) * np.expm1(-safe * np.log(share)) / safe)


def _cluster(scores: Sequence[Array], scale: float) -> float:
    """The mean number of scores above a threshold in a cluster of them."""
    above = sum(int(np.sum(s > scale)) for s in scores)
    return above / max(sum(_alarms(s > scale) for s in scores), 1) if above else 1.0


def _alarms(above: Array) -> int:
    """The number of clusters in above (K, R): spans that are at least APART samples without one apart."""
    found = 0
    for run in above.T:
        at = np.flatnonzero(run)
        found += int(at.size > 0) + int(np.sum(np.diff(at) > APART))
    return found
