"""Reasons to refuse a healthy log: a sensor that drifts over it, or a parameter that moves further than its plant declares.

A slow fault that a fitted parameter or disturbance can follow leaves small residuals. So it is looked for with all parameters
at one value for the whole log, where a constant error of size b in sensor or parameter i changes the innovations by N_i b,

    N = H eps + [0 I],    eps <- F (I - K H) eps - F K [0 I]

(Friedland 1969). In stretch j the estimate of b_i is g_ij / I_ij, with g = sum N' S^-1 d and I = sum N' S^-1 N. Of M stretches
that are longer than the errors of the model last, these are independent, and their slope by least squares, weighted by I, over
its standard error is Student's t with M - 2 degrees of freedom, whatever noise the plant states (batch means: Law and Kelton
2000, Simulation modeling, 9.5.3).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fusion_sfdia.learning.commissioning.parameters import declared, free
from fusion_sfdia.learning.innovations import filtered, held
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import HOUR

Array = NDArray[Any]

REFUSED = 1e-4  # probability that a healthy log is refused
STRETCHES, LEAST = 24, 20  # of the log, of at least so many samples each
KNOWN = 0.05  # of the information of the best stretch: a stretch with less, as of missing readings, is left out
MOVED = 1.0  # sigma or declared deviations: a smaller change over the log is a matter of calibration, our choice
ALIKE = 0.8  # share of the likelihood ratio of the best explanation, from which another one explains the log about as well


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
    each = int(np.clip(STRETCHES // runs, 1, max((steps - settle) // LEAST, 1)))
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
