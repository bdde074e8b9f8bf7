"""A recording for identification: checked, in units of each signal's standard deviation, repeated readings left out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, require_unique
from fusion_sfdia.plant.log import Log, one_run
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]


class Scaled(NamedTuple):
    """y (K, N) and u (K, m), centred and of variance 1; dt in s; mean and standard deviation of each (N,), (m,)."""

    y: Array
    u: Array
    dt: float
    y_mean: Array
    y_sd: Array
    u_mean: Array
    u_sd: Array


def scaled(sensors: Sequence[Signal], inputs: Sequence[Signal], log: Log) -> Scaled:
    """Return the recording of these sensors and inputs scaled; ValueError where it does not fit or cannot be identified."""
    if len(log) != 3:
        raise ValueError(f"the recording has {len(log)} parts; expected a Log: t (K,), y (K, N), u (K, m)")
    t, y, u = one_run(Log(*(floats(what, value) for what, value in zip(("t", "y", "u"), log, strict=True))))
    require_unique("signals of a recording", [s.name for s in (*sensors, *inputs)])
    if t.ndim != 1 or y.shape != (t.size, len(sensors)) or u.shape != (t.size, len(inputs)) or not sensors:
        raise ValueError(
            f"t {t.shape}, y {y.shape}, u {u.shape} do not fit {len(sensors)} sensors and {len(inputs)} inputs; expected (K,), "
            f"(K, {len(sensors)}), (K, {len(inputs)}), with at least one sensor"
        )
    if t.size < 2 or not np.allclose(steps := np.diff(t), steps[0], rtol=1e-6, atol=0.0) or not steps[0] > 0:
        raise ValueError("the times of the recording do not rise in equal steps; add rows of NaN where readings are missing")
    if np.isinf(y).any() or not np.isfinite(u).all():
        raise ValueError(
            "the recording has infinite readings or inputs that are missing; expected NaN for missing readings alone"
        )
    for what, signals, values in (("sensor", sensors, y), ("input", inputs, u)):
        for signal, column in zip(signals, values.T, strict=True):
            known = column[np.isfinite(column)]
            if known.size < 2 or known.min() == known.max():
                raise ValueError(
                    f"{what} {signal.name!r} has {known.size} readings of {np.unique(known).size} values; expected one that "
                    "moves: leave it out"
                )
    y_mean, y_sd, u_mean, u_sd = np.nanmean(y, axis=0), np.nanstd(y, axis=0), u.mean(axis=0), u.std(axis=0)
    return Scaled((y - y_mean) / y_sd, (u - u_mean) / u_sd, float(steps[0]), y_mean, y_sd, u_mean, u_sd)


def without_repeats(y: Array, repeating: Array) -> Array:
    """Return y with NaN where a sensor has the same reading as in the sample before.

    A sampled analyser repeats its last value until the next analysis: repetitions are no new readings, and their errors are
    the same. An analysis that gives the very same value is left out too, which costs a reading and no more.

    Parameters
    ----------
    y : array (K, N)
        Readings.
    repeating : array (N,) of bool
        Sensors that repeat their readings.

    Returns
    -------
    array (K, N)
        y without the repetitions.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.learning import without_repeats
    >>> without_repeats(np.array([[5.0], [5.0], [7.0]]), np.array([True])).ravel()
    array([ 5., nan,  7.])
    """
    y = floats("y", y)
    repeated = np.zeros(y.shape, bool)
    repeated[1:] = (y[1:] == y[:-1]) & repeating
    return np.where(repeated, np.nan, y)
