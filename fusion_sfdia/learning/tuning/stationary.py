"""Reasons to refuse a healthy log that was predicted: a stretch unlike the others, a drift, a spike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from fusion_sfdia.learning.tuning.spikes import require_no_spike
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

STRETCHES, LEAST = 8, 40  # stretches of a run, of at least so many samples
LAGS = 20
REFUSED = 1e-4  # probability that a healthy log is refused by each of the tests
FACTOR = 2.0  # of a variance between stretches that a plant in order may show, our choice
SHIFT = 1.0  # standard deviation: the same of a mean
NAMED = 3  # stretches by their times, of more the number


def require_stationary(
    plant: Plant, residuals: tuple[Array, Array], u: Array, middle: int, at: Callable[[int, int], str]
) -> None:
    """Raise ValueError where a log is not of one kind throughout.

    residuals (K, B, N): errors of each reading predicted from all others, in standard deviations, NaN where missing, by the
    plants that were learnt from the samples before and from `middle` on. u (K, B, m): inputs that acted until each
    sample. at: the time of a sample of a run in words.
    """
    first, second = residuals
    _require_alike(plant, first[:middle], first[middle:], _spans(first.shape[1], 0, middle - 1, at))
    _require_alike(plant, second[middle:], second[:middle], _spans(first.shape[1], middle, len(first) - 1, at))
    require_even(plant, np.concatenate([second[:middle], first[middle:]]), u, at)


def _spans(runs: int, first: int, last: int, at: Callable[[int, int], str]) -> str:
    """The samples from first to last of all runs in words."""
    spans = [f"from {at(first, b)} to {at(last, b)}" for b in range(runs)]
    return ", ".join(spans[:NAMED]) + (f" and in {runs - NAMED} more stretches alike" if runs > NAMED else "")


def _require_alike(plant: Plant, own: Array, other: Array, learnt: str) -> None:
    """Raise ValueError where the errors of a sensor are larger in the other half than in that from which was learnt."""
    with np.errstate(divide="ignore", invalid="ignore"):
        powers, known = (np.stack([f(a, axis=(0, 1)) for a in (own, other)]) for f in (_mean_square, _known))
        chance = norm.isf(REFUSED / (2 * plant.sensor_sigma.size))
        allowed = np.log(FACTOR) + chance * np.sqrt(np.sum(2 * _memory([own**2, other**2]) / known, axis=0))
        excess = np.nan_to_num(np.log(powers[1] / powers[0])) - allowed
    i = int(np.argmax(excess))
    if excess[i] > 0:
        raise ValueError(
            f"the healthy log is not stationary: what it shows {learnt} does not hold for its other half, where the error of "
            f"sensor {plant.sensors[i].name!r}, predicted from all others, is {np.sqrt(powers[1, i] / powers[0, i]):.2g} times "
            "as large; a fault, or another operation, for which the model does not hold: give a log without faults, with all "
            "usual operation in each half"
        )


def require_even(plant: Plant, residual: Array, u: Array, at: Callable[[int, int], str]) -> None:
    """Raise ValueError where residuals (K, B, N) have a spike, or a stretch unlike the others.

    In each stretch of L samples the mean and the variance of a sensor's residual are compared with their medians over all
    stretches; both have a standard error that grows with the residual's autocorrelation.
    """
    steps, runs, count = residual.shape
    middle = np.nanmedian(residual, axis=(0, 1))
    require_no_spike(plant, residual, u, at)
    many = int(np.clip(steps // LEAST, 1, STRETCHES))
    ends = np.linspace(0, steps, many + 1).astype(int)
    if many * runs < 3:
        return  # nothing to compare
    parts = [slice(a, b) for a, b in pairwise(ends)]
    known = np.stack([np.sum(np.isfinite(residual[p]), axis=0) for p in parts])
    mean, power = (np.stack([_mean(a[p]) for p in parts]) for a in (residual, (residual - middle) ** 2))
    usual_mean, usual = np.nanmedian(mean, axis=(0, 1)), np.nanmedian(power, axis=(0, 1))
    chance = float(norm.isf(REFUSED / (2 * many * runs * count)))
    with np.errstate(divide="ignore", invalid="ignore"):
        of_mean = chance * np.sqrt(usual * _memory([residual[p] for p in parts]) / known) + SHIFT * np.sqrt(usual)
        of_power = chance * np.sqrt(2 * _memory([(residual[p] - middle) ** 2 for p in parts]) / known) + np.log(FACTOR)
        shift, ratio = np.abs(mean - usual_mean) / of_mean, np.abs(np.log(power / usual)) / of_power
    enough = known >= LEAST // 2
    worst = np.where(enough, np.fmax(shift, ratio), 0.0)
    s, b, i = np.unravel_index(int(np.argmax(np.nan_to_num(worst))), worst.shape)
    if not worst[s, b, i] > 1:
        return
    if shift[s, b, i] >= ratio[s, b, i]:
        what = f"lies {(mean[s, b, i] - usual_mean[i]) / np.sqrt(usual[i]):+.1f} of its standard deviations off"
    else:
        what = f"is {np.sqrt(power[s, b, i] / usual[i]):.2g} times as large"
    where = f"from {at(int(ends[s]), int(b))} to {at(int(ends[s + 1]) - 1, int(b))}"
    raise ValueError(
        f"the healthy log is not stationary: {where} the error of sensor {plant.sensors[i].name!r}, predicted from all "
        f"others, {what}, compared with the other stretches; a fault, or an operation for which the model does not hold: leave "
        "these readings out (NaN), or give another log"
    )


def _mean_square(a: Array, axis: tuple[int, ...]) -> Array:
    return np.asarray(np.nansum(a**2, axis=axis) / _known(a, axis))


def _known(a: Array, axis: tuple[int, ...]) -> Array:
    return np.asarray(np.sum(np.isfinite(a), axis=axis))


def _mean(a: Array) -> Array:
    known = np.isfinite(a)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sum(np.where(known, a, 0.0), axis=0) / np.sum(known, axis=0))


def _memory(parts: Sequence[Array]) -> Array:
    """1 + 2 sum of the positive autocorrelations (N,) at lags 1 to 20, by which the variance of a mean of (L, B, N) grows.

    Each is the median over stretches about their own means, so that one stretch unlike the others does not hide itself.
    """
    filled = [np.nan_to_num(p - _mean(p)) for p in parts]
    power = np.stack([np.sum(f**2, axis=0) for f in filled])
    found = np.ones(filled[0].shape[-1])
    for lag in range(1, min(LAGS, min(map(len, filled)) // 4) + 1):
        product = np.stack([np.sum(f[lag:] * f[:-lag], axis=0) for f in filled])
        found += 2 * np.maximum(np.median(product / np.where(power > 0, power, 1.0), axis=(0, 1)), 0.0)
    return found
