"""Reasons to refuse a healthy log that was predicted: a stretch unlike the others, a drift, a spike.

Spikes: an input taken for a row too late or too early is wrong in one row at each of its steps. Of n rows with a spike, h
beside one of the largest steps of an input, which are a share p of all rows, are chance with the probability
P(Binomial(n, p) >= h).

Drift of a sensor, or of a parameter beyond what its plant declares: a slow fault that a fitted parameter or disturbance can
follow leaves small residuals. So it is looked for with all parameters at one value for the whole log, where a constant error of
size b in sensor or parameter i changes the innovations by N_i b,

    N = H eps + [0 I],    eps <- F (I - K H) eps - F K [0 I]

(Friedland 1969). In stretch j the estimate of b_i is g_ij / I_ij, with g = sum N' S^-1 d and I = sum N' S^-1 N. Of M stretches
that are longer than the errors of the model last, these are independent, and their slope by least squares, weighted by I, over
its standard error is Student's t with M - 2 degrees of freedom, whatever noise the plant states (batch means: Law and Kelton
2000, Simulation modeling, 9.5.3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, norm
from scipy.stats import t as student

from fusion_sfdia.learning.commissioning.parameters import declared, free
from fusion_sfdia.learning.innovations import filtered, held
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import HOUR

Array = NDArray[Any]

STRETCHES, LEAST = 8, 40  # stretches of a run, of at least so many samples
LAGS = 20
REFUSED = 1e-4  # probability that a healthy log is refused by each of the tests
FACTOR = 2.0  # of a variance between stretches that a plant in order may show, our choice
SHIFT = 1.0  # standard deviation: the same of a mean
NAMED = 3  # stretches by their times, of more the number
SPIKE = 10.0  # standard deviations
STEPS = 0.05  # of the changes of an input are its steps at most
CHANCE = 1e-4  # probability that spikes elsewhere are taken for spikes at steps of inputs
TRENDS, FEWEST = 24, 20  # of the log, of at least so many samples each
KNOWN = 0.05  # of the information of the best stretch: a stretch with less, as of missing readings, is left out
MOVED = 1.0  # sigma or declared deviations: a smaller change over the log is a matter of calibration, our choice
ALIKE = 0.8  # share of the likelihood ratio of the best explanation, from which another one explains the log about as well


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


def require_no_spike(plant: Plant, residual: Array, u: Array, at: Callable[[int, int], str]) -> None:
    """Raise ValueError where residuals (K, B, N), in standard deviations of the model, have a spike; u (K, B, m): inputs that
    acted until each sample.

    A sensor's spread is that of the middle half of its residuals; of one that reads in steps, most of whose readings may be
    equal, at least that of the model. at: the time of a sample of a run in words.
    """
    middle = np.nanmedian(residual, axis=(0, 1))
    spread = 1.4826 * np.nanmedian(np.abs(residual - middle), axis=(0, 1))
    spread = np.maximum(spread, np.where(plant.sensor_resolution > 0, 1.0, np.finfo(float).tiny))
    size = np.nan_to_num(np.abs(residual - middle) / spread)
    k, b, i = (int(j) for j in np.unravel_index(int(np.argmax(size)), size.shape))
    if not size[k, b, i] > SPIKE:
        return
    more = int(np.sum(size > SPIKE)) - 1
    also = f", as do{'es' * (more == 1)} {more} more reading{'s' * (more != 1)}" if more else ""
    cure = of_convention(plant, np.any(size > SPIKE, axis=-1), u) or "leave spikes out (NaN), or give a log without faults"
    raise ValueError(
        f"sensor {plant.sensors[i].name!r} contradicts all others at {at(k, b)}, by {size[k, b, i]:.3g} of its standard "
        f"deviations{also}; {cure}"
    )


def of_convention(plant: Plant, spikes: Array, u: Array) -> str:
    """The cure where spikes (K, B) are beside the steps of an input (K, B, m), "" where they are not."""
    count, found = int(np.sum(spikes)), []
    for signal, values in zip(plant.inputs, np.moveaxis(u, -1, 0), strict=True):
        change = np.abs(np.diff(values, axis=0))
        steps = (change > 0) & (change >= np.quantile(change, 1 - STEPS))
        share = np.mean(steps)
        for rows, where, convention in (
            (spikes[:-1], "in the row before", "until the sample"),
            (spikes[1:], "in the row of", "at the sample"),
        ):
            hits = int(np.sum(rows & steps))
            if hits and binom.sf(hits - 1, count, share) < CHANCE:
                found.append((hits, signal.name, where, convention))
    if not found:
        return ""
    hits, name, where, convention = max(found)
    return (
        f"{hits} of {count} rows with such a reading are {where} a step of input {name!r}, so that it seems to be read a row "
        f'too {"late" if convention == "until the sample" else "early"}: state inputs = "{convention}" in the map of the log'
    )


class Trends(NamedTuple):
    """Of parameters, errors of inputs and sensors (h,): names, the change over the log in their standard deviations.

    error: standard error of the change. ratio: twice the logarithm of the likelihood ratio of a steady change to none.
    declared (p,): of the parameters and errors of inputs, which come first, twice the standard deviation by which they change
    over the log according to their `rate`. freedom (h,): degrees of freedom of the errors, 0 where too little is known.
    """

    names: tuple[str, ...]
    change: Array
    error: Array
    ratio: Array
    declared: Array
    freedom: Array


def require_no_drift(plant: Plant, log: Log, settle: int, sigma: Array, at: Callable[[int, int], str]) -> None:
    """Raise ValueError where a sensor drifts by more than its sigma (N,), or a parameter by more than its declared deviation.

    plant: with its parameters as the whole log of runs shows them. settle: samples that are left out at the beginning of each
    run. at: the time of a sample of a run in words. A parameter and a sensor may explain a log about as well: it is refused
    then, too, unless the plant declares that the parameter changes so fast.
    """
    found = trends(plant, log, settle, sigma)
    if not found.freedom.any():
        return
    chance = student.isf(REFUSED / (2 * len(found.names)), np.maximum(found.freedom, 1)) * found.error
    order = [int(i) for i in np.argsort(-found.ratio, kind="stable") if found.ratio[i] >= ALIKE * np.max(found.ratio)]
    p, change = found.declared.size, found.change
    if any(0 < found.declared[i] >= abs(change[i]) - chance[i] for i in order if i < p):
        return
    moved = [i for i in sorted(order, key=lambda i: i < p) if abs(change[i]) > MOVED + chance[i]]  # sensors first
    if not moved or (moved[0] < p and len(moved) < len(order)):
        return
    first, others = moved[0], [found.names[i] for i in order if i != moved[0]]
    also = f"; {' or '.join(others[:2])} would explain it about as well" if others else ""
    when = f"from {at(settle, 0)} to {at(len(log.t) - 1, log.y.shape[1] - 1)}"
    if first < p:
        raise ValueError(
            f"{found.names[first]} moves {when}, by {change[first]:+.1f} times its declared deviation{also}: give a log in "
            "which the plant does not change, or declare its rate or a larger deviation"
        )
    raise ValueError(
        f"sensor {found.names[first]!r} drifts {when}, by {change[first] * sigma[first - p]:+.3g} "
        f"{plant.sensors[first - p].unit} ({change[first]:+.1f} sigma) against all others{also}: repair or recalibrate it, or "
        "leave its readings out (NaN)"
    )


def trends(plant: Plant, log: Log, settle: int, sigma: Array) -> Trends:
    """The steady change over a log of runs, one after the other, of each parameter, error of an input and sensor by itself."""
    g, info = _estimates(plant, log, settle, sigma)
    hours = log.y.shape[1] * float(log.t[-1] - log.t[settle]) / HOUR
    named, rates = _named(plant), {p.name: p.rate for p in plant.uncertainty.parameters}
    moving = np.array([2 * rates.get(name, 0.0) * np.sqrt(hours) / sd for name, sd in named.items()])
    names = (*named, *plant.sensor_names)
    known = info > KNOWN * np.max(info, axis=0)
    weight, m = np.where(known, info, 0.0), np.sum(known, axis=0)
    b = np.where(known, g, 0.0) / np.where(known, info, 1.0)
    total, x = np.sum(weight, axis=0), np.arange(len(b))[:, None] / len(b)
    with np.errstate(invalid="ignore", divide="ignore"):
        about, mean = x - np.sum(weight * x, axis=0) / total, np.sum(weight * b, axis=0) / total
        spread = np.sum(weight * about**2, axis=0)
        change = np.sum(weight * about * b, axis=0) / spread
        error = np.sqrt(np.sum(weight * (b - mean - about * change) ** 2, axis=0) / (m - 2) / spread)
    enough = m > 2
    change, error, ratio = (np.where(enough, a, 0.0) for a in (change, error, change**2 * spread))
    return Trends(names, change, error, ratio, moving, np.where(enough, m - 2, 0))


def _named(plant: Plant) -> dict[str, float]:
    """What may change of the plant, each with the standard deviation that was declared, before anything was learnt."""
    names, _, sd = declared(plant)
    return {names[i]: plant.uncertainty.changes.get(names[i], float(sd[i])) for i in free(plant)}


def _estimates(plant: Plant, log: Log, settle: int, sigma: Array) -> tuple[Array, Array]:
    """Scores g and information I (M, h) of the stretches, run after run."""
    model, where = held(plant), free(plant)
    steps, runs, count = log.y.shape
    n, p, size = len(plant.states), where.size, model.x0.size
    each = int(np.clip(TRENDS // runs, 1, max((steps - settle) // FEWEST, 1)))
    start, read = np.zeros((size, p + count)), np.zeros((count, p + count))
    start[n + where, np.arange(p)] = list(_named(plant).values())
    read[:, p:] = np.diag(sigma)
    eps = np.broadcast_to(start, (runs, size, p + count))
    g, info = np.zeros((2, runs, each, p + count))
    for k, now in enumerate(filtered(model, log)):
        eps = now.tangent @ eps
        if k >= settle:
            j = (k - settle) * each // (steps - settle)
            effect = now.readout @ eps + read
            g[:, j] += (np.swapaxes(effect, -1, -2) @ now.whitened[..., None])[..., 0]
            info[:, j] += np.sum(effect * (now.inverse @ effect), axis=-2)
        eps = now.closed @ eps - now.gain @ read
    return g.reshape(-1, p + count), info.reshape(-1, p + count)
