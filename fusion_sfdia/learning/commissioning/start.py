"""Where runs begin: the first state that the first readings show."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from fusion_sfdia.filters.gaussian import dense
from fusion_sfdia.learning.innovations import filtered
from fusion_sfdia.plant.augment import fixed
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

REFUSED = 1e-3  # probability that a start as stated is moved
WIDE = 100.0  # standard deviations of the stated start


class Start(NamedTuple):
    """The state x0 (n,) that runs begin with, and the variance of their first states about it (n,)."""

    x0: Array
    spread: Array


def with_start(plant: Plant, start: Start) -> Plant:
    """The plant that starts there; its initial covariance also holds the spread."""
    own = plant.initial_cov
    cov = own + start.spread if own.ndim == 1 else own + np.diag(start.spread)
    return replace(plant, x0=start.x0, initial_cov=cov)


def seen_to_fit(plant: Plant) -> Plant:
    """The plant whose sensors have been seen to fit it, see `Uncertainty.fits`."""
    return replace(plant, uncertainty=replace(plant.uncertainty, fits=True))


def first_state(plant: Plant, log: Log) -> Start | None:
    """The mean and variance of the states that a log of runs begins with; None where the plant's own x0 fits them.

    The state of each run is smoothed from its first readings, with a start that is 100 times as uncertain. Readings that
    do not determine a state, or that no state explains, may move it anywhere: a mean beyond its limits is no start, and None.
    """
    first = log.rows(slice(1))
    model = fixed(plant)
    (stated,) = filtered(model, first)
    if np.sum(stated.normal**2) < chi2.isf(REFUSED, int(np.sum(stated.used))):
        return None
    n = len(plant.states)
    factor = np.where(np.arange(model.x0.size) < n, WIDE, 1.0)
    wide = dense(model.initial_cov) * np.outer(factor, factor)
    (free,) = filtered(replace(model, initial_cov=wide), first)
    ahead = model.step(float(log.t[0]) - model.dt, np.broadcast_to(model.x0, free.x.shape), log.u[0], model.dt)
    turned = wide @ np.swapaxes(free.tangent, -1, -2)
    gain = turned @ np.linalg.pinv(free.tangent @ turned + dense(model.process_cov), hermitian=True)
    moved = (gain @ (free.x - ahead)[..., None])[..., :n, 0]
    spread = np.mean((moved - np.mean(moved, axis=0)) ** 2, axis=0)
    low, high = plant.state_limits
    found = Start(plant.x0 + np.mean(moved, axis=0), spread)
    return found if np.all((low <= found.x0) & (found.x0 <= high)) else None


def first_error(plant: Plant, log: Log) -> float:
    """Normalised innovation squared per reading of the samples that a log of runs begins with, 1 where the plant's x0 fits."""
    (first,) = filtered(fixed(plant), log.rows(slice(1)))
    return float(np.sum(first.normal**2) / max(np.sum(first.used), 1))
