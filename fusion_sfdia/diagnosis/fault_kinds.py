"""What kind of fault a sensor has, and how large it is, from its residuals: reading less what the other sensors predict.

With z the residuals over their standard deviation without a fault, x from 0 to 1 over the event, e standard normal noise:

    bias     z = b + s e
    drift    z = a + c min(x / rise, 1) + s e
    noise    z = l e
    spikes   z = e, but at a share of the samples l e, or a jump to +-m

A kind is chosen by the Bayesian information criterion, log L - k/2 ln n (Schwarz 1978), which gives the probabilities of
the others, too. Readings that repeat their value are frozen; readings that are missing are a dropout.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.slow_noise import inflation_of

Array = NDArray[Any]

KINDS = ("bias", "drift", "freeze", "noise", "spikes", "dropout")
QUIET = 2.5  # standard deviations: the end of a fault is its last residual above
RISES = tuple(np.linspace(1.0, 0.2, 33).tolist())  # of an event, in which a drift reaches its size
CHANGE = 0.3  # of the largest size: what changes less is a bias
EQUAL = 0.8  # share of successive readings that are equal, of a frozen sensor
SURE = 4.0  # standard errors of a mean or change, as noise has a mean, too
FEW = 2  # samples: what is over after them is a spike
POSSIBLE = 0.05  # probability above which another kind is reported
NORMAL = 1.96  # standard deviations of a 95 % interval
STEADIEST = 0.95  # largest autocorrelation that is believed


class Named(NamedTuple):
    """The kind of a fault, its size with a 95 % interval, in the unit of the sensor, and other kinds that it may be.

    size: of a bias the mean residual, of a drift the deviation that it has reached at the end, of noise the added standard
    deviation, of spikes their mean height, without a sign where they have both, of a freeze the largest deviation. NaN where
    unknown, and of a dropout.
    """

    kind: str
    size: float
    low: float
    high: float
    alternatives: tuple[str, ...] = ()


class NoiseOf(NamedTuple):
    """The noise of one sensor: its standard deviation, and its slow part, see `Plant.slow_noise`, of that sensor alone (1,)."""

    sigma: float
    slow: tuple[Array, Array] = (np.zeros(1), np.zeros(1))


def noise_of(plant: Plant, i: int) -> NoiseOf:
    """The noise of the i-th sensor of a plant."""
    share, kept = plant.slow_noise
    return NoiseOf(float(plant.sensor_sigma[i]), (share[i : i + 1], kept[i : i + 1]))


def resized(named: Named, error: Array, sd: Array, noise: NoiseOf) -> Named:
    """A fault named over several events with the size of one of them: of spikes their height there, else as it was."""
    with np.errstate(invalid="ignore"):
        loud = np.abs(error) > QUIET * sd
    if named.kind != "spikes" or not np.any(loud):
        return named
    size, low, high = _size("spikes", error[loud], sd[loud], noise, [], 0.0)
    return named._replace(size=size, low=low, high=high)


def name(error: Array, sd: Array, noise: NoiseOf, y: Array, *, still: bool, over: bool) -> Named:
    """Name the fault of one sensor over an event of K samples.

    error, sd (K,): residual and its standard deviation without a fault, NaN where unknown; noise: of the sensor;
    y (K,): the readings, NaN where missing. still: whether its readings repeat their value when it is healthy. over: whether
    the fault has ended.
    """
    if np.mean(np.isfinite(y)) < 0.5:
        return Named("dropout", np.nan, np.nan, np.nan)
    known = np.isfinite(error) & np.isfinite(sd)
    e, s, x = error[known], sd[known], np.flatnonzero(known).astype(float)
    if not e.size:
        return Named("", np.nan, np.nan, np.nan)
    z = e / s
    loud = np.flatnonzero(np.abs(z) > QUIET)
    last = int(loud[-1]) + 1 if loud.size else z.size
    e, s, x, z = e[:last], s[:last], x[:last] - x[0], z[:last]
    pairs = np.diff(y[np.isfinite(y)])
    if not still and pairs.size >= 4 and np.mean(pairs == 0) >= EQUAL:
        worst = int(np.argmax(np.abs(z)))
        return Named("freeze", *_interval(float(e[worst]), float(s[worst])))
    if z.size <= FEW:
        kind = "spikes" if over else "bias"
        return Named(kind, *_size(kind, e, s, noise, [], 0.0), () if over else ("spikes", "drift", "noise"))
    scores, ramps, rho = _scores(z, x / max(x[-1], 1.0))
    kind = max(scores, key=lambda k: scores[k])
    weight = {k: float(np.exp(v - scores[kind])) for k, v in scores.items()}
    total = sum(weight.values())
    others = tuple(k for k in sorted(weight, key=lambda k: -weight[k]) if k != kind and weight[k] / total > POSSIBLE)
    return Named(kind, *_size(kind, e, s, noise, ramps, rho), others)


Ramps = list[tuple[float, Array]]  # of possible drifts: the probability and the regressors (n, 2)


def _scores(z: Array, x: Array) -> tuple[dict[str, float], Ramps, float]:
    """The criterion of each kind; the drifts; the autocorrelation of the residuals about the best drift."""
    n = z.size
    penalty = np.log(n) / 2
    ramps = [np.stack([np.ones(n), np.minimum(x / rise, 1.0)], axis=-1) for rise in (RISES if n > 3 else RISES[:1])]
    fits = np.array([_normal(z - _fitted(ramp, z)) - (3 + (k > 0)) * penalty for k, ramp in enumerate(ramps)])
    columns = ramps[int(np.argmax(fits))]
    drift = float(np.max(fits)) if n > 3 else -np.inf
    (a, c), *_ = np.linalg.lstsq(columns, z)
    r = z - columns @ np.array([a, c])
    rho = float(np.clip(r[1:] @ r[:-1] / max(r @ r, 1e-300), 0.0, STEADIEST)) if n > 3 else 0.0
    bias = _normal(z - np.mean(z)) - 2 * penalty
    independent = (1 - rho) / (1 + rho)  # of the samples: correlated residuals decide less between bias and drift
    drift = bias + independent * (drift - bias) if np.isfinite(drift) else drift
    if n > FEW and abs(np.mean(z)) * np.sqrt(n) < SURE * np.std(z):
        bias = -np.inf
    changes = columns[:, 1] - np.mean(columns[:, 1])
    if abs(c) < max(1.0, CHANGE * max(abs(a), abs(a + c))) or abs(c) * np.sqrt(changes @ changes) < SURE * np.std(r):
        drift = -np.inf
    scores = {"bias": bias, "drift": drift, "noise": _normal(z) - penalty, "spikes": _spikes(z) - 2 * penalty}
    share = np.exp(fits - np.max(fits))
    return scores, list(zip((share / np.sum(share)).tolist(), ramps, strict=True)), rho


def _fitted(columns: Array, values: Array) -> Array:
    found, *_ = np.linalg.lstsq(columns, values)
    return np.asarray(columns @ found)


def _normal(r: Array) -> float:
    """Log likelihood of independent normal numbers r (n,), up to a constant, at their best variance, at least 1."""
    square = float(np.mean(r * r))
    variance = max(1.0, square)
    return float(-r.size / 2 * (np.log(variance) + square / variance))


def _spikes(z: Array) -> float:
    """Log likelihood of standard normal numbers z (n,), up to the same constant, of which some are larger."""
    square = z * z
    quiet = -square / 2
    share = np.array([0.02, 0.05, 0.1, 0.2, 0.3, 0.5])[:, None]
    variance = np.full(share.shape, 25.0)
    for _ in range(20):  # expectation and maximisation of l^2
        loud = -square / (2 * variance) - np.log(variance) / 2
        total = np.logaddexp(np.log(1 - share) + quiet, np.log(share) + loud)
        weight = np.exp(np.log(share) + loud - total)
        variance = np.maximum(4.0, (weight @ square)[:, None] / np.maximum(np.sum(weight, axis=-1, keepdims=True), 1e-300))
    best = float(np.max(np.sum(total, axis=-1)))
    height = np.abs(z)[np.abs(z) > QUIET]
    if height.size:
        m = float(np.median(height))
        jump = np.logaddexp(-((z - m) ** 2) / 2, -((z + m) ** 2) / 2) - np.log(2)
        share = np.array([0.1, 0.3, 0.5, 0.7, 0.9])[:, None]
        total = np.logaddexp(np.log(1 - share) + quiet, np.log(share) + jump)
        best = max(best, float(np.max(np.sum(total, axis=-1))))
    return best


def _size(kind: str, e: Array, s: Array, noise: NoiseOf, ramps: Ramps, rho: float) -> tuple[float, float, float]:
    """Size of a fault with its 95 % interval, from the residuals e (n,) and their standard deviations s (n,).

    The error of a mean has two parts: the noise of the readings, sigma^2 c / n, with c = 1 where it is white, and the error of
    the estimate, s^2 - sigma^2, which may be the same throughout and is not reduced. Where the residuals vary more, their own
    variance over the number of independent ones counts, n (1 - rho) / (1 + rho). Of a drift the mean over the times in which
    it may have risen, weighted by their probability, with the variance between them.
    """
    n, sigma = e.size, noise.sigma
    common = float(np.mean(np.maximum(s**2 - sigma**2, 0.0)))
    inflated, of_noise = (1 + rho) / (1 - rho), sigma**2 * float(inflation_of(n, *noise.slow)[0])
    if kind == "bias":
        spread = float(np.var(e, ddof=1)) / n * inflated if n > 1 else 0.0
        return _interval(float(np.mean(e)), np.sqrt(max(of_noise / n + common, spread)))
    if kind == "drift":
        value, variance = [], []
        for _, ramp in ramps:
            fitted, end = _fitted(ramp, e), ramp[-1]
            leverage = float(end @ np.linalg.pinv(ramp.T @ ramp) @ end)
            spread = float(np.sum((e - fitted) ** 2)) / max(n - 2, 1) * leverage * inflated
            value.append(fitted[-1])
            variance.append(max(of_noise * leverage + common, spread))
        share, ends = np.array([p for p, _ in ramps]), np.array(value)
        size = float(share @ ends)
        return _interval(size, float(np.sqrt(share @ (np.array(variance) + (ends - size) ** 2))))
    if kind == "noise":
        total, none = float(np.sum(e**2)), float(np.mean(s**2))
        values = (total / n, *(total / (2 * float(gammaincinv(n / 2, p))) for p in (0.975, 0.025)))  # quantiles of chi-square
        size, low, high = (float(np.sqrt(max(v - none, 0.0))) for v in values)
        return size, low, high
    height = e[np.abs(e) > QUIET * s]
    if not height.size:
        height = e
    if not (np.all(height > 0) or np.all(height < 0)):
        height = np.abs(height)
    spread = float(np.var(height, ddof=1)) if height.size > 1 else 0.0
    return _interval(float(np.mean(height)), np.sqrt(max(spread, float(np.mean(s**2))) / height.size))


def _interval(value: float, sd: float) -> tuple[float, float, float]:
    return value, float(value - NORMAL * sd), float(value + NORMAL * sd)
