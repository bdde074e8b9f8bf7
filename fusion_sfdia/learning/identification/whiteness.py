"""Whether the innovations of a plant's Kalman filter on healthy readings are white and as large as stated."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import whole
from fusion_sfdia.filters.estimators import Extended
from fusion_sfdia.filters.gaussian import condition
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.plant.log import one_run
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


class WhitenessTest(NamedTuple):
    """Statistics of the innovations of a filter.

    Attributes
    ----------
    nis : float
        Normalised innovation squared per reading, 1 where the covariances are right.
    variance : array (N,)
        Of the standardised innovations of each sensor, 1 as well.
    autocorrelation : array (N,)
        At the sensor's next reading one step later, 0 where white.
    pairs : array (N,) of int
        The number of products behind it. A white innovation's autocorrelation has the standard error 1 / sqrt(pairs).

    Examples
    --------
    See `whiteness`.
    """

    nis: float
    variance: Array
    autocorrelation: Array
    pairs: Array


def whiteness(plant: Plant, *healthy: Any, warm_up: int = 20) -> WhitenessTest:
    """Return the statistics of the innovations of the extended Kalman filter after the first samples of one run.

    Parameters
    ----------
    plant : Plant
        The model.
    *healthy : arrays, Log, Recording or frame
        As `as_log` takes it, not the recording that the plant was identified from.
    warm_up : int, default 20
        Samples that are left out at the beginning.

    Returns
    -------
    WhitenessTest
        A sensor that is read every second sample has no pairs; its autocorrelation is NaN.

    Examples
    --------
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.learning import WhitenessTest, whiteness
    >>> from fusion_sfdia.plants import two_tanks
    >>> found: WhitenessTest = whiteness(two_tanks(), simulate(two_tanks(), 300, seeds=[1], truth="model", process_noise=True))
    >>> 0.8 < found.nis < 1.2, found.variance.shape
    (True, (4,))
    """
    t, y, u = one_run(as_log(plant, *healthy))
    if len(t) <= whole("warm_up", warm_up, least=0) + 1:
        raise ValueError(f"{len(t)} samples, of which {warm_up} are left out; expected at least two more: record more")
    estimator, rng = Extended(), np.random.default_rng(0)  # this filter draws nothing
    core = estimator.start(plant, (), rng)
    before = float(t[0]) - plant.dt
    standardised, nis, count = np.empty(y.shape), np.zeros(len(t)), np.isfinite(y).sum(axis=1)
    for k, now in enumerate(t):
        prior = estimator.predict(plant, core, before, u[k], float(now) - before, rng)
        joint = estimator.joint(plant, prior, float(now), u[k])
        found = condition(joint, y[k])
        standardised[k] = found.innovation / np.sqrt(np.diagonal(joint.S))
        nis[k] = count[k] * found.nis if count[k] else 0.0
        core, before = core._replace(x=found.x, P=found.P), float(now)
    e = standardised[warm_up:]
    known = np.isfinite(e)
    square = np.sum(np.where(known, e, 0.0) ** 2, axis=0)
    products = np.where(known[1:] & known[:-1], e[1:] * e[:-1], 0.0)
    pairs = np.sum(known[1:] & known[:-1], axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = square / known.sum(axis=0)
        autocorrelation = products.sum(axis=0) / pairs / variance
    return WhitenessTest(float(nis[warm_up:].sum() / count[warm_up:].sum()), variance, autocorrelation, pairs)
